"""Cloth by physics on frames that it was not measured on, beside the mean shape and ridge regression: geometry alone.

    python -m bench.draping CAPTURE [--teach 10] [--judge 10] [--dry-drag 0.03]    # a `toile studio` capture of a T-shirt; prints a table in Markdown
    python -m bench.draping CAPTURE --still 60 [--dry-drag 0.03]                   # how fast cloth moves on a body that stands still from frame 60 on

Input is the truth, as if registered without error: the first frames teach, the others are driven by the body alone. Those from `judge`
on are judged, all the others by default.
"""

import argparse
from pathlib import Path

import numpy as np
import zarr
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from toile import kernels
from toile.avatar.drive.residual import moving, teach
from toile.avatar.settings import ClothSettings
from toile.io.body import load_body_model
from toile.io.mesh import read_mesh
from toile.surface.sampling import spread_points

MOVES, STANDS = 30, 180  # frames in which a body moves before it stands still, and stands
FPS, NEIGHBOURS = 30, 8  # skinning weights are means over so many vertices of the body
POINTS = 256  # of the cloth, that tell a pose by where they are carried
CLOTH = ClothSettings()


class Sequence:
    """True body B (T,b,3) and shirt X (T,n,3) in the template's topology F, and the motion of its skin relative to frame 0."""

    def __init__(self, capture, garment="tshirt"):
        truth = zarr.open(store=str(Path(capture) / "truth" / "truth.zarr"), mode="r")
        cloth = truth[f"garment/{garment}"]
        self.B, self.body_F = truth["body/vertices"][:].astype(float), truth["body/faces"][:]
        corners = cloth["vertices"][:][:, cloth["faces"][:][cloth["map_face"][:]]]
        self.X = np.einsum("tgcd,gc->tgd", corners, cloth["map_bary"][:])
        self.F = read_mesh(Path(capture) / "templates" / f"{garment}.obj").faces
        self.local, self.motion = self._skin(truth["pose/rotations"][:], truth["joints"][:])

    def _skin(self, rotations, joints):
        """Local rotations (T,K,3,3) and blended transforms (T,n,4,4)."""
        model, (T, K) = load_body_model(), rotations.shape[:2]
        local = Rotation.from_rotvec(rotations.reshape(-1, 3)).as_matrix().reshape(T, K, 3, 3)
        world = local.copy()
        for k, parent in enumerate(model.parents):
            if parent >= 0:
                world[:, k] = world[:, parent] @ local[:, k]
        A = np.tile(np.eye(4), (T, K, 1, 1))
        A[:, :, :3, :3] = world @ world[0].transpose(0, 2, 1)
        A[:, :, :3, 3] = joints - np.einsum("tkij,kj->tki", A[:, :, :3, :3], joints[0])
        near, weights = cKDTree(self.B[0]).query(self.X[0], k=NEIGHBOURS)[1], np.zeros((len(self.X[0]), K))
        rows = np.arange(len(weights))[:, None]
        for c in range(NEIGHBOURS):
            np.add.at(weights, (rows, model.weights_idx[near[:, c]]), model.weights_val[near[:, c]] / NEIGHBOURS)
        return local, np.einsum("nk,tkij->tnij", weights, A)

    def pose(self, shape, t):
        return np.einsum("nij,nj->ni", self.motion[t, :, :3, :3], shape) + self.motion[t, :, :3, 3]

    def unpose(self, V, t):
        return np.linalg.solve(self.motion[t, :, :3, :3], (V - self.motion[t, :, :3, 3])[..., None])[..., 0]


def ridge(s, unposed, teach):
    """Unposed shapes (T,n,3) from rotations of the joints and their changes; the weight by cross-validation of two halves."""
    f = (s.local[:, 1:] - np.eye(3)).reshape(len(s.X), -1)
    f = np.c_[f, 5 * np.diff(f, axis=0, prepend=f[:1])]
    f, mean = f - f[:teach].mean(0), unposed[:teach].mean(0)
    Y, K, half = (unposed - mean).reshape(len(f), -1), f @ f[:teach].T, teach // 2
    halves = np.arange(half), np.arange(half, teach)

    def fitted(rows, weight):
        return np.linalg.solve(K[np.ix_(rows, rows)] + weight * np.eye(len(rows)), Y[rows])

    def error(weight):
        return sum(((K[np.ix_(b, a)] @ fitted(a, weight) - Y[b]) ** 2).mean() for a, b in (halves, halves[::-1]))

    weight = min(np.trace(K[:teach]) / teach * 10.0 ** np.arange(-4, 3), key=error)
    return (K @ fitted(np.arange(teach), weight)).reshape(unposed.shape) + mean


