"""A garment template of others laid on the body at rest: by the region of the body that carries the garment in a capture,
its units, axes, place and sides are found or it is refused, and its rims are drawn to those of the region."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from .. import kernels
from ..errors import UserError
from ..scene import BodyModel, Mesh
from .attachments import Attachments
from .curves import Curve
from .loop_names import name_loops
from .loops import loop_length, match_loops
from .operators import distance_to_polyline

FACTORS = (1.0, 0.1, 0.01, 0.001, 0.0254, 0.3048)  # of metres, decimetres, ..., inches, feet
LIMBS = {"sleeve": "arm", "armhole": "arm", "leg": "leg", "ankle": "leg"}
POINTS = 300  # of each surface that are asked
SETTLED, STEPS = 6, 8  # places that are bettered, by so many steps
AXES = "xyz"
PART = 0.2  # of a hem is nearest to the rim of a limb that it hangs about
STRANGE = 0.25  # length of an opening that no hole in the labels has [m]


@dataclass(frozen=True)
class Placement:
    """x -> factor R x + t, and how well it lies: the mean distance between the surfaces, both ways [m]."""

    factor: float
    R: np.ndarray
    t: np.ndarray
    distance: float

    def __call__(self, V):
        return self.factor * V @ self.R.T + self.t

    @property
    def words(self):
        """As "scaled by 0.1, its axes x y z taken as +x +z -y, moved by 0.05 m"."""
        axes = [("-" if row.sum() < 0 else "+") + AXES[np.abs(row).argmax()] for row in self.R.T]
        said = [f"scaled by {self.factor:.4g}"] if self.factor != 1 else []
        said += [f"its axes x y z taken as {' '.join(axes)}"] if (self.R != np.eye(3)).any() else []
        return ", ".join([*said, f"moved by {100 * np.linalg.norm(self.t):.0f} cm"])


def place_template(model: BodyModel, garment, mesh: Mesh, region: Mesh, settings) -> tuple[Mesh, list[str]]:
    """The template as it lies on the body model at rest, and what was changed of it in words.

    `region`: the part of the body's surface that carries the garment in the capture, moved to the model's rest pose, its
    border the garment's openings. UserError: the template is of another size, lies nowhere or in several ways, or its
    openings are not those of the capture. `settings` are PlacementSettings."""
    V, F, words = mesh.vertices, mesh.faces, []
    placement = _found(garment, V, F, region, settings)
    if placement is not None:
        V = placement(V)
        words.append(f"garment {garment}: the template does not lie on the body as it is: {placement.words}")
    if _looks_inwards(V, F, region):
        F = np.ascontiguousarray(F[:, ::-1])
        words.append(f"garment {garment}: the template's faces look inwards (inside out, or mirrored): turned")
    face_uv = mesh.face_uv if F is mesh.faces or mesh.face_uv is None else np.ascontiguousarray(mesh.face_uv[:, ::-1])
    V, more = _rims_drawn(model, garment, V, F, region, settings)
    return Mesh(V, F, mesh.uv, face_uv), words + more


def check_near_body(model: BodyModel, garment, mesh: Mesh, settings) -> None:
    """UserError: the template does not lie on the body model at rest."""
    off = off_body(model, mesh)
    if off > 2 * settings.lies:
        raise UserError(f"garment {garment}: the template lies {off:.3g} m from the body model at rest on average")


def off_body(model: BodyModel, mesh: Mesh) -> float:
    """Mean distance of a template's vertices from the body model at rest [m]."""
    return float(kernels.SurfaceIndex(model.v_template, model.f).closest(mesh.vertices)[3].mean())


# Units, axes, place ---------------------------------------------------------------------------------------------------


def _found(garment, V, F, region, s):
    """The Placement that lays the template on the region; None where it lies there as it is."""
    size = np.linalg.norm(np.ptp(region.vertices, axis=0))
    shares = {factor: factor * np.linalg.norm(np.ptp(V, axis=0)) / size for factor in FACTORS}
    fitting = [factor for factor, share in shares.items() if s.size[0] <= share <= s.size[1]]
    if not fitting:
        said = f"{shares[1.0]:.3g} times as large as the capture shows the garment ({size:.2f} m)"
        raise UserError(
            f"garment {garment}: the template is {said}; tried factors {', '.join(f'{f:g}' for f in FACTORS)}"
        )
    search, own = (
        _Search(V, F, region),
        {f: f if 1 / s.same_size < shares[f] < s.same_size else f / shares[f] for f in fitting},
    )
    as_it_is = Placement(1.0, np.eye(3), np.zeros(3), search.distance(1.0, np.eye(3), np.zeros(3)))
    found = search.places([(own[f], R) for f in fitting for R in _rotations()])
    best, rivals = found[0], [p for p in found[1:] if p.factor == found[0].factor]
    small = np.linalg.norm(best.t) < s.near and best.factor == 1 and (best.R == np.eye(3)).all()
    if as_it_is.distance < s.lies and (small or as_it_is.distance < s.clearly * best.distance):
        return None
    unclear = best.distance > s.lies or (rivals and rivals[0].distance < s.clearly * best.distance)
    if unclear and region.index.closest(V)[3].mean() < s.lies:
        return None  # a part of what is worn: its rims tell what it lacks
    if best.distance > s.lies:
        said = f"it lies {1e3 * best.distance:.0f} mm from where the capture shows it ({best.words})"
        raise UserError(f"garment {garment}: no units, axes and place lay the template on the body: at best {said}")
    if unclear:
        said = f"{best.words}: {1e3 * best.distance:.0f} mm off; {rivals[0].words}: {1e3 * rivals[0].distance:.0f} mm"
        raise UserError(f"garment {garment}: the template lies on the body in more than one way ({said}): turn it")
    return best


