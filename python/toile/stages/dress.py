"""Dress each frame: the template posed by the tracked skeleton, its loops laid on the scan's openings, then registered."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from .. import kernels
from ..config import DressSettings
from ..errors import UserError
from ..kinematics import blended_by, unblended
from ..scene import (
    HIDDEN,
    INTERPOLATED,
    OBSERVED,
    BodyModel,
    Dressed,
    Frame,
    Garment,
    GarmentTemplate,
    Mesh,
    Person,
    Segmented,
    Tracked,
)
from ..surface.attachments import Attachments
from ..surface.crumpling import crumpling
from ..surface.curves import isolines, pieces
from ..surface.extension import continued
from ..surface.girth import Girths
from ..surface.joined import Sleeves
from ..surface.loop_names import name_loops
from ..surface.loops import LoopMatch, astray, beside_loops, loop_length, match_loops
from ..surface.operators import smooth_on, umbrella_laplacian
from ..surface.transfer import move_with_body, transfer_skin, unwrap
from ..vision.evidence import Evidence
from ..vision.openings import Rivals, cloth_within, trace_opening, within
from ..vision.threads import parallel_map, parallel_map_with

Sample = tuple[Frame, Tracked, Segmented, Callable[[], Evidence]]
HANDS = "hand_left", "hand_right"  # segments of a body model


def prepare(
    model: BodyModel,
    person: Person,
    garment: Garment,
    label_id: int,
    mesh: Mesh,
    samples: Sequence[Sample],
    settings: DressSettings,
    over: Sequence[int] = (),
) -> GarmentTemplate:
    """A template that fits the person. `mesh` lies roughly over the body model at rest; `samples`, chosen by `fit_samples`,
    are registered loosely, unposed and averaged. `over`: label ids of the garments worn over this one.

    Warns where the template does not fit: size by loop lengths, a loop that no frame shows; and where the body model has
    no hands. Raises UserError for a template without open loops."""
    if not any(name in model.segments for name in HANDS):
        warnings.warn(
            "body model: neither segments nor joints named as hands: contact of hands is not watched", stacklevel=2
        )
    V, F = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int32)
    loops = tuple(kernels.boundary_loops(F)) if len(F) else ()
    if not loops:
        raise UserError(f"{garment.template}: the template of garment {garment.name} has no open loop")
    uv, face_uv = (mesh.uv, mesh.face_uv) if mesh.uv is not None and mesh.face_uv is not None else unwrap(V, F)
    attachments = Attachments(F, len(V))
    skin = transfer_skin(model, V[attachments.cloth], attachments.faces, settings.skin_smoothing)
    skin = attachments.extend(V, skin)
    names = name_loops(model, V, loops)
    whole = GarmentTemplate(garment.name, int(label_id), V, F, uv, face_uv, skin, loops, names)
    cloth = attachments.cloth_of(whole)
    under = _surface_under(model, person, samples, over)
    cloth = replace(cloth, rest=move_with_body(cloth.rest, model.v_template, under, settings.fit_reach))
    carried = cloth.rest
    if samples:
        cloth = _personalise(model, person, cloth, samples, settings, over)
    flares = _flares(carried, cloth.loops, Girths(cloth.rest, cloth.faces, cloth.loops, settings.girth_distance))
    rest = attachments.follow(V, cloth.rest)
    return replace(whole, rest=rest, opening_lengths=cloth.opening_lengths, flares=flares)


def _flares(V, loops, girths):
    """Each loop's length over its girth's (l,), NaN where it has none."""
    return np.array([loop_length(V[loop]) for loop in loops]) / girths(V)


def _surface_under(model, person, samples, over):
    """The person's rest surface (n,3); where garments `over` lie on it, the body that the model has there."""
    if not samples or not over:
        return person.rest
    share = np.mean([np.isin(segmented.vertices, over) for _, _, segmented, _ in samples], axis=0)
    share = smooth_on(model.f, share, 2)[:, None]
    return person.rest + share * (model.rest(person.shape)[0] - person.rest)