def solver_of(s, dry_drag, teach):
    """Cloth as an avatar measures it on the first frames."""
    i, j = kernels.unique_edges(s.F).T
    lengths = np.linalg.norm(s.X[:teach, i] - s.X[:teach, j], axis=2).mean(0)
    clear = [kernels.signed_distance(s.X[t], s.B[t], s.body_F) for t in range(0, teach, max(1, teach // 5))]
    margin = max(CLOTH.least_margin, np.percentile(clear, CLOTH.clearance))
    options = CLOTH.solver() | {"dry_drag": dry_drag, "margin": margin}
    return kernels.DrapeSolver(s.F, len(s.X[0]), lengths, s.body_F, len(s.B[0]), **options)


def hung(s, solver, start, bodies):
    """Cloth (T,n,3) over bodies (T,b,3), that begins at `start` in the first."""
    clear = kernels.untangle(start, s.F, bodies[0], s.body_F).V
    return np.stack([solver.start(clear, bodies[0]).V, *(solver.step(B, 1 / FPS).V for B in bodies[1:])])


def at_rest(s, dry_drag, frame, teach):
    """A table of the speed of cloth [mm a frame] on a body that moves up to `frame` and then stands still."""
    first = max(0, frame - MOVES)
    bodies = np.concatenate([s.B[first : frame + 1], np.repeat(s.B[frame : frame + 1], STANDS, axis=0)])
    Y = hung(s, solver_of(s, dry_drag, teach), s.X[first], bodies)[frame - first :]
    speed = 1e3 * np.linalg.norm(np.diff(Y, axis=0), axis=2)
    print("| after [s] | mean | 95 % | most |\n|---|---|---|---|")
    for t in (1, 2, 3, 4, 6):
        still = speed[t * FPS - 1]
        print(f"| {t} | {still.mean():.2f} | {np.percentile(still, 95):.2f} | {still.max():.1f} |")


def carried(s, shape):
    """Poses (T,2P) of frames as avatar/model/carried.py has them: points of a shape (n,3) skinned, brought near to it by a rigid
    motion, and where up is; with their velocities."""
    at = spread_points(shape, POINTS)
    still, up, found = shape[at] - shape[at].mean(0), np.array([0, 0, 1.0]), []
    for t in range(len(s.X)):
        points = s.pose(shape, t)[at]
        turn = Rotation.align_vectors(still, points - points.mean(0))[0]
        tilt = np.sqrt(np.square(still).sum(1).mean()) * (turn.apply(up) - up)
        found.append(np.r_[(turn.apply(points - points.mean(0)) - still).ravel() / np.sqrt(POINTS), tilt])
    return moving(np.array(found), np.arange(len(s.X)) / FPS)


def row(name, s, Y, first):
    X, Y, bodies = s.X[first:], Y[first:], s.B[first:]
    error = 1e3 * np.linalg.norm(Y - X, axis=2)
    acceleration = 1e3 * np.linalg.norm(np.diff(Y, 2, axis=0), axis=2).mean()
    pairs = np.mean([len(kernels.intersecting_pairs(V, s.F, B, s.body_F)) for V, B in zip(Y, bodies)])
    own = np.mean([len(kernels.self_intersections(V, s.F)) for V in Y])
    return f"| {name} | {error.mean():.1f} | {np.percentile(error, 95):.1f} | {error.mean(1).max():.1f} | {acceleration:.2f} | {pairs:.1f} | {own:.0f} |"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("capture", type=Path)
    parser.add_argument("--teach", type=int, default=10)
    parser.add_argument("--judge", type=int)
    parser.add_argument("--dry-drag", type=float, default=CLOTH.dry_drag)
    parser.add_argument("--still", type=int, metavar="FRAME")
    args = parser.parse_args()
    s, count = Sequence(args.capture), args.teach
    if args.still is not None:
        return at_rest(s, args.dry_drag, args.still, count)
    first = count if args.judge is None else args.judge
    if first < count:
        parser.error(f"--judge {first}: frames before {count} teach")
    frames, unposed = range(len(s.X)), np.stack([s.unpose(V, t) for t, V in enumerate(s.X)])
    mean, foretold = unposed[:count].mean(0), ridge(s, unposed, count)
    Y = hung(s, solver_of(s, args.dry_drag, count), s.pose(mean, 0), s.B)
    loose = np.stack([s.unpose(V, t) for t, V in enumerate(Y)])
    settled, poses = slice(min(CLOTH.lead, count // 2), count), carried(s, mean)
    residual = teach(poses[settled], loose[settled], unposed[settled])
    shift = residual.registered - residual.simulated
    shown = np.stack([s.pose(residual.add(loose[t], poses[t]), t) for t in frames])
    untangler = kernels.UntangleSolver(s.F, len(mean), s.body_F, len(s.B[0]))
    out = np.stack([untangler.solve(V, B).V for V, B in zip(shown, s.B)])
    print(
        f"| {len(s.X) - first} frames from {first} on, after {count} | mean | 95 % | worst | acceleration | pairs | own pairs |"
    )
    print("|---" * 7 + "|")
    rows = {
        "truth": s.X, "mean shape, skinned": np.stack([s.pose(mean, t) for t in frames]),
        "ridge regression": np.stack([s.pose(foretold[t], t) for t in frames]), "cloth": Y,
        "cloth and mean residual": np.stack([s.pose(loose[t] + shift, t) for t in frames]), "cloth and residual": shown,
        "the same, moved out of the body": out,
    }  # fmt: skip
    for name, V in rows.items():
        print(row(name, s, V, first), flush=True)


if __name__ == "__main__":
    main()