class _Search:
    """Places of a template V, F that lay it on a region. The region is taken to the template, whose index stays."""

    def __init__(self, V, F, region):
        self.V, self.index, self.region = V, kernels.SurfaceIndex(V, F), region
        self.some = V[:: max(len(V) // POINTS, 1)]
        self.of_region = region.vertices[:: max(len(region.vertices) // POINTS, 1)]

    def places(self, ways):
        """Placements of these (factor, rotation), nearest first: from the middles of both boxes, or from where it is, the
        nearest of them by steps to the mean of the offsets between the surfaces."""
        middle, own = ((V.max(0) + V.min(0)) / 2 for V in (self.region.vertices, self.V))
        found = []
        for factor, R in ways:
            starts = middle - factor * R @ own, np.zeros(3)
            found.append(min((Placement(factor, R, t, self.distance(factor, R, t)) for t in starts), key=_distance))
        found.sort(key=_distance)
        return sorted((self._settled(placement) for placement in found[:SETTLED]), key=_distance)

    def _settled(self, start):
        factor, R, t, best = start.factor, start.R, start.t, replace(start, distance=np.inf)
        for _ in range(STEPS):
            there, back = self._offsets(factor, R, t)
            distance = (np.linalg.norm(there, axis=1).mean() + np.linalg.norm(back, axis=1).mean()) / 2
            if distance >= best.distance:
                break
            best = Placement(factor, R, t, distance)
            t = t + (there.mean(0) - back.mean(0)) / 2
        return best

    def distance(self, factor, R, t):
        there, back = self._offsets(factor, R, t)
        return (np.linalg.norm(there, axis=1).mean() + np.linalg.norm(back, axis=1).mean()) / 2

    def _offsets(self, factor, R, t):
        """From the template's points to the region, and from the region's to the template."""
        x = factor * self.some @ R.T + t
        at = (self.of_region - t) @ R / factor
        return self.region.index.closest(x)[1] - x, factor * (self.index.closest(at)[1] - at) @ R.T


def _distance(placement):
    return placement.distance


def _rotations():
    """The 24 rotations that take axes to axes, none first."""
    return sorted(np.rint(Rotation.create_group("O").as_matrix()), key=lambda R: -np.trace(R))


def _looks_inwards(V, F, region):
    face = region.index.closest(V)[0]
    return np.einsum("ki,ki->k", kernels.vertex_normals(V, F), region.face_normals[face]).mean() < 0


# Rims -----------------------------------------------------------------------------------------------------------------


def _rims_drawn(model, garment, V, F, region, s):
    """V with its rims on those of the region where they lie apart, and what was done in words."""
    attachments = Attachments(F, len(V))
    cloth = attachments.cloth
    loops = kernels.boundary_loops(attachments.faces)
    rims = [region.vertices[loop] for loop in kernels.boundary_loops(region.faces)]
    names = name_loops(model, V[cloth], loops)
    seen = name_loops(model, region.vertices, kernels.boundary_loops(region.faces))
    pairs = _paired(V[cloth], names, loops, seen, rims, s)
    at_rest = {name: V[cloth][loop] for name, loop in zip(names, loops)}
    parted = _parted(at_rest, rims, pairs, s.limbs_reach)
    _check_openings(garment, at_rest, seen, rims, pairs, parted)
    _check_apart(garment, at_rest, rims, pairs, s.rim_near)
    targets, gaps = [], {}  # [m]
    for name, loop in zip(names, loops):
        at = V[cloth][loop]
        if name not in pairs:
            shift = _about_limbs(at, parted.get(name, []))
            gaps[name] = np.linalg.norm(shift)
            targets.append(at + shift if gaps[name] > s.rim_near else at)
            continue
        rim = rims[pairs[name]]
        share = loop_length(rim) / loop_length(at)
        gaps[name] = distance_to_polyline(at, rim).mean()
        nearest = np.min([distance_to_polyline(at, other) for other in rims], axis=0).mean()
        if nearest < s.rim_near:  # in parts, where one rim of the cloth lies about two limbs of the body
            gaps[name] = min(gaps[name], nearest)
        elif not s.size[0] <= share <= s.size[1] or gaps[name] > s.rim_reach:
            raise UserError(_other_cut(model, garment, name, at, rim))
        drawn = gaps[name] > s.rim_near
        targets.append(match_loops([at], [Curve(rim, True)], s.loop)[0][0].target if drawn else at)
    far = {name: gap for name, gap in gaps.items() if gap > s.rim_near}
    if not far:
        return V, []
    move = np.concatenate([target - V[cloth][loop] for target, loop in zip(targets, loops)])
    known = np.concatenate(loops).astype(np.int32)
    moved = V[cloth] + kernels.BiharmonicSolver(V[cloth], attachments.faces, known).solve(move)
    said = ", ".join(f"{name} {1e3 * gap:.0f} mm" for name, gap in far.items())
    return attachments.follow(V, moved), [f"garment {garment}: rims that lie apart were drawn to the capture's: {said}"]


def _paired(V, names, loops, seen, rims, s):
    """{loop: index of its rim}: of one name, of one limb, else the nearest within reach."""
    pairs = {}
    for key in (lambda name: name, _limb):
        there = {key(name): i for i, name in enumerate(seen) if i not in pairs.values() and not name.startswith("loop")}
        pairs |= {name: there[key(name)] for name in names if name not in pairs and key(name) in there}
    for name, loop in zip(names, loops):
        free = [i for i in range(len(rims)) if i not in pairs.values()]
        if name in pairs or not free:
            continue
        gap = {i: distance_to_polyline(V[loop], rims[i]).mean() for i in free}
        nearest = min(gap, key=gap.__getitem__)
        if gap[nearest] < s.rim_reach / 2:
            pairs[name] = nearest
    return pairs


def _limb(name):
    stem, _, side = name.partition("_")
    return f"{LIMBS.get(stem, stem)}_{side}"


def _strange(rims, pairs):
    """Indices of the region's rims that no loop of the template is paired with, and that are no speck's."""
    return [i for i in range(len(rims)) if i not in pairs.values() and loop_length(rims[i]) > STRANGE]


def _parted(loops, rims, pairs, near):
    """{loop: the rims [(k,3)] that it is in parts}: a hem {name: (k,3)} that hangs about two limbs, `near` the body's rims about
    each of them."""
    strange, found = [rims[i] for i in _strange(rims, pairs)], {}
    for name, loop in loops.items() if strange else ():
        gaps = np.array([distance_to_polyline(loop, rim) for rim in strange])
        if name not in pairs and gaps.min(0).mean() < near:
            share = np.bincount(gaps.argmin(0), minlength=len(strange)) / len(loop)
            found[name] = [rim for rim, of in zip(strange, share) if of > PART]
    return found


def _about_limbs(at, rims):
    """How far (3,) a hem (k,3) lies from the two limbs' rims that it is; none where one limb alone shows its."""
    return np.mean([rim.mean(0) for rim in rims], axis=0) - at.mean(0) if len(rims) > 1 else np.zeros(3)


def _check_openings(garment, loops, seen, rims, pairs, parted):
    """Both have openings that the other lacks: another kind of garment."""
    lacking = [name for name in loops if name not in pairs and name not in parted]
    if lacking and _strange(rims, pairs):
        own, shown = ", ".join(loops), ", ".join(seen)
        raise UserError(
            f"garment {garment}: the template has the openings {own}, the capture shows {shown}: it lies askew, or is another "
            f"kind of garment; have its template cut with --template-from-scan {garment}"
        )


def _check_apart(garment, loops, rims, pairs, near):
    """A loop {name: (k,3)} without a rim of its own lies on that of another: the garment is open between them."""
    for name in loops.keys() - pairs.keys():
        for other, rim in pairs.items():
            if distance_to_polyline(loops[name], rims[rim]).mean() < near:
                raise UserError(
                    f"garment {garment}: {' and '.join(sorted((name, other)))} of the template are one opening in the "
                    f"capture: it is open between them; have its template cut with --template-from-scan {garment}"
                )


def _other_cut(model, garment, name, loop, rim):
    """In words how far the loop of the template and that of the capture lie along the body, and how long both are."""
    side = {"left": "L", "right": "R"}.get(name.rpartition("_")[2])
    joint = {"arm": f"upperarm01.{side}", "leg": f"upperleg01.{side}"}.get(_limb(name).partition("_")[0], "neck01")
    at = model.joint(joint)
    origin = model.J[at if at is not None else 0]
    own, shown = (np.linalg.norm(points.mean(0) - origin) for points in (loop, rim))
    return (
        f"garment {garment}: loop {name} of the template ends {own:.2f} m from {joint} and is {loop_length(loop):.2f} m long, "
        f"that of the capture ends {shown:.2f} m from it and is {loop_length(rim):.2f} m long: it is of another cut; have its "
        f"template cut with --template-from-scan {garment}"
    )
