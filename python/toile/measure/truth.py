"""The truth that a studio capture brings along, and registered or decoded layers measured against it [mm]."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .. import kernels
from ..errors import UserError, first_line
from ..surface.loop_names import name_loops
from ..surface.operators import distance_to_polyline

MAPPED = 3.0  # factor within which a map keeps the lengths of the edges of the template that it is of


class Truth:
    """CAPTURE/truth/truth.zarr, read a frame at a time; surfaces are (V, F) in metres."""

    def __init__(self, path, capture=None):
        """`capture`: its templates are those of the truth's maps; of those templates' files the maps have all vertices."""
        import zarr

        self.templates = {} if capture is None else capture.templates
        self.kept = {} if capture is None else capture.kept
        self.path, self.group = path, zarr.open_group(str(path), mode="r")
        self.rows = {int(f): i for i, f in enumerate(self.group["frames"][:])}

    def __contains__(self, number):
        return number in self.rows

    def has(self, garment):
        return f"garment/{garment}" in self.group

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

    def maps(self, name, faces):
        """Does the truth know the true places of a garment of these faces (f,3)? Of the capture's own template alone, which
        the same vertices and faces tell, and the map's places, which keep the lengths of its edges."""
        group, template, kept = self.group[f"garment/{name}"], self.templates.get(name), self.kept.get(name)
        if template is None or "map_face" not in group or not _same_faces(template.faces, faces):
            return False
        if len(kept) and kept.max() >= group["map_face"].shape[0]:
            return False
        edges = kernels.unique_edges(template.faces)
        mapped, own = (_edge_share(V, edges) for V in (self.places(name, min(self.rows)), template.vertices))
        return bool(own / MAPPED < mapped < own * MAPPED)

    def places(self, name, number):
        """Where the vertices of the capture's template truly are (g,3)."""
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

    def border_names(self, name, model):
        """Names of a garment's openings, in the order of its boundary loops, told by the bones of the first frame."""
        first = min(self.rows)
        (V, F), (x, joints) = self.garment(name, first), self.joints(first)
        at = dict(zip(joints, x))
        if any(joint not in at for joint in model.joint_names):
            return ()
        posed = replace(model, J=np.array([at[joint] for joint in model.joint_names]))
        return name_loops(posed, V, kernels.boundary_loops(F))

    def garment_errors(self, name, loops, V, faces, number, mapped=True, borders=(), seen=None):
        """Measures of a garment's surface V (g,3), `faces`, and its vertices' error vectors (g,3). loops {name: vertex
        indices}; `seen` (g,): where it was observed.

        boundary_mm: each loop's vertices to the true border that is its own; boundary_all_mm: those of all loops;
        boundary_missed_mm: that border's vertices to the loop; surface_mm: to the true surface; surface_missed_mm: the true
        garment's vertices to this surface;
        correspondence_mm: to the vertices' true places.
        Without a map (`mapped`, see `maps`) a loop's own border is that of its name among `borders`, their names, else the
        nearest; neither correspondence nor errors are known.
        """
        T, F = self.garment(name, number)
        place = self.places(name, number) if mapped else V
        curves = [T[loop] for loop in kernels.boundary_loops(F)]
        boundary, missed = {}, {}  # {loop: distances (k,) [m]}
        named = {} if mapped else dict(zip(borders, curves))
        for loop, at in loops.items():
            own = named.get(loop)
            if own is None:
                own = min(curves, key=lambda curve: distance_to_polyline(place[at], curve).mean())
            boundary[loop], missed[loop] = distance_to_polyline(V[at], own), distance_to_polyline(own, V[at])
        distance = kernels.SurfaceIndex(T, F).closest(V)[3]
        measures = {
            "observed_p90_mm": None if seen is None else ninety(distance[seen]),
            "true_folds": len(kernels.self_intersections(T, F)),
            "boundary_mm": {loop: millimetres(distances) for loop, distances in boundary.items()},
            "boundary_all_mm": millimetres(np.concatenate([*boundary.values(), []])),
            "boundary_missed_mm": {loop: millimetres(distances) for loop, distances in missed.items()},
            "surface_mm": millimetres(distance),
            "surface_missed_mm": millimetres(kernels.SurfaceIndex(V, faces).closest(T[np.unique(F)])[3]),
            "correspondence_mm": millimetres(np.linalg.norm(V - place, axis=1)) if mapped else None,
        }
        return measures, V - place if mapped else None

    def body_errors(self, V, hidden, outside, number, seen=None):
        """Distances of body vertices (n,3) to the true body, where `hidden` (n,) and where not, and where `seen` (n,);
        `outside` (n,) alone count."""
        distance = kernels.SurfaceIndex(*self.body(number)).closest(V)[3]
        return {
            "hidden_mm": millimetres(distance[hidden & outside]),
            "visible_mm": millimetres(distance[~hidden & outside]),
            **({} if seen is None else {"observed_p90_mm": ninety(distance[seen & outside])}),
        }


def _uncovered(V, F, over):
    """Faces none of whose corners lies inside one of the surfaces `over`."""
    hidden = np.zeros(len(V), bool)
    for surface in over:
        hidden |= kernels.winding_number(V, *surface) > 0.5
    return F[~hidden[F].any(1)]


def open_truth(capture, garments=()):
    """The truth of an opened capture, or None where it brings none. UserError: it cannot be read, or one of the garments has none."""
    path = capture.root / "truth" / "truth.zarr"
    if not path.exists():
        return None
    try:
        truth = Truth(path, capture)
    except Exception as error:  # zarr raises whatever a damaged file leads it to
        raise UserError(f"{path}: cannot be read: {first_line(error)}") from None
    missing = [name for name in garments if not truth.has(name)]
    if missing:
        raise UserError(f"{path}: garment/{missing[0]}: the run has this garment, the truth does not")
    return truth


def _same_faces(F, G):
    """Whether two garments have the same faces; one may be turned inside out."""
    return F.shape == G.shape and np.array_equal(np.sort(F, 1), np.sort(G, 1))


def _edge_share(V, edges):
    """Median length of the edges, as a share of the diagonal of the box about V."""
    return np.median(np.linalg.norm(V[edges[:, 0]] - V[edges[:, 1]], axis=1)) / np.linalg.norm(np.ptp(V, axis=0))


def millimetres(distances):
    """Their mean [mm], None of none."""
    return float(np.mean(distances) * 1e3) if len(distances) else None


def ninety(distances):
    """What 90 % of them stay within [mm], None of none."""
    return float(np.percentile(distances, 90) * 1e3) if len(distances) else None


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
