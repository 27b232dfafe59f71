"""What commands read of their arguments and show of their work."""

from __future__ import annotations

import inspect
import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from . import speech
from .errors import UserError

FRAMES = 1_000_000  # frame numbers have six digits
WORKERS = 1024
SEEDS = 2**32  # seeds are below
Frames = Annotated[str | None, typer.Option("--frames", help="frame numbers, inclusive ranges: 1-50,60")]
Step = Annotated[int, typer.Option("--step", help="every n-th of those frames", min=1)]
Workers = Annotated[
    int,
    typer.Option(
        "--workers", help="processes that share the frames; 1: this one, with all threads", min=1, max=WORKERS
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        "--scheduler", help="tcp://HOST:PORT or scheduler.json of a running dask scheduler: its workers do the work"
    ),
]
Holdout = Annotated[
    str | None,
    typer.Option("--holdout", metavar="A-B", help="frames kept apart: no other frame is made with them; none"),
]
EVERY = 30.0  # s between lines of progress where there is no terminal
EVERY_JSON = 1.0  # s between a stage's lines for machines
ConfigFile = Annotated[
    Path | None, typer.Option("--config", help="settings: a TOML file, or the config.toml of a run to take them from")
]
Changes = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="NAME=VALUE", help="one setting, above --config; repeatable. `toile settings` lists them"
    ),
]
Garments = Annotated[
    list[str] | None,
    typer.Option("--garment", metavar="NAME=OTHER", help="wears the garment NAME of the avatar OTHER; repeatable"),
]
Apart = Annotated[
    bool,
    typer.Option(
        "--apart/--as-given", help="limbs of the motion kept out of the trunk and of one another, or as they are"
    ),
]

SHELLS = ("bash", "zsh", "fish")
COMPLETE = "_TOILE_COMPLETE"  # the variable by which a shell asks what could stand there
MANNERS = {
    "quiet": typer.Option("--quiet", help="results, warnings and errors alone: no progress, no hints"),
    "verbose": typer.Option("--verbose", help="a line a step in place of bars; where an error stems from"),
    "json": typer.Option("--json", help="for machines: progress and results on stdout, one JSON object a line"),
}


def spoken(command: Callable[..., Any]) -> Callable[..., Any]:
    """The command with --quiet, --verbose and --json, where it has none such of its own."""
    own = inspect.signature(command, eval_str=True)
    added = [name for name in MANNERS if name not in own.parameters and f"as_{name}" not in own.parameters]
    kind = inspect.Parameter.KEYWORD_ONLY
    options = [
        inspect.Parameter(name, kind, default=False, annotation=Annotated[bool, MANNERS[name]]) for name in added
    ]

    @wraps(command)
    def run(**given: Any) -> Any:
        speech.speak(**{name: given.pop(name) for name in added})
        return command(**given)

    run.__signature__ = own.replace(parameters=[*own.parameters.values(), *options])  # type: ignore[attr-defined]
    run.__annotations__ = {name: one.annotation for name, one in run.__signature__.parameters.items()}  # type: ignore[attr-defined]
    return run


class GivenOnce(TyperCommand):
    """A command that refuses an option that is given twice and takes one value, of which the last would win unsaid; so
    --physics beside --no-physics."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        *_, given = self.make_parser(ctx).parse_args(args=list(args))
        for option in given:
            if given.count(option) > 1 and not getattr(option, "multiple", False):
                names = "/".join([*option.opts, *option.secondary_opts])
                raise UserError(f"{names}: given {given.count(option)} times, expected once")
        return super().parse_args(ctx, args)


def completion(
    shell: Annotated[str, typer.Argument(help="bash, zsh or fish")],
) -> None:
    """Print a shell's completion of commands and options: eval "$(toile completion bash)"; fish: toile completion fish | source."""
    from typer.completion import get_completion_script

    if shell not in SHELLS:
        raise UserError(f"toile completion {shown(shell)}: expected {' or '.join(SHELLS)}")
    typer.echo(get_completion_script(prog_name="toile", complete_var=COMPLETE, shell=shell))


def numbers_of(text: str | None) -> tuple[int, ...] | None:
    """ "7,1-3" -> (1, 2, 3, 7), rising and each once, None for None."""
    if text is None:
        return None
    return tuple(sorted({n for first, last in ranges(text) for n in range(first, last + 1)}))


def garments_of(given: Iterable[str] | None) -> dict[str, Path]:
    """["tshirt=OTHER"] -> {"tshirt": Path("OTHER")}, {} for None."""
    found: dict[str, Path] = {}
    for text in given or ():
        name, _, other = text.partition("=")
        if not name or not other:
            raise UserError(
                f"--garment {shown(text)}: expected NAME=OTHER, a garment and the avatar that it is taken of"
            )
        if name in found:
            raise UserError(f"--garment {shown(text)}: {shown(name)} is given twice")
        found[name] = Path(other)
    return found


def is_avatar(path: Path) -> bool:
    """Whether a folder is an avatar's and no run's, be it of a training that was stopped."""
    return (path / "avatar.json").exists() or (path / "checkpoints").is_dir()


