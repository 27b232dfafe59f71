"""What physics leaves unexplained of a garment, learnt over the poses of the training (docs/method/drape.md)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

FEWEST = 4  # frames: of fewer the means alone are kept
FOLDS = 4  # stretches of the frames, each left out once to choose what the poses are worth
MODES = 64  # of the shapes, at most
SCALES = (0.25, 0.5, 1.0, 2.0, 4.0)  # of the usual distance between two poses: what `reach` may be
SWING_SCALES = (1.0, 2.0, 4.0)  # of the usual distance between two simulated shapes: what `swing_reach` may be
ALIKE = 1e6  # [m] the same, where swings do not count
NOISES = (1e-3, 1e-2, 1e-1, 1.0, 10.0)  # over the kernel's variance
SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
# What places a garment: nothing; learnt codes; physics and the mean residual; physics and what poses add; that and the codes' shape
MEAN, CODES, CLOTH, JOINED, MIXED = "mean shape", "codes", "cloth", "joined", "mixed"
SPAN = 1 / 6  # [s] over which a pose's change counts like the pose itself


@dataclass(frozen=True)
class Residual:
    """A garment's registered vertices from simulated ones s (n,3), both unposed, and a pose p (P,) in metres:

    x = registered + a (s - simulated) + sum_j k_j weights_j modes,   a = 1 - (1 - share) max_j k_j,
    k_j = exp(-|p - poses_j|^2 / (2 reach^2) - |q - swings_j|^2 / (2 swing_reach^2)),   q = modes (s - simulated).

    Near the poses and swings of the training it trusts physics by `share`, and for the rest what was seen there (kriging); far
    from all of them what is left is s and the mean residual. Beside the shape c that codes give, what is shown is
    x + (1 - trust) max_j exp(-|p - poses_j|^2 / (2 reach^2)) (c - x).
    """

    registered: np.ndarray  # (n,3) mean of the training frames
    simulated: np.ndarray  # (n,3) the same
    poses: np.ndarray  # (T,P) that taught; none where means alone are kept
    swings: np.ndarray  # (T,k) of the simulated shapes that taught, along the modes [m]
    reach: float  # [m]
    swing_reach: float  # [m]
    share: float
    weights: np.ndarray  # (T,k)
    modes: np.ndarray  # (k,n,3), orthonormal
    trust: float  # share of x beside c
    missed: dict  # {MEAN, CLOTH, JOINED, CODES, MIXED: root mean square [m] in frames left out}, of codes where known

    @classmethod
    def none(cls, n):
        """Physics alone, of n vertices."""
        return cls._means(np.zeros((n, 3)), np.zeros((n, 3)))

    @classmethod
    def _means(cls, registered, simulated):
        nothing, modes = np.zeros((0, 0)), np.zeros((0, *registered.shape))
        return cls(registered, simulated, nothing, nothing, 1.0, 1.0, 1.0, nothing, modes, 1.0, {})

    def moved(self, by):
        """Of a garment on another body, where its rest vertices lie `by` (n,3) from what they were."""
        return replace(self, registered=self.registered + by, simulated=self.simulated + by)

    def nearness(self, pose):
        """Of a pose to those that taught: 1 at one of them, 0 far from all."""
        return similar(pose[None], self.poses, self.reach).max() if len(self.poses) else 0.0

    def add(self, simulated, pose):
        """(n,3) where the cloth is taken to be, unposed."""
        swing = simulated - self.simulated
        if not len(self.poses):
            return self.registered + swing
        q = np.tensordot(self.modes, swing, 2)
        near = similar(pose[None], self.poses, self.reach) * similar(q[None], self.swings, self.swing_reach)
        part = 1 - (1 - self.share) * near.max()
        return self.registered + part * swing + np.tensordot((near @ self.weights)[0], self.modes, 1)

    def mix(self, hung, decoded, pose):
        """(n,3) unposed: `hung` as `add` gave it, and the shape `decoded` from codes."""
        return blend(hung, decoded, self.trust, self.nearness(pose))


def teach(poses, simulated, registered, decoded=None):
    """A Residual of T frames in a row: poses (T,P), vertices (T,n,3) simulated and registered, all unposed. `decoded` (T,n,3): by
    codes of a temporal model that was not taught the frame, NaN where there is none.

    Reaches, noise and share are those that leave the least squared error on FOLDS stretches left out in turn; where none beats
    the means, the means are kept. `trust` is the share that leaves the least on them. What is `missed` in a stretch is by the
    choice that the others make.
    """
    if len(poses) < FEWEST:
        return Residual._means(registered.mean(0), simulated.mean(0))
    poses, stretches = np.asarray(poses, np.float64), np.array_split(np.arange(len(poses)), FOLDS)
    errors = left_out(poses, simulated, registered, stretches)
    residual = fitted(poses, simulated, registered, least(errors))
    shapes, near = unseen_shapes(poses, simulated, registered, stretches, errors)
    known = np.ones(len(poses), bool)
    if decoded is not None and (seen := np.isfinite(decoded).all((1, 2))).any():
        known, joined = seen, shapes[JOINED]
        share = lambda of: best_share(registered[of], joined[of], decoded[of], near[of])
        trust = np.full(len(poses), share(known))
        residual = replace(residual, trust=float(trust[0]))
        for out in stretches:
            trust[out] = share(np.setdiff1d(np.flatnonzero(known), out))
        mixed = blend(joined, decoded, *(x[:, None, None] for x in (trust, near)))
        shapes |= {CODES: decoded, MIXED: mixed}
    off = {of: np.linalg.norm((x - registered)[known], axis=2) for of, x in shapes.items()}
    return replace(residual, missed={of: float(np.sqrt(np.square(one).mean())) for of, one in off.items()})


def blend(hung, decoded, trust, near):
    """Shapes (...,n,3) of cloth mixed with those of codes, which have their say near the poses of the training."""
    return hung + (1 - trust) * near * (decoded - hung)


def unseen_shapes(poses, simulated, registered, stretches, errors):
    """{MEAN, CLOTH, JOINED: (T,n,3)} of each stretch by a Residual of the others, by the choice of least `errors` on them; how near
    (T,) each pose is to theirs."""
    mean, cloth, joined, near = (np.zeros(x) for x in (registered.shape,) * 3 + (len(poses),))
    for k, out in enumerate(stretches):
        kept = np.setdiff1d(np.arange(len(poses)), out)
        residual = fitted(poses[kept], simulated[kept], registered[kept], least(errors, without=k))
        mean[out], cloth[out] = residual.registered, simulated[out] + residual.registered - residual.simulated
        for i in out:
            joined[i], near[i] = residual.add(simulated[i], poses[i]), residual.nearness(poses[i])
    return {MEAN: mean, CLOTH: cloth, JOINED: joined}, near


def least(errors, without=None):
    """The choice of least error over the stretches, one of them left aside."""
    return min(errors, key=lambda choice: sum(e for k, e in enumerate(errors[choice]) if k != without))


def fitted(poses, simulated, registered, choice):
    """A Residual of frames by a choice of `left_out`."""
    means = Residual._means(registered.mean(0), simulated.mean(0))
    if choice == CLOTH:
        return means
    reach, swing_reach, noise, share = choice
    basis, u, s = coordinates(simulated, registered)
    K = similar(poses, poses, reach) * similar(s, s, swing_reach)
    weights = np.linalg.solve(K + noise * np.eye(len(K)), u - share * s)
    modes = basis.reshape(-1, *registered.shape[1:])
    return Residual(means.registered, means.simulated, poses, s, reach, swing_reach, share, weights, modes, 1.0, {})


def best_share(registered, joined, decoded, near):
    """w in 0..1 of the least sum of |joined + (1 - w) near (decoded - joined) - registered|^2, of shapes (F,n,3) and `near` (F,)."""
    towards = near[:, None, None] * (decoded - joined)
    total = np.square(towards).sum()
    return 1 - float(np.clip((towards * (registered - joined)).sum() / total, 0, 1)) if total else 1.0


def coordinates(simulated, registered):
    """A basis (k,3n) of how shapes (T,n,3) depart from their means, and registered and simulated ones (T,k) in it."""
    u, s = ((x - x.mean(0)).reshape(len(x), -1) for x in (registered, simulated))
    basis = principal(np.concatenate([u, s]))
    return basis, u @ basis.T, s @ basis.T


def left_out(poses, simulated, registered, stretches):
    """{(reach, swing_reach, noise, share) or CLOTH: squared error of each of the stretches, left out once}."""
    errors, (_, u, s) = {}, coordinates(simulated, registered)
    for out in stretches:
        kept = np.setdiff1d(np.arange(len(poses)), out)
        about, swing, swung = u[kept].mean(0), s[out] - s[kept].mean(0), s[kept] - s[kept].mean(0)
        add(errors, CLOTH, about + swing - u[out])
        for reach, swing_reach in reaches(poses, s):
            K = similar(poses, poses[kept], reach) * similar(s, s[kept], swing_reach)
            near, (values, vectors) = K[out], np.linalg.eigh(K[kept])
            for noise in NOISES:
                solve = near @ (vectors / (values + noise)) @ vectors.T
                for share in SHARES:
                    part = 1 - (1 - share) * near.max(1, keepdims=True)
                    foretold = about + part * swing + solve @ (u[kept] - about - share * swung)
                    add(errors, (reach, swing_reach, noise, share), foretold - u[out])
    return errors


def reaches(poses, s):
    """What the kernel's reaches may be; none where poses stand still."""
    usual, usual_swing = usual_distance(poses), usual_distance(s)
    swings = [float(usual_swing * scale) for scale in SWING_SCALES] if usual_swing > 0 else []
    return [(float(usual * scale), swing) for scale in SCALES for swing in [*swings, ALIKE]] if usual > 0 else []


