"""The pass over a run's frames in which printed garments slide until their prints lie still: a reference of frames spread
over the run, then blocks of 50 absolute numbers that share nothing else."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial

from ..errors import first_line
from ..io.files import identity_of, load_record, save_record
from ..io.holdout import apart, held
from ..prints.aligner import PrintAligner
from ..prints.matching import Matched
from ..prints.reference import NEAR, Reference, anchors_and_samples
from ..prints.smoothing import over_time
from ..stages import prints
from .blocks import FrameFolders, Progress, blocks
from .overlap import overlapped
from .workers import Workers

BLIND = (
    "prints: in some frames the pictures show nothing of garment {}, as where masks are empty: it slides as beside them"
)


def slide(load: Callable, numbers: Sequence[int], slid: FrameFolders, prepared, pool: Workers, progress: Progress):
    """Slides the printed garments of the frames `numbers` into the folders of `slid`. `load(prepared, number)` gives a
    frame's Tracked, Segmented and {garment: Dressed}. `prepared.aligner` is a PrintAligner, of each process."""
    _make_references(load, numbers, prepared, progress)
    left = [own for own in blocks(numbers, held(prepared.config.holdout)) if not all(map(slid.whole, own))]
    for i, _ in enumerate(pool.each(partial(_slide, load, slid), left)):
        progress("prints", i + 1, sum(map(len, left)))


def reference_path(prepared, name):
    return prepared.folder / f"print.{name}.npz"


def _make_references(load, numbers, prepared, progress):
    """Makes the reference of every printed garment, unless it is there, of frames that are not held out."""
    paths = {name: reference_path(prepared, name) for name in prepared.aligner.matchers}
    pictured = [number for number in apart(numbers, prepared.config.holdout) if prepared.capture.pictured(number)]
    identity = prepared.identities.stages["prints"]
    if all(identity_of(path) == identity for path in paths.values()) or not pictured:
        return

    def read(number):
        layers = load(prepared, number)
        return prints.views(prepared.aligner, prepared.capture.pictures(number), *layers), posed(layers[-1])

    for name, reference in references(prepared.aligner, pictured, read, progress).items():
        save_record(paths[name], reference, identity)


def references(aligner: PrintAligner, pictured: Sequence[int], read: Callable, progress: Progress):
    """The {garment: Reference} of frames that have pictures. `read(number)` gives a frame's Views and {garment: vertices (g,3)}."""
    settings = aligner.settings
    anchors, samples = anchors_and_samples(
        pictured, blocks(pictured)[0], settings.anchor_frames, settings.sample_frames
    )
    views, surfaces, chosen = [], [], [*anchors, *samples]
    for number in chosen:
        seen, V = read(number)
        views.append(seen)
        surfaces.append(V)
        progress("reference print", len(views), len(chosen))
    return aligner.references(chosen, views, surfaces, len(anchors))


def posed(dressed):
    """{garment: vertices (g,3)} of {garment: Dressed}."""
    return {name: garment.vertices for name, garment in dressed.items()}


def _slide(load, slid, prepared, numbers) -> Iterator[int]:
    """Matches and slides one block's frames; yields each number. Frames without pictures, and those whose prints could not
    be matched, slide as the frames beside them."""
    aligner, found = prepared.aligner, {}
    pictured = [number for number in numbers if prepared.capture.pictured(number)]
    paths = {name: reference_path(prepared, name) for name in aligner.matchers if pictured}
    targets = aligner.targets({name: load_record(path, Reference) for name, path in paths.items()})
    seconds = dict.fromkeys(numbers, 0.0)

    def begin(number, before):
        start = time.perf_counter()
        layers = load(prepared, number)
        views = prints.views(aligner, prepared.capture.pictures(number), *layers)
        seconds[number] += time.perf_counter() - start
        yield
        start = time.perf_counter()
        near = before is not None and number - before <= NEAR
        found[number] = aligner.match(number, views, posed(layers[-1]), targets, found[before] if near else None)
        for name in (name for name, matched in found[number].items() if matched.blind):
            slid.status.add(frame=number, stage=slid.stage, ok=True, warning=BLIND.format(name))
        seconds[number] += time.perf_counter() - start

    for number, error in overlapped(begin, pictured):
        if error is not None:
            slid.status.add(frame=number, stage=slid.stage, ok=False, warning=f"prints: {first_line(error)}")
        yield number
    for number in numbers:
        start = time.perf_counter()
        _write(slid.folder(number), prepared, load(prepared, number)[-1], _slides(prepared, found, number))
        seconds[number] += time.perf_counter() - start
        slid.end(number)
        slid.status.add(frame=number, stage=slid.stage, seconds=seconds[number], ok=True)
        if number not in pictured:
            yield number


def _slides(prepared, found, number) -> dict[str, Matched]:
    """A frame's slides by garment: as found, else from the frames about it; none where none was found."""
    if number in found or not found:
        return found.get(number, {})
    made = {}
    for name in prepared.aligner.matchers:
        slides = [matched[name].d for matched in found.values()]
        fps, settings = prepared.capture.scene.fps, prepared.config.prints
        made[name] = Matched(over_time(list(found), slides, [number], fps, settings)[0], 0.0, 0.0, 0.0, 0.0)
    return made


def _write(folder, prepared, dressed, slides):
    for name in prepared.aligner.matchers:
        garment = dressed[name]
        if name in slides:
            garment = prints.slid(prepared.aligner, name, garment, slides[name].d)
        save_record(folder / f"dress.{name}.npz", garment)
