"""The body under the garments, fused from every frame of a run: passes over its blocks, whose parts wait in files until
their turn, so that neither the number of frames nor who gathers them changes the memory or a bit."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path

from ..io.files import load_record, save_record
from ..io.status import Status
from ..scene import InnerShape
from ..stages.inner import Gathered
from .blocks import Progress
from .workers import Workers


def fuse(
    blocks: Sequence[Sequence[int]],
    load: Callable,
    folder: Path,
    prepared,
    pool: Workers,
    status: Status,
    progress: Progress,
) -> InnerShape:
    """The InnerShape of these blocks of frame numbers. `load(prepared, number)` gives a frame's Tracked, Segmented and
    {garment: Dressed}; `folder` is this function's own. `prepared.fusion` is a stages.inner.Fusion, of each process. How
    many passes over all frames it takes shows as it goes on."""
    fusion, passes = prepared.fusion, 0
    while not fusion.done:
        passes += 1
        shutil.rmtree(folder, ignore_errors=True)  # what a killed process left
        done = pool.each(partial(_gather, fusion.guess, load, folder, status), list(enumerate(blocks)))
        fusion.step(_in_order(_told(done, blocks, partial(progress, f"fuse, pass {passes}")), folder))
    shutil.rmtree(folder, ignore_errors=True)
    return fusion.shape()


def _gather(guess, load, folder, status, prepared, block):
    """Writes what one (index, numbers) says at a guess, and yields its index."""
    (index, numbers), fusion = block, prepared.fusion
    with status.timing(len(numbers), stage="fuse") as ends:
        save_record(_part(folder, index), fusion.gather(guess, _loaded(load, prepared, numbers, ends)))
    yield index


def _loaded(load, prepared, numbers, ends):
    """The frames; of each it is told when the next one is asked for."""
    for number in numbers:
        yield load(prepared, number)
        ends()


def _told(done, blocks, progress):
    """The indices, each told as so many frames of all."""
    behind, total = 0, sum(map(len, blocks))
    for index in done:
        behind += len(blocks[index])
        progress(behind, total)
        yield index


def _in_order(done: Iterable[int], folder: Path) -> Iterator[Gathered]:
    """The blocks' parts in the blocks' order, in whichever they are done; each file goes when it was read."""
    there, following = set(), 0
    for index in done:
        there.add(index)
        while following in there:
            yield load_record(_part(folder, following), Gathered)
            _part(folder, following).unlink()
            following += 1


def _part(folder, index):
    return folder / f"{index:06d}.npz"
