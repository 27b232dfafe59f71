"""A surface against a scan from both sides, over few points: a lost limb, another heading, a part that no scan shows."""

from __future__ import annotations

import numpy as np

from .sampling import by_area

FAR = 0.05  # two surfaces of one person are nowhere farther apart [m], but where one of them is not the other's
SCAN_POINTS, SURFACE_POINTS = 1500, 1500


class TwoSided:
    """Measures vertices of one topology against one scan; `looks` (k,): the vertices that scans can show."""

    def __init__(self, scan, looks):
        face = by_area(scan.vertices, scan.faces, SCAN_POINTS)[0]
        self.scan, self.points, self.looks = scan, scan.vertices[scan.faces[face]].mean(1), looks

    def __call__(self, V, lacking=None):
        """(distance, astray) of vertices V (n,3), of which the scan is known to lack those where `lacking` (n,) is true: the mean of
        the distances [m] from either side, each counted up to twice FAR; and the smaller of the two sides' shares beyond FAR. What is
        only missing from one of the two is not astray."""
        from scipy.spatial import cKDTree

        of_scan = cKDTree(V[self.looks], balanced_tree=False, compact_nodes=False).query(self.points)[0]
        looks = self.looks if lacking is None else self.looks[~lacking[self.looks]]
        of_surface = self.scan.index.closest(V[looks[:: max(len(looks) // SURFACE_POINTS, 1)]], 2 * FAR)[3]
        sides = of_scan, of_surface
        near = float(np.mean([np.minimum(side, 2 * FAR).mean() for side in sides]))
        return near, float(min((side > FAR).mean() for side in sides))


def middle_of(V):
    """The middle (3,) of the box about points."""
    return (V.min(0) + V.max(0)) / 2


def principal_axis(V, F):
    """The unit direction (3,) in which a surface's area spreads most."""
    face = by_area(V, F, SCAN_POINTS)[0]
    points = V[F[face]].mean(1)
    return np.linalg.svd(points - points.mean(0), full_matrices=False)[2][0]


def outside_of(model):
    """Vertices (k,) of a body model that scans can show."""
    return np.flatnonzero(~model.inside)