def fit_samples(samples: Sequence[Sample], settings: DressSettings) -> Sequence[Sample]:
    """Those of the sampled frames that personalise a template."""
    return samples[:: max(len(samples) // max(settings.fit_frames, 1), 1)][: settings.fit_frames]


class _Skinning:
    """Garment vertices to and from one pose, by the template's own weights."""

    def __init__(self, model, person, skin, rotations, translation):
        R, self.joints = model.joint_transforms(person.J, rotations, translation)
        self.A, self.b = blended_by(skin, person.J, R, self.joints)

    def pose(self, rest):
        return np.einsum("gij,gj->gi", self.A, rest) + self.b

    def unpose(self, posed):
        return unblended(posed, self.A, self.b)


def _personalise(model, person, template, samples, settings, over):
    """Rest shape from frames registered with the unfitted template: unposed, averaged over what was observed. A loop that is
    false or at the trunk in one of them is left out of all, so that its rim goes on as the cloth about it leads: of another's size it
    is laid on wrong borders. Then they are registered again, with a loop of this size."""
    girths = Girths(template.rest, template.faces, template.loops, settings.girth_distance)
    flares = _flares(template.rest, template.loops, girths)
    stay = settings.covered_weight if over else settings.unseen_weight
    poses = [tracked for _, tracked, _, _ in samples]
    average = partial(_averaged, model, person, stay=stay, settings=settings, poses=poses)

    def registered(template):
        made = parallel_map_with(
            lambda: Dresser(model, person, template, settings, over),
            lambda dresser, sample: dresser.register(*sample[:3], sample[3]()),
            samples,
        )
        joined = _at_trunk(model, person, template, made, poses) > settings.joined_share
        return made, joined | _false(made, template.loops, girths, flares, settings)

    fitted, (made, false) = template, registered(template)
    if false.any():
        fitted = average(template, made, _astray(made, settings) | false.any(0))
        made, false = registered(fitted)
    shown = _medians(np.where(false, np.nan, _lengths(made, settings)))
    _report_fit(template, shown, settings)
    return replace(average(fitted, made, _astray(made, settings) | false), opening_lengths=shown)


def _lengths(registered, settings):
    """Lengths (s,l) [m] of the openings that frames show, NaN where none."""
    return np.array([[_observed_length(m, settings.measured_share) for m in matches] for _, matches in registered])


def _astray(registered, settings):
    """Which openings (s,l) say nothing of the cloth about them, beside the other frames. A scan that lacks the fold under a
    sleeve shows its opening too short, often; labels that run over it show it too long, at times."""
    of = _lengths(registered, settings).T
    return np.stack([astray(lengths, settings.whole_rank, settings.whole_opening) for lengths in of], axis=1)


def _false(registered, loops, girths, flares, settings):
    """Which openings (s,l) are much shorter, or joined to other cloth, beside what the cloth a hand's breadth away leads to
    expect by the template's `flares`: webs may cut a sleeve off in every frame."""
    shares = np.array([_flares(dressed.vertices, loops, girths) for dressed, _ in registered]) / flares
    return (shares < settings.whole_opening) | (shares > settings.joined_opening)


def _at_trunk(model, person, template, registered, poses):
    """Share (s,l) of each sleeve's opening that lies at the trunk, 0 of other loops."""
    named, shares = list(zip(template.loop_names, template.loops)), []
    for tracked, (dressed, _) in zip(poses, registered):
        x = model.joint_transforms(person.J, tracked.rotations, tracked.translation)[1]
        sleeves = Sleeves(model, tracked.vertices, x)
        found = [sleeves.at_trunk(name, dressed.vertices[loop]) for name, loop in named]
        shares.append([0.0 if of is None else of.mean() for of in found])
    return np.array(shares)


def _averaged(model, person, template, registered, wrong, poses, settings, stay):
    """The template with the mean of registered frames, unposed, without the cloth about loops that are `wrong` (s,l) there."""
    total, weight = 0, 0
    for tracked, (dressed, _), loops in zip(poses, registered, wrong):
        rest = _Skinning(model, person, template.skin, tracked.rotations, tracked.translation).unpose(dressed.vertices)
        about = beside_loops(template.rest, [template.loops[i] for i in np.flatnonzero(loops)], settings.rim)
        w = ((dressed.confidence == OBSERVED) & ~about)[:, None]
        total, weight = total + w * (rest - template.rest), weight + w
    shift = _filled(template, total / np.maximum(weight, 1), weight[:, 0] / len(poses), settings.fit_stiffness, stay)
    return replace(template, rest=template.rest + shift)


def _filled(template, shift, weight, stiffness, stay):
    """argmin_s sum_i weight_i |s_i - shift_i|^2 + stay |s_i|^2 + stiffness |(L s)_i|^2 with the umbrella Laplacian,
    so that what no sample showed follows its surroundings."""
    from scipy.sparse import diags

    L = umbrella_laplacian(template.faces, len(shift))
    factor = kernels.CholeskyFactor().factorize((diags(weight + stay) + stiffness * (L.T @ L)).tocsc())
    return factor.solve(weight[:, None] * shift)


def _moved(at, match):
    """How far [m] pictures move a loop at (k,3): what three quarters of its seen vertices stay below."""
    seen = match.observed
    return np.quantile(np.linalg.norm(match.target - at, axis=1)[seen], 0.75) if seen.any() else 0.0


def _observed_length(match: LoopMatch, least):
    return loop_length(match.target) if match.observed.mean() > least else np.nan


def _medians(lengths):
    """Of each column of lengths (s,l); NaN where it has none."""
    seen = [column[np.isfinite(column)] for column in lengths.T]
    return np.array([np.median(column) if len(column) else np.nan for column in seen])


def _report_fit(template, shown, settings):
    for i, name in enumerate(template.loop_names):
        own = loop_length(template.rest[template.loops[i]])
        if np.isnan(shown[i]):
            warnings.warn(
                f"garment {template.name}: no sampled frame shows loop {name} whole: it is missing, tucked in, covered or joined to other cloth; "
                "its border is extrapolated",
                stacklevel=4,
            )
        elif abs(shown[i] / own - 1) > settings.size_tolerance:
            warnings.warn(
                f"garment {template.name}: loop {name} is {shown[i] / own:.2f} times as long in the capture as "
                "in the template: is it of another size, or labelled wrong?",
                stacklevel=4,
            )


class Dresser:
    """Registers one garment frame by frame; what depends on the template alone is computed once. `over`: label ids of
    the garments worn over this one, whose openings hide it and are none of its own. Components without a loop follow."""

    def __init__(
        self,
        body_model: BodyModel,
        person: Person,
        template: GarmentTemplate,
        settings: DressSettings,
        over: Sequence[int] = (),
    ):
        self.model, self.person, self.settings, self.over = body_model, person, settings, over
        self.whole, self.attachments = template, Attachments(template.faces, len(template.rest))
        self.template = template = self.attachments.cloth_of(template)
        self.girths = None  # of a template that is being fitted nothing is compared
        if template.flares is not None:
            self.girths = Girths(template.rest, template.faces, template.loops, settings.girth_distance)
        self.known = np.concatenate(template.loops).astype(np.int32)
        self.biharmonic = kernels.BiharmonicSolver(
            template.rest, template.faces, self.known, **settings.biharmonic.model_dump()
        )
        self.solver, self.traced_solver = (
            kernels.NricpSolver(template.rest, template.faces, large_motion=False, rebase=True, **options.model_dump())
            for options in (settings.nricp, settings.traced_nricp)
        )
        self.hands = [body_model.segments[name] for name in HANDS if name in body_model.segments]

    def dress(self, frame: Frame, tracked: Tracked, segmented: Segmented, evidence: Evidence) -> Dressed:
        """One frame. Without a scan no vertex was observed: pictures tell openings, and without those either all is guessed."""
        cloth, _ = self.register(frame, tracked, segmented, evidence)
        vertices = self.attachments.follow(self.whole.rest, cloth.vertices)
        confidence = self.attachments.extend(self.whole.rest, cloth.confidence)
        if frame.scan is not None:
            return replace(cloth, vertices=vertices, confidence=confidence)
        known = INTERPOLATED if frame.images or frame.labels else HIDDEN
        diagnostics = cloth.diagnostics | {"observed": 0.0}
        return replace(cloth, vertices=vertices, confidence=np.minimum(confidence, known), diagnostics=diagnostics)

    def register(
        self, frame: Frame, tracked: Tracked, segmented: Segmented, evidence: Evidence
    ) -> tuple[Dressed, list[LoopMatch]]:
        """The Dressed of the cloth alone, and the LoopMatch of each loop.

        The garment is fitted; its ends that lie off the scan go on as what lies on it leads; each loop is laid on the opening
        that the pictures show along it, which may hang free of the scan, and the garment is fitted again, and so on with loops that
        moved far. Before the first fit loops are laid on the scan's openings: without pictures all, else those that `_first` names."""
        t, s, scan = self.template, self.settings, evidence.scan
        V, F = scan.vertices, scan.faces
        skinning = _Skinning(self.model, self.person, t.skin, tracked.rotations, tracked.translation)
        posed, sleeves = skinning.pose(t.rest), Sleeves(self.model, tracked.vertices, skinning.joints)
        rivals = Rivals(V, F, segmented, t.label, self.over)
        openings = _openings_of(segmented, t.label, V, F, rivals)
        at = [posed[l] for l in t.loops]
        matches, unclaimed = match_loops(at, openings, s.loop)
        matches = [sleeves.parted(*of, s.loop) for of in zip(t.loop_names, at, matches)]
        traced = s.trace_openings and bool(evidence.views)
        first = self._first(posed, matches) if traced else matches
        start = self._to_openings(posed, first)
        inside = (segmented.scan_faces == t.label) & evidence.seen
        if inside.sum() < s.min_faces:
            carried = f"{inside.sum()} faces of the scan carry garment {t.name}"
            raise UserError(f"frame {frame.number}: dress: {carried}: too few to register")
        cloth = Mesh(V, F[inside], confidence=scan.confidence)
        to_cloth = partial(cloth.index.closest, radius=s.observed_distance)
        scanned = frame.scan is not None
        vertices = self._fitted(self.solver, cloth, start, first, scanned)
        if traced:
            shown = cloth_within(cloth, evidence)

            def trace(i, garment, match):
                loop, at = t.loops[i], garment.vertices[t.loops[i]]
                match = trace_opening(garment, loop, evidence, rivals, match, s.loop)
                return within(at, sleeves.parted(t.loop_names[i], at, match, s.loop), evidence, shown, s.loop)

            fit = lambda start, matches: self._fitted(self.traced_solver, cloth, start, matches, scanned)
            vertices, matches = self._traced(vertices, matches, trace, fit, to_cloth)
        confidence, distance = self._confidence(vertices, to_cloth)
        for loop, match in zip(t.loops, matches):
            confidence[loop[~match.observed]] = np.minimum(confidence[loop[~match.observed]], INTERPOLATED)
        diagnostics = self._diagnostics(vertices, matches, unclaimed, tracked, confidence, distance, start)
        diagnostics |= crumpling(t.rest, posed, vertices, t.faces)
        return Dressed(vertices, confidence, diagnostics), matches

    def _traced(self, vertices, matches, trace, fit, to_cloth):
        """Vertices (g,3) with the loops where the pictures show them, and the LoopMatch of each. A loop that pictures moved far is sought
        again from there, as the strip in which it is sought lies elsewhere then; not that of a template which is being fitted: it would
        follow webs. `trace(i, garment, match)` gives the LoopMatch of one loop, `fit(start, matches)` the vertices on the scan."""
        t, s = self.template, self.settings
        matches, sought = list(matches), range(len(t.loops))
        for _ in range(s.traces if t.opening_lengths is not None else 1):
            vertices = continued(t.rest, t.faces, vertices, self._free(vertices, to_cloth))
            garment = Mesh(vertices, t.faces)
            for i, match in zip(sought, parallel_map(lambda i: trace(i, garment, matches[i]), sought)):
                matches[i] = match
            sought = [i for i in sought if _moved(vertices[t.loops[i]], matches[i]) > s.settled]
            vertices = fit(self._to_openings(vertices, matches), matches)
            if not sought:
                break
        return vertices, matches

    def _first(self, posed, matches):
        """The LoopMatch of each loop for the first fit, where pictures follow. A loop near its opening stays as it is posed
        unless the scan shows the opening along most of it: what shows in part may be the border of a web, and pictures
        tell the place better. So does a loop of a personalised template that the scan's opening would draw together or out."""
        s, first, whole = self.settings.loop, [], self.settings.whole_opening
        fitted = self.template.opening_lengths is not None
        for loop, match in zip(self.template.loops, matches):
            off = np.linalg.norm(match.target - posed[loop], axis=1)[match.observed]
            share = loop_length(match.target) / loop_length(posed[loop])
            false = fitted and not whole <= share <= 1 / whole
            stays = false or (match.observed.mean() < s.whole_share and len(off) and np.median(off) < s.near)
            nothing = LoopMatch(posed[loop], np.zeros(len(loop), bool), np.full(len(loop), np.nan))
            first.append(nothing if stays else match)
        return first

    def _free(self, vertices, to_cloth):
        """Which vertices (n,) lie off the labelled scan about a loop that lies on it in part. `to_cloth(points)`: what of
        that scan lies within `observed_distance`, as its index says it."""
        from scipy.spatial import cKDTree

        s, free = self.settings, np.zeros(len(vertices), bool)
        off = to_cloth(vertices)[0] < 0
        for loop in self.template.loops:
            if 1 - off[loop].mean() > s.loop.min_observed:
                near = cKDTree(vertices[loop]).query(vertices[off], distance_upper_bound=s.free_reach)[0]
                free[off] |= np.isfinite(near)
        return free

    def _to_openings(self, vertices, matches):
        """Biharmonic displacement that takes the loops to their targets."""
        move = np.concatenate([m.target - vertices[l] for m, l in zip(matches, self.template.loops)])
        return vertices + self.biharmonic.solve(move)

    def _fitted(self, solver, cloth, start, matches, scanned):
        """Vertices (n,3) from `start` onto the labelled scan. Where it is not `scanned` but a guess, what finds nothing of it
        stays at `start`."""
        boundary, confidence = self._boundary(matches), cloth.confidence
        fit = solver.solve(cloth.vertices, cloth.faces, start=start, boundary=boundary, scan_confidence=confidence)
        if fit.stop == "no_overlap" and not scanned:
            return start
        if fit.stop == "no_overlap":
            raise UserError(
                f"dress: garment {self.template.name} lies nowhere near the scan's faces that carry its label: is it hidden under another? "
                "What no camera sees is not registered: leave it out of scene.toml"
            )
        return fit.V

    def _boundary(self, matches):
        """What loops are drawn to: openings where they are seen; where another garment hides one, the place that the pose gives."""
        pairs = list(zip(self.template.loops, matches))
        seen = [(l[m.observed], m.target) for l, m in pairs if m.observed.mean() > self.settings.loop.min_observed]
        return seen + [(l, m.target) for l, m in pairs if self.over and not m.observed.any()]

    def _confidence(self, vertices, to_cloth):
        """Observed: the labelled scan is near; interpolated: an observed vertex is near; hidden: neither."""
        from scipy.spatial import cKDTree

        s = self.settings
        distance = to_cloth(vertices)[3]
        seen = distance < s.observed_distance
        confidence = np.where(seen, OBSERVED, HIDDEN).astype(np.uint8)
        if seen.any() and not seen.all():
            off = cKDTree(vertices[seen]).query(vertices[~seen], distance_upper_bound=s.interpolated_distance)[0]
            confidence[~seen] = np.where(np.isfinite(off), INTERPOLATED, HIDDEN)
        return confidence, distance

    def _diagnostics(self, vertices, matches, unclaimed, tracked, confidence, distance, start):
        t, s = self.template, self.settings
        seen = confidence == OBSERVED
        out = {
            "observed": float(seen.mean()),
            "surface_mm": float(1e3 * distance[seen].mean()) if seen.any() else -1.0,
            "moved_mm": float(1e3 * np.linalg.norm(vertices - start, axis=1).mean()),
            "unclaimed_opening_mm": 1e3 * unclaimed,
        }
        for name, match, loop in zip(t.loop_names, matches, t.loops):
            out[f"loop_observed.{name}"] = float(match.observed.mean()) if match.shown is None else match.shown
            gap = np.linalg.norm(vertices[loop] - match.target, axis=1)[match.observed]
            out[f"loop_mm.{name}"] = float(1e3 * gap.mean()) if len(gap) else -1.0
        if t.opening_lengths is not None:
            for name, loop, shown in zip(t.loop_names, t.loops, t.opening_lengths):
                if shown > 0:
                    out[f"loop_length.{name}"] = float(loop_length(vertices[loop]) / shown)
        if self.girths is not None:
            shares = _flares(vertices, t.loops, self.girths) / t.flares
            out |= {f"loop_share.{name}": float(x) for name, x in zip(t.loop_names, shares) if np.isfinite(x)}
        out["hand_contact"] = float(max(self._touching(vertices, tracked), default=0.0))
        out["unsupported_contact"] = float(out["hand_contact"] > s.contact_share)
        return out

    def _touching(self, vertices, tracked):
        """The share of each hand's vertices that touch the garment."""
        garment, reach = Mesh(vertices, self.template.faces), self.settings.contact
        low, high = vertices.min(0) - reach, vertices.max(0) + reach
        for hand in self.hands:
            V = tracked.vertices[hand]
            about = V[((V > low) & (V < high)).all(1)]
            yield (garment.index.closest(about, reach)[3] < reach).sum() / len(V) if len(about) else 0.0


def _openings_of(segmented, label, V, F, rivals):
    """The border that the pictures gave, or the 0.5 isoline of the garment's probability on the scan; without what
    another garment over it hides."""
    curves = segmented.openings.get(label)
    if not curves:
        column = int(np.searchsorted(segmented.ids, label))
        curves = isolines(V, F, segmented.scan_probability[:, column].astype(np.float64))
    return [piece for curve in curves for piece in pieces(curve, ~rivals.hide(curve.points))]
