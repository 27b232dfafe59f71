"""Registered motion against the true one, a frame at a time: how its errors jitter, and whether it is as smooth."""

from __future__ import annotations

import numpy as np

from ..kernels import SurfaceIndex, unique_edges, vertex_normals

VERTICES = 1000  # of a garment, whose slip is measured
ON_SURFACE = 0.02  # m: a vertex farther from the true surface has no place on it


class MotionError:
    """Sums of the lengths of second differences over time, of places and of their errors, over consecutive frames."""

    def __init__(self):
        self.last, self.sums, self.count = {}, np.zeros(3), 0

    def add(self, number, V, place):
        """Vertices (n,3) and their true places in the next frame."""
        self.last = {n: x for n, x in self.last.items() if n >= number - 2} | {number: np.stack([V, place, V - place])}
        if number - 1 in self.last and number - 2 in self.last:
            bend = self.last[number - 2] - 2 * self.last[number - 1] + self.last[number]
            self.sums += np.linalg.norm(bend, axis=2).sum(1)
            self.count += len(V)

    def measures(self):
        """jitter_mm: mean length of the error's second differences; acceleration: of those of the places, as a share of
        the true ones. None where no three frames follow one another."""
        if not self.count:
            return {"jitter_mm": None, "acceleration": None}
        found, true, error = self.sums
        return {"jitter_mm": float(1e3 * error / self.count), "acceleration": float(found / true) if true else None}


class Slip:
    """A garment's errors in frames that go with the true one: what all its frames share, and what differs among them. Of at
    most VERTICES vertices, whose errors in every frame are kept."""

    def __init__(self):
        self.errors = []

    def add(self, error, place, F):
        """Error vectors (g,3) of vertices whose true places are `place`, of one frame."""
        some = slice(None, None, -(-len(error) // VERTICES))
        self.errors.append(np.einsum("gi,gai->ga", error[some], tangents(place, F)[some]).astype(np.float32))

    def measures(self):
        """shared_mm: mean length of a vertex' mean error over the frames, which no picture of them can show; slip_mm: mean
        length of the errors without it. The more motion the frames hold, the less they share. None of one frame."""
        if len(self.errors) < 2:
            return {"slip_mm": None, "shared_mm": None}
        errors = np.array(self.errors)
        shared = errors.mean(0)
        lengths = {"slip_mm": errors - shared, "shared_mm": shared}
        return {name: float(1e3 * np.linalg.norm(x, axis=-1).mean()) for name, x in lengths.items()}


class Followed:
    """Vertices of the body whose places on the true one, of another topology, are those nearest to them in one frame."""

    def __init__(self, V, shown, true_V, true_F):
        """`shown` (n,): vertices that are worth following."""
        face, _, bary, distance = SurfaceIndex(true_V, true_F).closest(V)
        self.at = np.flatnonzero(shown & (distance < ON_SURFACE))
        self.corners, self.bary = true_F[face[self.at]], bary[self.at]

    def places(self, true_V):
        """(k,3), of the vertices `at`."""
        return np.einsum("kc,kci->ki", self.bary, true_V[self.corners])


def tangents(V, F):
    """Frames (g,3,3) that go with the surface: along an edge, across it, normal."""
    normal, edges = vertex_normals(V, F), unique_edges(F)
    along = np.zeros_like(V)
    a, b = edges.T
    along[b], along[a] = V[a] - V[b], V[b] - V[a]
    along -= normal * np.einsum("gi,gi->g", along, normal)[:, None]
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    return np.stack([along, np.cross(normal, along), normal], 1)
