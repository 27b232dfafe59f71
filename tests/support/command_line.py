"""`toile` as it is called in a shell, in this process."""

import pytest

from toile import cli


def run_cli(monkeypatch, *arguments):
    """The exit code of `toile ARGUMENTS` in this process; what was printed is for capsys."""
    monkeypatch.setattr("sys.argv", ["toile", *map(str, arguments)])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    return stop.value.code or 0
