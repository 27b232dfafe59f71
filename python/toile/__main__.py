"""`python -m toile` is the command `toile`."""

from .cli import main

main()
