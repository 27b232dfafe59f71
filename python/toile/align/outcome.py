"""What came of an alignment, read from its folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..frame_numbers import frame_ranges
from ..io.holdout import held
from ..io.run import Run, is_run
from ..pipeline.blocks import BLOCK, FrameFolders, blocks
from .report import torn


@dataclass(frozen=True)
class Alignment:
    """Frames aligned by their own pictures, frames without pictures that slide as those of their block, frames whose pictures
    could not be used with why, frames that wait for other shards; whether the new run is whole; what should be known of it."""

    matched: tuple[int, ...]
    between: tuple[int, ...]
    failed: dict[int, str]
    pending: tuple[int, ...]
    whole: bool
    warnings: tuple[str, ...] = ()


def outcome_of(run: Run, out: Path, results: FrameFolders, span) -> Alignment:
    """What the Alignment of a run into `out` is so far; `results` are its slides, `span` the frames that are held out."""
    pictured = set(run.pictured)
    failed = {number: why for number in run.pictured if (why := results.reason(number)) is not None}
    matched = tuple(number for number in run.pictured if results.whole(number))
    pending = tuple(number for number in run.pictured if not results.done(number))
    between, left = [], []
    for block in blocks(run.ok, held(span)):
        slides = not {*matched, *pending}.isdisjoint(block)
        (between if slides else left).extend(number for number in block if number not in pictured)
    warnings = (*_unmatched(left), *_blind(run, results), *torn(out))
    return Alignment(matched, tuple(between), failed, pending, is_run(out), warnings)


def _unmatched(left):
    """What to say of frames without pictures in whose blocks none was matched."""
    if left:
        frames = frame_ranges(left, 4)
        yield f"frames {frames} lie as they were registered: no picture of their blocks of {BLOCK} was matched"


def _blind(run, results):
    """What to say of frames whose pictures show nothing of a garment."""
    lines = [line for line in results.status.lines() if line.get("stage") == "align"]
    unseen = {line.get("frame"): line.get("blind", ()) for line in lines}  # the last line of a frame counts
    for name in run.garments:
        if frames := sorted(number for number, garments in unseen.items() if name in garments):
            words = f"frames {frame_ranges(frames, 4)}: the pictures show nothing of garment {name}, as where masks are empty"
            yield f"{words}: it slides as in the frames beside them"
