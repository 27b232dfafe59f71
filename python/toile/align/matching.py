"""Each pictured frame of an alignment, matched to the references; its slides lie in OUT/slides."""

from __future__ import annotations

import time

from ..io.files import load_record, save_record
from ..pipeline.blocks import FrameFolders
from ..prints.matching import Matched
from .preparation import PreparedAlignment
from .surfaces import garments_at


def match(prepared: PreparedAlignment, number, previous, results) -> None:
    """Matches a frame's prints to the references, from the slides of the frame `previous` if there is one."""
    start, run = time.perf_counter(), prepared.run
    before = None if previous is None else {name: matched_in(results, previous, name) for name in run.garments}
    matched = prepared.aligner.match(number, prepared.views(number), garments_at(run, number), prepared.targets, before)
    for name, slide in matched.items():
        save_record(results.folder(number) / f"{name}.npz", slide)
    blind = [name for name, slide in matched.items() if slide.blind]
    results.status.add(frame=number, stage="align", seconds=time.perf_counter() - start, ok=True, blind=blind)


def matched_in(results: FrameFolders, number: int, name: str) -> Matched:
    """What came of the garment `name` in a frame that was matched."""
    return load_record(results.folder(number) / f"{name}.npz", Matched)
