"""What commands read of their arguments and show of their work."""

from __future__ import annotations

import re
from contextlib import contextmanager

from .errors import UserError

FRAMES = 1_000_000  # frame numbers have six digits


def numbers_of(text):
    """ "1-3,7" -> (1, 2, 3, 7), None for None."""
    if text is None:
        return None
    last = max((int(n) for n in re.findall(r"\d+", text)), default=0)
    if last >= FRAMES:
        raise UserError(f"--frames {text}: {last} is no frame number, they have six digits")
    numbers = frame_numbers(text, range(last + 1))
    if not numbers:
        raise UserError(f"--frames {text}: there is no number in this range")
    return numbers


def frame_numbers(text, available, step=1):
    """ "1-50,60" -> the numbers of that list that are captured, every `step`-th; all of them for None."""
    if step < 1:
        raise UserError(f"--step {step}: expected at least 1")
    if text is None:
        return tuple(available)[::step]
    numbers, there = [], set(available)
    for part in text.split(","):
        first, _, last = part.strip().partition("-")
        if not first.isdigit() or (last and not last.isdigit()):
            raise UserError(f"--frames {text}: '{part}' is not a number or a range")
        numbers += [n for n in range(int(first), int(last or first) + 1) if not last or n in there]
    return tuple(dict.fromkeys(numbers))[::step]


def shard_of(text):
    """ "2/3" -> (2, 3)."""
    i, _, n = text.partition("/")
    if not (i.isdecimal() and n.isdecimal() and 1 <= int(i) <= int(n)):
        raise UserError(f"--shard {text}: expected i/n with 1 <= i <= n")
    return int(i), int(n)


def table(values, indent=""):
    """Nested measures as aligned lines."""
    for name, value in values.items():
        if isinstance(value, dict):
            yield f"{indent}{name}"
            yield from table(value, indent + "  ")
        else:
            yield f"{indent}{name:<24} {'-' if value is None else f'{value:.3f}' if isinstance(value, float) else value}"


@contextmanager
def progress_bars():
    """-> progress(stage, done, total), one bar a stage, on stderr."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description:<24}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True)) as bars:
        tasks = {}

        def progress(stage, done, total):
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=total)
            bars.update(tasks[stage], completed=done, total=total)

        yield progress
