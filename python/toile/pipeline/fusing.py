"""The body under the garments, fused from every frame of a run: passes over its blocks, whose parts wait in files until
their turn, so that neither the number of frames nor who gathers them changes the memory or a bit."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path

from ..io.files import load_record, save_record
from ..scene import InnerShape
from ..stages.inner import Gathered
from .workers import Workers


def fuse(blocks: Sequence[Sequence[int]], load: Callable, folder: Path, prepared, pool: Workers) -> InnerShape:
    """The InnerShape of these blocks of frame numbers. `load(prepared, number)` gives a frame's Tracked, Segmented and
    {garment: Dressed}; `folder` is this function's own. `prepared.fusion` is a stages.inner.Fusion, of each process."""
    fusion = prepared.fusion
    while not fusion.done:
        shutil.rmtree(folder, ignore_errors=True)  # what a killed process left
        done = pool.each(partial(_gather, fusion.guess, load, folder), list(enumerate(blocks)))
        fusion.step(_in_order(done, folder))
    shutil.rmtree(folder, ignore_errors=True)
    return fusion.shape()


def _gather(guess, load, folder, prepared, block):
    """Writes what one (index, numbers) says at a guess, and yields its index."""
    index, numbers = block
    save_record(_part(folder, index), prepared.fusion.gather(guess, (load(prepared, number) for number in numbers)))
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
