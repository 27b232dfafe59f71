"""Components of a garment that have no loop, such as buttons and badges: they follow the cloth about them rigidly."""

from dataclasses import replace

import numpy as np

from .. import kernels

_PATCH = 16  # cloth vertices about an attachment that turn it


class Attachments:
    """Which vertices of a garment of faces F (m,3) and n vertices are cloth, and which are attached to it.

    `cloth` (c,) indices of the vertices of components with a loop, of all where none has one; `faces` (f,3) their faces, into those alone; `parts`
    [indices], the others by component."""

    def __init__(self, F, n):
        loops = kernels.boundary_loops(F)
        component = kernels.vertex_components(F, n)
        open_ones = np.unique(component[np.concatenate(loops)] if loops else component)
        is_cloth = np.isin(component, open_ones)
        self.cloth = np.flatnonzero(is_cloth)
        self.number = np.cumsum(is_cloth) - 1  # (n,) of each cloth vertex among the cloth's
        self.of_cloth = is_cloth[F[:, 0]]  # (m,)
        self.faces = np.ascontiguousarray(self.number[F[self.of_cloth]], np.int32)
        self.parts = [np.flatnonzero(component == k) for k in np.setdiff1d(np.unique(component), open_ones)]

    def cloth_of(self, template):
        """The GarmentTemplate without what is attached."""
        if not self.parts:
            return template
        return replace(
            template,
            rest=template.rest[self.cloth],
            faces=self.faces,
            face_uv=template.face_uv[self.of_cloth],
            skin=template.skin[self.cloth],
            loops=tuple(self.number[loop].astype(np.int32) for loop in template.loops),
        )

    def follow(self, before, cloth):
        """All vertices (n,3) where the cloth's lie at `cloth` (c,3): each part of the garment `before` (n,3) moves with the
        cloth point nearest to its middle, and turns as the cloth about that point does."""
        if not self.parts:
            return cloth
        after = np.empty((len(before), 3))
        after[self.cloth] = cloth
        for part, face, bary in self._anchors(before):
            corners = self.faces[face]
            start, end = bary @ before[self.cloth][corners], bary @ cloth[corners]
            near = np.argsort(np.linalg.norm(before[self.cloth] - start, axis=1), kind="stable")[:_PATCH]
            turn = _rotation(before[self.cloth][near] - start, cloth[near] - end)
            after[part] = end + (before[part] - start) @ turn.T
        return after

    def extend(self, before, values):
        """Values (c, ...) of the cloth's vertices on all (n, ...): a part has those of the cloth vertex nearest to it."""
        if not self.parts:
            return values
        every = np.empty((len(before), *values.shape[1:]), values.dtype)
        every[self.cloth] = values
        for part, face, bary in self._anchors(before):
            every[part] = values[self.faces[face][bary.argmax()]]
        return every

    def _anchors(self, before):
        """(part, face, barycentrics) of the cloth point that is nearest to each part's middle."""
        middle = np.array([before[part].mean(0) for part in self.parts])
        face, _, bary, _ = kernels.SurfaceIndex(before[self.cloth], self.faces).closest(middle)
        return zip(self.parts, face, bary)


def _rotation(a, b):
    """The rotation (3,3) that takes directions a (k,3) to b (k,3) best (Kabsch 1976)."""
    U, _, Wt = np.linalg.svd(a.T @ b)
    flip = np.diag([1, 1, np.sign(np.linalg.det(U) * np.linalg.det(Wt))])
    return (U @ flip @ Wt).T
