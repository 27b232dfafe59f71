"""How wide a garment is near its openings, told by the cloth a hand's breadth from them."""

import numpy as np

from .. import kernels
from .curves import isolines
from .loops import loop_length
from .operators import distance_along_edges


class Girths:
    """Of each loop of a garment the curve through the cloth `distance` [m] from it, along edges of V (n,3) with faces F
    (f,3). What cuts an opening short, a web in the scan above all, leaves that curve as long as it is."""

    def __init__(self, V, F, loops, distance):
        edges = kernels.unique_edges(F)
        self.away = [distance_along_edges(V, edges, loop) for loop in loops]
        self.F, self.loops, self.distance = F, loops, distance

    def __call__(self, V):
        """Lengths (l,) [m] on a surface (n,3) of the same faces; NaN of a loop where the curve is not one closed curve."""
        found = [isolines(V, self.F, away, self.distance) for away in self.away]
        return np.array([c[0].length if len(c) == 1 and c[0].closed else np.nan for c in found])

    def flares(self, V):
        """Each loop's length over its curve's (l,) on such a surface; NaN where it has none."""
        return np.array([loop_length(V[loop]) for loop in self.loops]) / self(V)
