"""Random arguments: mostly sound meshes and arrays, each spoilt now and then in the ways that data are."""

import numpy as np
import trimesh

UGLY = (np.nan, np.inf, -np.inf, 1e308, -1e308, 1e200, -1e160, 1e30, 1e-320, -0.0)
SIZES = (1.0, 1.0, 1.0, 1.0, 1e-3, 1e3, 1e-6, 1e6, 1e-12, 1e12, 1e-40, 1e40, 1e-160, 1e160, 1e-320, 1e300)
INDICES = (-1, -(2**31), 2**31 - 1, 2**31, -(2**40), 2**62)


class Draw:
    """One case; everything follows from its seed."""

    def __init__(self, seed, wild=None):
        self.rng = np.random.default_rng(seed)
        self.wild = self.chance(0.6) if wild is None else wild  # else sound: what lies behind the checks is reached

    def chance(self, p):
        return self.rng.random() < p

    def spoil(self, p=0.12):
        return self.wild and self.chance(p)

    def pick(self, things):
        return things[self.rng.integers(len(things))]

    def whole(self, low, high):
        """low to high, both included; beyond them when spoilt."""
        if self.spoil(0.05):
            return self.pick([-1, 0, -(2**31), 2**31 - 1, 2**63, 1.5, None, "x"])
        return int(self.rng.integers(low, high + 1))

    def size(self):
        return self.pick(SIZES) if self.wild else 1.0

    def number(self, low, high):
        """Geometric between low and high; ugly when spoilt."""
        return self.pick((*UGLY, 0.0, -1.0)) if self.spoil(0.15) else float(low * (high / low) ** self.rng.random())

    def options(self, **ranges):
        """Some of the options: (low, high) geometric, a list to pick from, a bool, or an int range as a range."""
        chosen = {}
        for name, what in ranges.items():
            if not self.chance(0.25):
                continue
            if isinstance(what, range):
                chosen[name] = self.whole(what.start, what.stop - 1)
            else:
                chosen[name] = self.number(*what) if isinstance(what, tuple) else self.pick(what)
        return chosen

    def points(self, n, size=1.0):
        return self.layout(self.values(self.rng.normal(0, size, (n, 3))))

    def values(self, array):
        """Floats, a few of them ugly."""
        array = np.array(array, dtype=np.float64)
        if array.size and self.spoil():
            flat = array.reshape(-1)
            for _ in range(self.rng.integers(1, 4)):
                flat[self.rng.integers(flat.size)] = self.pick(UGLY)
        return array

    def indices(self, array):
        """Integers, a few of them out of range."""
        array = np.array(array, dtype=np.int64)
        if array.size and self.spoil(0.06):
            array.reshape(-1)[self.rng.integers(array.size)] = self.pick(INDICES)
        return array

    def layout(self, array):
        """The same array in another type, order or shape; some are none at all."""
        if not self.wild or self.chance(0.8):
            return array
        with np.errstate(all="ignore"):
            return self.pick(LAYOUTS)(array)

    def mesh(self, closed=None):
        """(V, F) of up to a few hundred vertices."""
        V, F = self.pick(CLOSED if closed else OPEN if closed is False else CLOSED + OPEN)(self)
        V = V * np.exp(self.rng.normal(0, 0.3, 3)) + (self.rng.normal(0, 0.02, V.shape) if self.chance(0.3) else 0)
        if self.wild and self.chance(0.6):
            for _ in range(self.rng.integers(1, 4)):
                V, F = self.pick(FLAWS)(self, V, F)
        if self.wild and self.chance(0.3):
            V = V + self.pick([1.0, 1e3, 1e6, 1e9, 1e16]) * self.rng.normal(size=3)
        return V, F

    def dressed(self, V, F):
        """A mesh as a careless caller hands it over."""
        return self.layout(self.values(V)), self.layout(self.indices(F))


def _ball(draw):
    mesh = trimesh.creation.icosphere(subdivisions=int(draw.rng.integers(0, 3)), radius=0.3)
    return np.array(mesh.vertices), np.array(mesh.faces)


def _box(draw):
    mesh = trimesh.creation.box(extents=(0.3, 0.4, 0.6))
    return np.array(mesh.vertices), np.array(mesh.faces)


def _grid(around, along, wrap):
    i, j = np.meshgrid(np.arange(along), np.arange(around), indexing="ij")
    number = lambda a, b: a * around + b % around
    columns = around if wrap else around - 1
    a, b = np.meshgrid(np.arange(along - 1), np.arange(columns), indexing="ij")
    a, b = a.ravel(), b.ravel()
    lower = np.c_[number(a, b), number(a, b + 1), number(a + 1, b)]
    upper = np.c_[number(a, b + 1), number(a + 1, b + 1), number(a + 1, b)]
    return i.ravel(), j.ravel(), np.concatenate([lower, upper])


