"""How commands speak: results on stdout, all else on stderr. With --json all of it on stdout, one JSON object a line."""

from __future__ import annotations

import json
import os
import shlex
import sys
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any, TextIO

RED, YELLOW, DIM = 31, 33, 2  # of a terminal's escape sequences


@dataclass
class Manner:
    """What --quiet, --verbose and --json ask for."""

    quiet: bool = False  # results, warnings and errors alone
    verbose: bool = False  # a line a step, and where an error stems from
    json: bool = False


manner = Manner()


def speak(quiet: bool = False, verbose: bool = False, json: bool = False) -> None:
    """Sets how this process speaks from now on."""
    manner.quiet, manner.verbose, manner.json = quiet, verbose, json


def result(words: str, **facts: Any) -> None:
    """What a command is for: a line on stdout; the facts are for machines."""
    _tell("result", words, words, sys.stdout, **facts)


def warn(words: str) -> None:
    """What a user should know before trusting the result."""
    _tell("warning", words, f"  {coloured('warning', YELLOW, sys.stderr)}: {words}", sys.stderr)


def note(words: str) -> None:
    """What helps and may be missed."""
    if not manner.quiet:
        _tell("note", words, words, sys.stderr)


def frame_note(number: int, verdict: str, reason: str) -> None:
    """A frame that failed, or is judged doubtful or wrong, and why."""
    words = f"frame {number}: {'' if verdict == 'failed' else f'{verdict}: '}{reason}"
    colour = YELLOW if verdict == "doubtful" else RED
    _tell("frame", words, f"  {coloured(words, colour, sys.stderr)}", sys.stderr, frame=number, verdict=verdict)


def frame_notes(told: dict[str, dict[int, str]], most: int = 20) -> None:
    """`frame_note` of {verdict: {frame: reason}}; to a reader no more than `most`, and how many there are besides."""
    notes = [(number, verdict, reason) for verdict, reasons in told.items() for number, reason in reasons.items()]
    for one in notes if manner.json else notes[:most]:
        frame_note(*one)
    if not manner.json and len(notes) > most:
        print(f"  and {len(notes) - most} more", file=sys.stderr)


def next_step(*command: str | Path) -> None:
    """The command that goes on from here."""
    words = shlex.join(["toile", *map(str, command)])
    if not manner.quiet:
        _tell("next", words, coloured(f"next: {words}", DIM, sys.stderr), sys.stderr)


def error(words: str, code: int, json: bool = False) -> None:
    """Why a command ends, in one line of stderr, and where `json` is asked for as its last JSON line."""
    print(f"{coloured('toile', RED, sys.stderr)}: {words}", file=sys.stderr)
    if json:
        event("error", text=words, exit=code)


def event(kind: str, **facts: Any) -> None:
    """A JSON line on stdout, at once; numbers that are none become null."""
    print(json.dumps({"event": kind, **_plain(facts)}), flush=True)


def coloured(words: str, colour: int, stream: TextIO) -> str:
    """Words in a colour where a terminal reads them, and https://no-color.org is not asked for."""
    plain = os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb" or not stream.isatty()
    return words if plain else f"\x1b[{colour}m{words}\x1b[0m"


def _plain(value: Any) -> Any:
    """What JSON can say of a value, at any depth."""
    if isinstance(value, dict):
        return {str(name): _plain(inner) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, float) and not isfinite(value):
        return None
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)


def _tell(kind: str, words: str, line: str, stream: TextIO, **facts: Any) -> None:
    if manner.json:
        event(kind, text=words, **facts)
    else:
        print(line, file=stream, flush=True)
