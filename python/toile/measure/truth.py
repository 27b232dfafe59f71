"""The truth that a studio capture brings along, and registered or decoded layers measured against it [mm]."""

from __future__ import annotations

import numpy as np

from .. import kernels
from ..errors import UserError
from ..surface.operators import distance_to_polyline


class Truth:
    """CAPTURE/truth/truth.zarr, read a frame at a time; surfaces are (V, F) in metres."""

    def __init__(self, path, kept=None):
        """`kept` {garment: vertices of its template's file (g,) that the template has}; the truth's maps have all."""
        import zarr

        self.kept = kept or {}
        self.path, self.group = path, zarr.open_group(str(path), mode="r")
        self.rows = {int(f): i for i, f in enumerate(self.group["frames"][:])}

    def __contains__(self, number):
        return number in self.rows

    def check(self, garments):
        """UserError where one of these garments has no truth."""
        missing = [name for name in garments if f"garment/{name}" not in self.group]
        if missing:
            raise UserError(f"{self.path}: garment/{missing[0]}: the run has this garment, the truth does not")

    def body(self, number):
        return self.group["body/vertices"][self.rows[number]].astype(np.float64), self.group["body/faces"][:]

    def garment(self, name, number):
        group = self.group[f"garment/{name}"]
        return group["vertices"][self.rows[number]].astype(np.float64), group["faces"][:]

    def joints(self, number):
        """(k,3), and their names."""
        return self.group["joints"][self.rows[number]], [str(n) for n in self.group.attrs["joint_names"]]

    def keypoints(self, number):
        """{name: place (3,)}; empty where the capture was made without."""
        if "keypoints" not in self.group:
            return {}
        names = [str(n) for n in self.group.attrs["keypoint_names"]]
        return dict(zip(names, self.group["keypoints"][self.rows[number]].astype(np.float64)))

    def places(self, name, number):
        """Where the vertices of the pipeline's template truly are (g,3)."""
        group, (V, F), kept = (
            self.group[f"garment/{name}"],
            self.garment(name, number),
            self.kept.get(name, slice(None)),
        )
        return np.einsum("gk,gki->gi", group["map_bary"][:][kept], V[F[group["map_face"][:][kept]]])

    def outer(self, number, garments, bare=False):
        """V, F, label per face of body and garments; garments {name: label}, inner to outer. `bare`: without what lies
        under them of the body and of other garments."""
        surfaces = [self.body(number), *(self.garment(name, number) for name in garments)]
        if bare:
            surfaces = [(V, _uncovered(V, F, surfaces[i + 1 :])) for i, (V, F) in enumerate(surfaces)]
        labels = [self.group["labels"][:][surfaces[0][1][:, 0]]]
        labels += [np.full(len(F), label) for (_, F), label in zip(surfaces[1:], garments.values())]
        offset = np.cumsum([0, *(len(v) for v, _ in surfaces)])
        faces = np.concatenate([f + o for (_, f), o in zip(surfaces, offset)]).astype(np.int32)
        return np.concatenate([v for v, _ in surfaces]), faces, np.concatenate(labels)

    def garment_errors(self, name, loops, V, number):
        """Measures of a garment's vertices V (g,3), and their error vectors (g,3). loops {name: vertex indices}.

        boundary_mm: each loop's vertices to the true border that is its own; boundary_all_mm: those of all loops;
        surface_mm: to the true surface;
        correspondence_mm: to the vertices' true places.
        """
        T, F = self.garment(name, number)
        place = self.places(name, number)
        borders, boundary = [T[loop] for loop in kernels.boundary_loops(F)], {}  # {loop: distances (k,) [m]}
        for loop, at in loops.items():
            own = min(borders, key=lambda loop: distance_to_polyline(place[at], loop).mean())
            boundary[loop] = distance_to_polyline(V[at], own)
        measures = {
            "boundary_mm": {loop: millimetres(distances) for loop, distances in boundary.items()},
            "boundary_all_mm": millimetres(np.concatenate([*boundary.values(), []])),
            "surface_mm": millimetres(kernels.SurfaceIndex(T, F).closest(V)[3]),
            "correspondence_mm": millimetres(np.linalg.norm(V - place, axis=1)),
        }
        return measures, V - place

    def body_errors(self, V, hidden, outside, number):
        """Distances of body vertices (n,3) to the true body, where `hidden` (n,) and where not; `outside` (n,) alone count."""
        distance = kernels.SurfaceIndex(*self.body(number)).closest(V)[3]
        return {
            "hidden_mm": millimetres(distance[hidden & outside]),
            "visible_mm": millimetres(distance[~hidden & outside]),
        }


def _uncovered(V, F, over):
    """Faces none of whose corners lies inside one of the surfaces `over`."""
    hidden = np.zeros(len(V), bool)
    for surface in over:
        hidden |= kernels.winding_number(V, *surface) > 0.5
    return F[~hidden[F].any(1)]


def open_truth(capture, garments=()):
    """The truth of an opened capture that has these garments, or None where it brings none."""
    path = capture.root / "truth" / "truth.zarr"
    if not path.exists():
        return None
    truth = Truth(path, capture.kept)
    truth.check(garments)
    return truth


def millimetres(distances):
    """Their mean [mm], None of none."""
    return float(np.mean(distances) * 1e3) if len(distances) else None


def second_difference(positions, step=1):
    """Mean length of x(t-step) - 2 x(t) + x(t+step) over frames {number: (n,3)} [mm for metres]; None where no three are so."""
    lengths = [
        np.linalg.norm(positions[n - step] - 2 * x + positions[n + step], axis=1).mean()
        for n, x in positions.items()
        if n - step in positions and n + step in positions
    ]
    return float(np.mean(lengths) * 1e3) if lengths else None


def mean_measures(values):
    """The mean of nested measures over those that have a number; None where none has."""
    nested = [v for v in values if isinstance(v, dict)]
    if nested:
        return {key: mean_measures([v.get(key) for v in nested]) for key in dict.fromkeys(k for v in nested for k in v)}
    numbers = [v for v in values if v is not None]
    return float(np.mean(numbers)) if numbers else None
