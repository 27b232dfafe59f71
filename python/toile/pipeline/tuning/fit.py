"""Is a garment's template of the size and the cut that the capture shows?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...io.run import Run
from ...surface.loops import loop_length

SEEN = 0.6  # share of a loop that a frame must show, for its length to count
NEVER = 0.1  # a loop of which frames show no more is missing, tucked in or covered
SAME = 0.12  # lengths this near to the template's are its own
TOGETHER = 0.1  # loops that are off by the same factor, to this, tell of another size


@dataclass(frozen=True)
class LoopFit:
    """A loop as the frames show it: its length over that of the template's file (None where no frame shows enough of it),
    the share seen and the distance [mm] to the opening that was seen, medians over the frames."""

    name: str
    ratio: float | None
    seen: float
    off_mm: float | None


def loop_fits(run: Run, garment: str) -> list[LoopFit]:
    """One LoopFit a loop of a registered garment."""
    worn, mesh, found = run.garments[garment], run.capture.templates.get(garment), []
    told = [run.diagnostics.at(number).get(f"dress {garment}", {}) for number in run.ok]
    for name, loop in worn.loops.items():
        seen = np.array([of.get(f"loop_observed.{name}", 0.0) for of in told])
        off = [of[f"loop_mm.{name}"] for of in told if of.get(f"loop_mm.{name}", -1.0) >= 0]
        lengths = [loop_length(worn.at(n)[loop]) for n, share in zip(run.ok, seen) if share >= SEEN]
        known = mesh is not None and len(mesh.vertices) == worn.vertices.shape[1] and lengths
        ratio = float(np.median(lengths) / loop_length(mesh.vertices[loop])) if known else None
        found.append(
            LoopFit(name, ratio, float(np.median(seen)) if len(seen) else 0.0, float(np.median(off)) if off else None)
        )
    return found


def diagnosis(fits: list[LoopFit]) -> list[str]:
    """In words, what does not fit; nothing where all does."""
    said = [f"loop {fit.name} is not seen: missing, tucked in or covered" for fit in fits if fit.seen < NEVER]
    ratios = {fit.name: fit.ratio for fit in fits if fit.ratio is not None}
    if not ratios:
        return said
    middle = float(np.median(list(ratios.values())))
    if abs(middle - 1) > SAME:
        alike = all(abs(ratio / middle - 1) <= TOGETHER for ratio in ratios.values())
        way = "smaller" if middle < 1 else "larger"
        said.append(
            f"the garment worn is {way} than its template, loops {middle:.2f} times as long: "
            + ("another size of the same cut" if alike else "another size, and not the same cut")
        )
    for name, ratio in ratios.items():
        if abs(ratio / middle - 1) > SAME:
            said.append(
                f"loop {name} is {ratio:.2f} times as long as the template's, the others {middle:.2f}: another cut"
            )
    return said
