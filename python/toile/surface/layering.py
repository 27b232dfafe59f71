"""Garments out of the skin and of one another, inner to outer. What is attached to the cloth follows it."""

from dataclasses import dataclass

import numpy as np

from .. import kernels
from .attachments import Attachments


@dataclass(frozen=True)
class Layered:
    """Garments moved: `vertices` {name: (g,3)}; `depth_before` {name: m}; triangle pairs of garments with what lies under
    them, as given and left."""

    vertices: dict[str, np.ndarray]
    depth_before: dict[str, float]
    intersections_before: int
    intersections_left: int


class Layering:
    """`garments` [(name, faces, number of vertices)], inner to outer, over a skin of `n` vertices; the solvers are kept
    between frames. `margin` [m] of a garment off what lies under it; `rounds` at most, since a push out of one layer may
    lead into another, and a stalled one goes on from where it stands; other options are those of kernels.UntangleSolver."""

    def __init__(self, skin_faces, n, garments, margin, rounds=3, **options):
        self.skin_faces, self.n, self.rounds, self.solvers = skin_faces, n, rounds, {}
        self.attachments = {name: Attachments(F, g) for name, F, g in garments}
        self.garments = [(name, a.faces, len(a.cloth)) for name, a in self.attachments.items()]
        self.options = {"margin": margin, **options}

    def solve(self, skin_V, cloth):
        """`cloth` {name: (g,3)} -> Layered: each garment out of the skin and of the garments under it."""
        cloth = {name: np.asarray(V) for name, V in cloth.items()}
        under, moved, depth, before, left = [("", np.asarray(skin_V), self.skin_faces)], {}, {}, 0, 0
        for name, F, n in self.garments:
            a = self.attachments[name]
            V, found, clear = self._out_of(name, F, n, cloth[name][a.cloth], under)
            depth[name] = max(float(np.max(r.depth_before, initial=0)) for r in found)
            before += sum(r.intersections_before for r in found)
            left += 0 if clear else sum(len(kernels.intersecting_pairs(V, F, U, U_F)) for _, U, U_F in under)
            moved[name] = a.follow(cloth[name], V)
            under.append((name, V, F))
        return Layered(moved, depth, before, left)

    def move_inside(self, cloth, hidden):
        """`cloth` with what is `hidden` {name: (g,) bool} of a garment moved inside the garments over it."""
        attachments = self.attachments
        moved = {name: np.asarray(V)[attachments[name].cloth] for name, V in cloth.items()}
        for i, (name, F, n) in enumerate(self.garments):
            concealed = hidden[name][attachments[name].cloth][:, None]
            for over, over_F, over_n in self.garments[i + 1 :]:
                solver = self._solver((name, f"in {over}"), F, n, over_F[:, ::-1], over_n)
                moved[name] = np.where(concealed, solver.solve(moved[name], moved[over]).V, moved[name])
        return {name: attachments[name].follow(np.asarray(cloth[name]), V) for name, V in moved.items()}

    def _out_of(self, name, F, n, V, under):
        """V out of all layers `under` it; the first round's results, a layer each; and whether nothing is left of one."""
        first, found = [], None
        for turn in range(self.rounds):
            start = V
            for other, U, U_F in under:
                found = self._solver((name, other), F, n, U_F, len(U)).solve(V, U)
                V = np.asarray(found.V)
                if turn == 0:
                    first.append(found)
            if np.array_equal(V, start) or (len(under) == 1 and found.stop == "clear"):
                break
        return V, first, len(under) == 1 and found.intersections_left == 0

    def _solver(self, key, F, n, under_F, under_n):
        if key not in self.solvers:
            self.solvers[key] = kernels.UntangleSolver(F, n, np.ascontiguousarray(under_F), under_n, **self.options)
        return self.solvers[key]
