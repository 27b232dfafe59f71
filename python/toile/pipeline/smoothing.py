"""Frames smoothed over time, a block of 50 absolute numbers at a time, each with a margin of the frames beside it. All of
them are read as the first stages made them, and what is smoothed lies in files of its own: so a block's border leaves no
seam, and who smooths which block, or again, changes no bit."""

from __future__ import annotations

import time
from bisect import bisect_left
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path

from ..io.files import identity_of, load_record, save_record
from ..io.holdout import apart, held
from ..scene import Dressed, Tracked
from ..stages.motion import Strengths, scans_show, strength_of
from .blocks import BLOCK, FrameFolders, Progress, blocks
from .workers import Workers


def smooth(
    load: Callable,
    numbers: Sequence[int],
    smoothed: FrameFolders,
    prepared,
    pool: Workers,
    progress: Progress = lambda stage, done, total: None,
) -> None:
    """Smooths the frames `numbers` into the folders of `smoothed`; `load(prepared, number)` gives a frame's Tracked and
    {garment: Dressed}. Frames that do not follow one another say nothing of each other, nor do those held out and the others. `prepared.smoother` is a
    stages.motion.Smoother, of each process."""
    numbers, settings, span = sorted(numbers), prepared.config.motion, prepared.config.holdout
    known, held_out = apart(numbers, span), held(span)
    kept, identity = prepared.folder / "strengths.npz", prepared.identities.stages["motion"]
    if identity_of(kept) != identity:
        gathered = {}
        for index, rough in pool.each(partial(_gather, load, smoothed.status), list(enumerate(blocks(known)))):
            gathered[index] = rough
            progress("flicker", sum(len(blocks(known)[i]) for i in gathered), len(known))
        total = sum((gathered[index] for index in sorted(gathered)), prepared.smoother.nothing())
        save_record(kept, strength_of(total, settings.max_strength, settings.pose_factor), identity)
    left = [own for own in blocks(numbers, held_out) if not all(map(smoothed.whole, own))]
    beside = lambda own: [number for number in numbers if number in held_out] if own[0] in held_out else known
    around = [(own, _around(beside(own), own[0] // BLOCK, settings.margin + prepared.smoother.reach)) for own in left]
    done = 0
    for count in pool.each(partial(_smooth, load, smoothed, load_record(kept, Strengths)), around):
        done += count
        progress("smooth", done, sum(map(len, left)))


def load_layers(folder: Path, templates, slid: Path | None = None) -> tuple[Tracked, dict[str, Dressed]]:
    """A frame's tracked surface and garments, from a folder of the first stages or of `smooth`; those that the folder `slid`
    has from there."""
    dressed = {}
    for name in (f"dress.{t.name}.npz" for t in templates):
        from_there = slid is not None and (slid / name).exists()
        dressed[name] = load_record((slid if from_there else folder) / name, Dressed)
    return load_record(folder / "track.npz", Tracked), dict(zip((t.name for t in templates), dressed.values()))


def _around(numbers, block, margin):
    """Those of the numbers, in order, that lie in the block or in its margins."""
    ends = block * BLOCK - margin, (block + 1) * BLOCK + margin
    first, last = (bisect_left(numbers, end) for end in ends)
    return numbers[first:last]


def _consecutive(numbers):
    """The numbers, in order, cut where one does not follow the other."""
    cuts = [i + 1 for i, (a, b) in enumerate(pairwise(numbers)) if b != a + 1]
    return [numbers[a:b] for a, b in pairwise([0, *cuts, len(numbers)])]


def _gather(load, status, prepared, block):
    """Yields what one (index, numbers) says of its roughness: nothing where frames lie too far apart in time for motion to be told from
    noise."""
    index, numbers = block
    total = prepared.smoother.nothing()
    near = prepared.capture.scene.fps * prepared.config.motion.near >= 1
    with status.timing(len(numbers), stage="flicker"):
        for run in _consecutive(numbers) if near else ():
            total += prepared.smoother.gather([load(prepared, n) for n in run])
    yield index, total


def _smooth(load, smoothed, strengths, prepared, block):
    """Writes one block's frames, given (its numbers, those with its margins); yields how many."""
    own, around = block
    for run in _consecutive(around):
        wanted = sorted(set(run) & set(own))
        start, used = time.perf_counter(), time.process_time()
        if wanted:
            layers = _telling(load, prepared, run, own[0] // BLOCK)
            made = dict(zip(layers, prepared.smoother.smooth(list(layers.values()), strengths)))
        for number in wanted:
            _save(smoothed, number, *made[number])
        for number in wanted:
            took = {
                "seconds": (time.perf_counter() - start) / len(wanted),
                "cpu": (time.process_time() - used) / len(wanted),
            }
            smoothed.status.add(frame=number, stage=smoothed.stage, **took, ok=True)
    yield len(own)


def _telling(load, prepared, run, block):
    """{number: its layers} of the frames of a run that tell of the block: those in its margins and, where scans show only some, those
    as far beyond as a scan tells of."""
    near = _around(run, block, prepared.config.motion.margin)
    layers = {n: load(prepared, n) for n in near}
    if scans_show(list(layers.values())).all():
        return layers
    wide = {n: layers[n] if n in layers else load(prepared, n) for n in run}
    return wide if scans_show(list(wide.values())).any() else layers


def _save(smoothed, number, tracked, dressed):
    folder = smoothed.folder(number)
    save_record(folder / "track.npz", tracked)
    for name, garment in dressed.items():
        save_record(folder / f"dress.{name}.npz", garment)
    smoothed.end(number)