def usual_distance(x):
    """The median of those between two rows (T,D)."""
    return np.median(distances(x, x)[np.triu_indices(len(x), 1)])


def add(errors, key, error):
    errors.setdefault(key, []).append(float(np.square(error).sum()))


def principal(x):
    """(k,D) directions in which rows (T,D) vary, at most MODES."""
    values, vectors = np.linalg.eigh(x @ x.T)
    kept = np.flatnonzero(values > 1e-9 * values[-1])[-MODES:]
    return (vectors[:, kept] / np.sqrt(values[kept])).T @ x


def similar(a, b, reach):
    """(A,B) Gaussian kernel of rows (A,D) and (B,D)."""
    return np.exp(-0.5 * np.square(distances(a, b) / reach))


def distances(a, b):
    squares = np.square(a).sum(1)[:, None] + np.square(b).sum(1) - 2 * a @ b.T
    return np.sqrt(np.maximum(squares, 0))


def moving(features, times):
    """(T,2P) poses and how they change: features (T,P) [m] at `times` (T,) [s], beside their velocities times SPAN."""
    features = np.asarray(features, np.float64)
    dt = np.diff(times, prepend=times[0] - 1)[:, None]
    return np.concatenate([features, SPAN * np.diff(features, axis=0, prepend=features[:1]) / dt], axis=1)
