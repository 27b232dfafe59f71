"""The paper's comparisons by one command: `python -m bench.paper`."""