def _sheet(draw):
    n, m = draw.rng.integers(2, 14, 2)
    i, j, F = _grid(int(n), int(m), False)
    return np.c_[i / m - 0.5, j / n - 0.5, 0.05 * np.sin(i)] * 0.6, F


def _tube(draw):
    n, m = draw.rng.integers(3, 16, 2)
    i, j, F = _grid(int(n), int(m), True)
    return np.c_[0.3 * np.cos(2 * np.pi * j / n), 0.3 * np.sin(2 * np.pi * j / n), 0.6 * i / m - 0.3], F


def _triangle(draw):
    return draw.rng.normal(size=(3, 3)), np.array([[0, 1, 2]])


def _soup(draw):
    n = int(draw.rng.integers(3, 40))
    return draw.rng.normal(0, 0.3, (n, 3)), draw.rng.integers(0, n, (int(draw.rng.integers(1, 80)), 3))


CLOSED = (_ball, _ball, _ball, _box)
OPEN = (_sheet, _tube, _tube, _triangle, _soup)


def _repeat_faces(draw, V, F):
    return V, np.concatenate([F, F[draw.rng.integers(0, max(len(F), 1), 5)]]) if len(F) else F


def _flat_faces(draw, V, F):
    return V, np.concatenate([F, F[:4][:, [0, 0, 1]], F[:2][:, [0, 0, 0]]])


def _fan_on_an_edge(draw, V, F):
    if not len(F):
        return V, F
    new = len(V) + np.arange(3)
    return np.concatenate([V, draw.rng.normal(size=(3, 3))]), np.concatenate([F, [[F[0, 0], F[0, 1], i] for i in new]])


def _lone_vertices(draw, V, F):
    V = np.concatenate([draw.rng.normal(size=(2, 3)), V, draw.rng.normal(size=(2, 3)) * 100])
    return V, F + 2


def _twins(draw, V, F):
    V = V.copy()
    V[draw.rng.integers(0, max(len(V), 1), len(V) // 4)] = V[:1]
    return V, F


def _needles(draw, V, F):
    if not len(F) or not len(V):
        return V, F
    V = V.copy()
    f = F[draw.rng.integers(len(F))]
    V[f[1]] = V[f[0]] + 1e-9 * draw.rng.normal(size=3)
    return V, F


def _two(draw, V, F):
    offset = draw.rng.normal(0, draw.pick([0.0, 0.1, 10.0]), 3)
    return np.concatenate([V, V + offset]), np.concatenate([F, F + len(V)])


def _scattered_faces(draw, V, F):
    return V, np.where(draw.rng.random(F.shape) < 0.1, draw.rng.integers(0, max(len(V), 1), F.shape), F)


FLAWS = (
    lambda draw, V, F: (V * draw.size(), F),
    lambda draw, V, F: (V, F[:, ::-1]),
    lambda draw, V, F: (V, np.where(draw.rng.random((len(F), 1)) < 0.5, F, F[:, ::-1])),
    lambda draw, V, F: (V * draw.pick([[0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 1, 1e-12]]), F),
    lambda draw, V, F: (V, F[draw.rng.random(len(F)) < 0.7]),
    lambda draw, V, F: (V[:0], F) if draw.chance(0.1) else (V, F[:0]) if draw.chance(0.1) else (V, F),
    _repeat_faces,
    _flat_faces,
    _fan_on_an_edge,
    _lone_vertices,
    _twins,
    _needles,
    _two,
    _scattered_faces,
)


def _strided(a):
    wide = np.zeros((*a.shape, 2), a.dtype)
    wide[..., 0] = a
    return wide[..., 0]


def _read_only(a):
    a = a.copy()
    a.setflags(write=False)
    return a


LAYOUTS = (
    np.asfortranarray,
    _strided,
    _read_only,
    lambda a: a[::-1],
    lambda a: a.tolist(),
    lambda a: a.astype(a.dtype.newbyteorder()),
    lambda a: a.astype(np.float32),
    lambda a: a.astype(np.float16),
    lambda a: np.nan_to_num(a, posinf=0, neginf=0).clip(-(2**31), 2**31).astype(np.int32),
    lambda a: np.nan_to_num(a, posinf=0, neginf=0).clip(0, 2**62).astype(np.uint64),
    lambda a: a.astype(bool),
    lambda a: a.astype(complex),
    lambda a: a.astype(object),
    lambda a: a.astype(str),
    lambda a: a.astype("datetime64[s]") if a.dtype == np.int64 else a,
    lambda a: np.ma.masked_array(a, a == a.flat[0]) if a.size else a,
    lambda a: a[..., None],
    lambda a: a.reshape(-1),
    lambda a: a.T,
    lambda a: a[..., :-1],
    lambda a: a[:-1],
    lambda a: a[:0],
    lambda a: np.concatenate([a, a]),
    lambda a: a.sum(),
    lambda a: np.zeros((0, 0)),
    lambda a: [[0, 1, 2], [3, 4]],
    lambda a: None,
    lambda a: "mesh",
    lambda a: {},
)
