"""Checks of the truth, by code that shares nothing with our kernels, and the store it is written to."""

from __future__ import annotations

import numpy as np

STRAIN_P99 = 0.20  # edge strain (length over rest length, minus one, absolute) of 99 % of the edges of any frame;
#                    `StudioOptions.strain` sets another
STRAIN_MAX = 0.60  # of any edge
STEP_MAX = 0.25  # m that any body or garment vertex may move between two frames
ACCELERATION = 0.10  # m, largest second difference of a body vertex over frames
SPEED_EXCESS = 0.08  # m that the cloth may outrun the body's fastest vertex in one frame


class TruthRejected(Exception):
    """This seed's truth breaks a bound; the message says which."""


def pairs_between(A, FA, B, FB):
    """Number of intersecting triangle pairs of two surfaces, by CGAL's exact predicates (through libigl)."""
    from igl.copyleft.cgal import intersect_other

    return len(intersect_other(A, FA.astype(np.int64), B, FB.astype(np.int64), detect_only=True)[0])


def pairs_within(V, F):
    """Number of self-intersecting triangle pairs (shared corners excluded where the pair only meets there)."""
    from igl.copyleft.cgal import remesh_self_intersections

    return len(remesh_self_intersections(V, F.astype(np.int64), detect_only=True)[2])


def strain(V, rest, edges):
    """Signed strain of each edge."""
    length = lambda P: np.linalg.norm(P[edges[:, 1]] - P[edges[:, 0]], axis=1)
    return length(V) / length(rest) - 1


def clearance(V, surface, faces):
    """Smallest distance of points V to a surface [m], unsigned."""
    import igl

    return float(np.sqrt(igl.point_mesh_squared_distance(V, surface, faces.astype(np.int64))[0].min()))


WORST = {
    "strain_p99": max,
    "strain_max": max,
    "clearance_mm": min,
    "hand_cloth_mm": min,
    "self_pairs": sum,
    "pairs": sum,
}


def check_frame(name, garment, F, rest, edges, under, under_faces, hands, number, allowed=0, strained=STRAIN_P99):
    """Raises TruthRejected, or gives what was measured of garment `name`; `under`: the body's vertices, then those of
    what is worn under the garment; `hands` are the body vertices of both hands; `allowed`: pairs that may intersect;
    `strained`: strain that 99 % of the edges may have."""
    pairs = pairs_between(under, under_faces, garment, F)
    if pairs > allowed:
        raise TruthRejected(f"frame {number}: {pairs} triangle pairs of {name} and what is under it intersect")
    s = np.abs(strain(garment, rest, edges))
    p99, top = float(np.quantile(s, 0.99)), float(s.max())
    if p99 > strained or top > STRAIN_MAX:
        bounds = f"bounds {strained} and {STRAIN_MAX}"
        raise TruthRejected(f"frame {number}: {name}: edge strain p99 {p99:.3f}, max {top:.3f} ({bounds})")
    return {
        "strain_p99": p99, "strain_max": top, "clearance_mm": 1e3 * clearance(garment, under, under_faces),
        "hand_cloth_mm": 1e3 * clearance(under[hands], garment, F), "self_pairs": pairs_within(garment, F),
        "pairs": pairs,
    }  # fmt: skip


def check_motion(body, garment, first=0):
    """Continuity over frames (T,n,3), (T,G,3) or None, from frame number `first` on; gives the largest steps [mm]."""
    out = {}
    if len(body) < 2:
        return out
    step = np.linalg.norm(np.diff(body, axis=0), axis=2).max(1)
    out["body_step_mm"] = bounded(step, STEP_MAX, "the body jumps", first)
    if len(body) > 2:
        bend = np.linalg.norm(np.diff(body, n=2, axis=0), axis=2).max(1)
        out["body_bend_mm"] = bounded(bend, ACCELERATION, "the body jerks", first)
    if garment is not None:
        cloth = np.linalg.norm(np.diff(garment, axis=0), axis=2).max(1)
        out["garment_step_mm"] = 1e3 * float(cloth.max())
        bounded(cloth - step, SPEED_EXCESS, "the garment outruns the body", first)
    return out


def bounded(values, bound, what, first):
    """The largest of per-step values [m], in mm; TruthRejected beyond the bound."""
    if values.max() > bound:
        frame = first + int(values.argmax()) + 1
        raise TruthRejected(f"frame {frame}: {what} by {values.max():.3f} m (bound {bound})")
    return 1e3 * float(values.max())


class Sliding:
    """Per garment vertex: largest change of the offset to the body vertex that was nearest in the first frame."""

    def __init__(self, garment, body):
        from scipy.spatial import cKDTree

        self.near = cKDTree(body).query(garment)[1]
        self.first = garment - body[self.near]
        self.largest = np.zeros(len(garment))

    def add(self, garment, body):
        """Frames (T,G,3) and (T,n,3) [m]."""
        change = np.linalg.norm(garment - body[:, self.near] - self.first, axis=2)
        self.largest = np.maximum(self.largest, change.max(0))


def write_truth(path, attrs, fixed, count, blocks):
    """`truth.zarr` (zarr 3, a chunk a frame, float32 positions): attributes, `fixed` arrays {path: array}, and arrays
    of `count` frames that come block by block, {path: (b, ...)}."""
    import zarr

    root = zarr.open_group(str(path), mode="w", zarr_format=3)
    root.attrs.update(attrs)
    for name, values in fixed.items():
        values = np.asarray(values)
        chunks = tuple(max(1, c) for c in values.shape)
        root.create_array(name, shape=values.shape, dtype=values.dtype, chunks=chunks)[...] = values
    start = 0
    for block in blocks:
        for name, values in block.items():
            if start == 0:
                shape = values.shape[1:]
                root.create_array(name, shape=(count, *shape), dtype=values.dtype, chunks=(1, *shape))
            root[name][start : start + len(values)] = values
        start += len(values)


def random_frame(capture, rng):
    """Of a frame of a capture's truth: the body's vertices (n,3), and of each garment its name, vertices (G,3), those of the first
    frame, and faces."""
    import zarr

    truth = zarr.open_group(str(capture / "truth" / "truth.zarr"), mode="r")
    row, garments = rng.integers(truth["frames"].shape[0]), []
    for name in sorted(truth["garment"].keys()):
        group = truth[f"garment/{name}"]
        V = group["vertices"]
        garments.append((name, V[row].astype(float), V[0].astype(float), group["faces"][:]))
    return truth["body/vertices"][row].astype(float), garments