def frame_numbers(text: str | None, available: Iterable[int], step: int = 1) -> tuple[int, ...]:
    """ "60,1-50" -> the numbers of that list that are captured, rising and each once, every `step`-th; all of them for None."""
    if step < 1:
        raise UserError(f"--step {step}: expected at least 1")
    if text is None:
        return tuple(available)[::step]
    there = set(available)
    numbers = {n for first, last in ranges(text) for n in range(first, last + 1) if first == last or n in there}
    if not numbers:
        raise UserError(f"--frames {text}: none of them is there")
    return tuple(sorted(numbers))[::step]


def ranges(text: str) -> list[tuple[int, int]]:
    """ "1-50,60" -> [(1, 50), (60, 60)]."""
    found = []
    for part in text.split(","):
        match = re.fullmatch(r"\s*([0-9]+)(?:-([0-9]+))?\s*", part)
        if not match:
            raise UserError(f"--frames {shown(text)}: '{shown(part)}' is not a number or a range such as 1-50")
        first, last = match[1], match[2] or match[1]
        if max(len(first), len(last)) > len(str(FRAMES - 1)):
            raise UserError(f"--frames {shown(text)}: '{shown(part)}' is no frame number, they have six digits")
        if int(first) > int(last):
            raise UserError(f"--frames {shown(text)}: '{part.strip()}' runs backwards")
        found.append((int(first), int(last)))
    return found


def shown(text: str, length: int = 40) -> str:
    """What a user gave, short enough to be shown on one line."""
    text = "".join(c if c.isprintable() else "?" for c in text)
    return text if len(text) <= length else f"{text[:length]}..."


def positive(option: str, value: float | None) -> float | None:
    """The number given for an option, or a UserError."""
    if value is not None and not 0 < value < float("inf"):
        raise UserError(f"{option} {value:g}: expected a positive number")
    return value


def shard_of(text: str) -> tuple[int, int]:
    """ "2/3" -> (2, 3)."""
    i, _, n = text.partition("/")
    digits = all(part.isascii() and part.isdecimal() and len(part) < 7 for part in (i, n))
    if not (digits and 1 <= int(i) <= int(n)):
        raise UserError(f"--shard {shown(text)}: expected i/n with 1 <= i <= n")
    return int(i), int(n)


def table(values: Mapping[str, Any], indent: str = "") -> Iterator[str]:
    """Nested measures as aligned lines, without those that are not known."""
    for name, value in values.items():
        if isinstance(value, dict):
            lines = list(table(value, indent + "  "))
            yield from [f"{indent}{name}", *lines] if lines else []
        elif value is not None:
            yield f"{indent}{name:<24} {f'{value:.3f}' if isinstance(value, float) else value}"


@contextmanager
def progress_bars(quiet: bool = False) -> Iterator[Any]:
    """-> progress(stage, done, total, note=""), one bar a stage, on stderr; `progress.print` writes a line above them. Where
    stderr is no terminal, a line a stage at its begin and end and every EVERY seconds between; with --verbose each step."""
    from rich.console import Console

    manner = speech.manner
    quiet = quiet or manner.quiet
    console = Console(stderr=True, quiet=quiet)
    if manner.json or manner.verbose or not console.is_terminal:
        yield ProgressLines(quiet, 0.0 if manner.verbose else EVERY_JSON if manner.json else EVERY)
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description:<24}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    note_column = TextColumn("{task.fields[note]}")
    with Progress(*columns, note_column, console=console) as bars:
        tasks: dict[str, Any] = {}
        last: dict[str, int] = {}

        def progress(stage: str, done: int, total: int, note: str = "") -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=total, note=note)
            elif done < last[stage]:  # it began anew
                bars.reset(tasks[stage])
            last[stage] = done
            bars.update(tasks[stage], completed=done, total=total, note=note)

        progress.print = bars.console.print  # type: ignore[attr-defined]
        yield progress


class ProgressLines:
    """Progress as lines of a log: "track: 120 of 1000, about 14 min left"."""

    def __init__(self, quiet: bool = False, every: float = EVERY, clock: Callable[[], float] = time.monotonic):
        self.quiet, self.every, self.clock = quiet, every, clock
        self.begun: dict[str, tuple[float, int]] = {}  # stage: when, and what was done by then
        self.last: dict[str, int] = {}
        self.said: dict[str, float] = {}

    def __call__(self, stage: str, done: int, total: int, note: str = "") -> None:
        now = self.clock()
        if done < self.last.get(stage, 0):  # it begins anew, as where several avatars are evaluated
            self.begun.pop(stage, None)
            self.said.pop(stage, None)
        self.last[stage] = done
        start, before = self.begun.setdefault(stage, (now, done))
        if stage in self.said and done < total and now - self.said[stage] < self.every:
            return
        self.said[stage] = now
        left = (now - start) * (total - done) / (done - before) if done > before else None
        if speech.manner.json and not self.quiet:
            speech.event("progress", stage=stage, done=done, total=total, seconds_left=left, note=note)
        else:
            rest = f", about {duration(left)} left" if left else ""
            self.print(f"{stage}: {done} of {total}{rest}{f' {note}' if note else ''}")

    def print(self, line: str) -> None:
        """A line on stderr, at once."""
        if not self.quiet:
            speech.note(line)


def duration(seconds: float) -> str:
    """ "40 s", "12 min", "3.5 h"."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"
