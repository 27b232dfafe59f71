"""Settings of `toile reconstruct`."""

from __future__ import annotations

from typing import Any

from ..errors import UserError
from .changes import changed
from .settings import Settings, setting
from .triangulation import ReconstructSettings


class MatchSettings(Settings):
    """Depth maps, see kernels.StereoSolver."""

    sources: int = setting(4, "count", "other cameras that a picture is compared with", ge=1, le=16)
    best: int = setting(2, "count", "of these the best count, pixel by pixel", ge=1)
    max_angle: float = setting(1.2, "rad", "between two cameras, beyond which they are not compared", gt=0)
    coarsest: int = setting(800, "px", "longer side of the coarsest level, at most", ge=16)
    start_iterations: int = setting(3, "count", "of PatchMatch on the coarsest level, by the pictures alone", ge=0)
    coarse_iterations: int = setting(2, "count", "on every level but the finest", ge=0)
    iterations: int = setting(2, "count", "on the finest level", ge=0)
    refinements: int = setting(2, "count", "of depth and slopes on the bent surface, two Gauss-Newton steps each", ge=0)
    spacing: float = setting(1.2, "px", "between the samples of a window, 6 to a side", gt=0, le=64)
    colour: float = setting(16.0, "1", "difference of grey, of 255, at which a sample counts half", gt=0)
    noise: float = setting(0.5, "1", "of grey values, of 255: fainter textures match anything", gt=0)
    consistency: float = setting(0.3, "1", "cost of a depth that another camera's contradicts", ge=0)
    contradiction: float = setting(2.0, "px", "disparity from which on depths contradict one another wholly", gt=0)
    max_cost: float = setting(0.6, "1", "1 - correlation; beyond there is a hole", gt=0)
    agreement: float = setting(1.0, "px", "disparity up to which depths agree", gt=0)
    min_views: int = setting(1, "count", "other cameras whose depths have to agree", ge=0)
    seed: int = setting(0, "count", "of the random planes", ge=0)


class FuseSettings(Settings):
    """Points of depth maps, see kernels.fuse_depths."""

    agreement: float = setting(1.0, "px", "distance between surfaces up to which pixels are of one point", gt=0)
    min_cosine: float = setting(0.5, "1", "least agreement of their normals", ge=-1, le=1)
    min_views: int = setting(3, "count", "cameras that a point needs, or all where there are fewer", ge=1)


class SurfaceSettings(Settings):
    """The scan: a screened Poisson surface of the points, cut where nothing supports it. A pixel is as large as it is at the
    points' middle depth."""

    least_confidence: float = setting(0.0, "1", "a point that is less sure counts for nothing", ge=0, le=1)
    cell: float = setting(1.5, "px", "of the Poisson octree", gt=0)
    largest_depth: int = setting(11, "count", "of that octree, at most", ge=4, le=14)
    reach: float = setting(2.0, "px", "a vertex farther from every point is cut away", gt=0)
    neighbours: int = setting(4, "count", "nearest points whose confidence a vertex takes", ge=1)
    outside: int = setting(2, "count", "masks outside of which a vertex is cut away", ge=1)
    border: float = setting(2.0, "px", "so far beyond a mask's border still counts as inside", ge=0)
    least_part: float = setting(0.01, "1", "share of the vertices below which a separate piece is cut away", ge=0, le=1)


class StereoSettings(Settings):
    """From pictures to scans."""

    margin: int = setting(6, "px", "that a picture keeps about its mask", ge=0)
    reduction: int = setting(1, "px", "side of the squares of a picture that become one pixel at first", ge=1, le=8)
    match: MatchSettings = MatchSettings()
    fuse: FuseSettings = FuseSettings()
    surface: SurfaceSettings = SurfaceSettings()


class ScanConfig(Settings):
    """All settings of `toile reconstruct`."""

    quality: str = setting("standard", "name", "draft, standard or fine: the preset that the others start from")
    stereo: StereoSettings = StereoSettings()
    reconstruct: ReconstructSettings = ReconstructSettings()


SCAN_PRESETS: dict[str, dict[str, Any]] = {
    "draft": {
        "stereo.reduction": 2,
        "stereo.match.coarsest": 400,
        "stereo.match.iterations": 1,
        "stereo.match.refinements": 1,
    },
    "standard": {},
    "fine": {
        "stereo.match.start_iterations": 8,
    },
}


def scan_preset(quality: str) -> ScanConfig:
    """The settings of a quality. UserError: no such quality."""
    if quality not in SCAN_PRESETS:
        raise UserError(f"--quality {quality}: expected one of {', '.join(SCAN_PRESETS)}")
    return changed(ScanConfig(), SCAN_PRESETS[quality], {"quality": quality})
