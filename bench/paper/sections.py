"""The page's sections: each answers figures and tables of the paper, which it names, with what is measured and drawn here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from .parts import ablations, alignment, intersections, qualities, windows
from .tables import against, beside_the_paper, drivers, means, sizes, visible


@dataclass(frozen=True)
class Section:
    """`paper`: what the paper shows there; `here`: what stands beside it. `tables` of what was found; `pictures`: (glob in a subject's
    folder, what they show)."""

    title: str
    paper: str
    here: str
    tables: tuple[Callable, ...] = ()
    pictures: tuple[tuple[str, str], ...] = ()


SECTIONS = (
    Section(
        "Section 7.1: captured data",
        "Three people, some 140 cameras of 4096 x 2668 px at 30 pictures a second, a script of peak poses and ten minutes of "
        "conversation: 40 to 50 thousand frames each, 4 to 5 thousand of them, in a row, held out.",
        "What the table says. Without captures of one's own they are of a studio, which draws people with full truth, and what is held "
        "out is held out of registration, alignment and training alike.",
        (sizes,),
    ),
    Section(
        "Figures 8 and 9: textures before and after alignment",
        "Figure 8: textures unwrapped from the pictures, and their error to the anchor frames' mean, before and after alignment by "
        "inverse rendering. Figure 9: their mean, which gets sharper, and their standard deviation over the frames, which gets smaller.",
        "The same of each garment. Frames: texture before, its error, texture after, its error; a row a frame.",
        (alignment,),
        (
            ("aligned/alignment/*_frames.png", "frames and their errors to the anchors' mean (Figure 8)"),
            ("aligned/alignment/*_mean_*.png", "mean (Figure 9)"),
            ("aligned/alignment/*_deviation_*.png", "standard deviation (Figure 9)"),
        ),
    ),
    Section(
        "Table 1, Figures 10 to 12: driven, against one surface",
        "A single-layer avatar (Bagautdinov et al. 2021), driven by a code drawn from a unit Gaussian, against two layers, driven by the "
        "temporal model's codes. Layers are 22 to 29 % nearer.",
        "Both ways of comparing: as the paper drives, and each avatar at its strongest. The single layer has as many parameters, steps, "
        "code numbers and texels on the cloth as the layers; it has no alignment by prints, and no remainder of its shape. A minus says "
        "that layers are nearer.",
        (beside_the_paper, means, partial(against, how="shown"), partial(against, how="driven"), drivers, visible),
        (("seed*/driven/*.png", "driven by pose and face alone, as `toile animate` shows it"),),
    ),
    Section(
        "Beyond the paper: the frame itself is encoded",
        "Not measured there.",
        "What networks keep of a frame that they were not taught, before anything is driven.",
        (partial(against, how="reconstruction"),),
        (("seed*/sheets/*.png", "encoded"),),
    ),
    Section(
        "Figure 7: intersections resolved",
        "One example: skin shows through the decoded shirt, and does not after the shirt is moved out.",
        "Of eight held-out frames, driven by codes, the view in which it shows most; pairs of triangles are counted in all frames. Where "
        "cloth has no room, skin gives way too.",
        (intersections,),
        (("figures/collision.png", "driven by codes"),),
    ),
    Section(
        "Figure 13: ablations",
        "Pictures: (A) shape and texture regressed directly from a window of poses blur the print; (B) so does training without texture "
        "alignment; (C) without view conditioning the brightness near silhouettes is wrong.",
        "The same comparisons and more, in pictures and figures; what they find need not be what the paper finds. One subject, each row "
        "trained for as many steps (quality presets for as many minutes), driven by codes.",
        (ablations, qualities),
        (("ablations/zooms/*.png", "without one part, and in full"),),
    ),
    Section(
        "Supplementary material: the window of the temporal model",
        "Windows of L = 1, 3 and 8 poses at 30 a second jitter; L = 15 or 30 is a good trade.",
        "The same codes foretold by models of other windows. Poses stand as far apart as the pictures do.",
        (windows,),
    ),
    Section(
        "Figures 1 and 14: edited textures",
        "Driven frames in other colours, in a checkerboard, in an artist's pattern and with a logo.",
        "Four such edits on held-out frames, driven as `toile animate` shows them.",
        pictures=(("figures/edits.png", "edited"),),
    ),
    Section(
        "Figure 15: the same edit by layers and by one surface",
        "The garment is marked on the single layer's texture in one frame; in others the blue leaves the shirt.",
        "The same: first the frame in which it was marked, then held-out ones, all encoded. Above each picture stands how far the edited "
        "region's border lies from the garment's. What the first frame did not show of the garment stays unmarked, and its borders count.",
        pictures=(("figures/single.png", "the colour edit"),),
    ),
)


def tables(found):
    """All tables that have a row, in the order of the page."""
    made = [make(found) for section in SECTIONS for make in section.tables]
    return [table for table in made if table.rows]
