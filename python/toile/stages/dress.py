"""Dress each frame: the template posed by the tracked skeleton, its loops laid on the scan's openings, then registered."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from .. import kernels
from ..config import DressSettings
from ..errors import UserError
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
from ..surface.loops import LoopMatch, loop_length, match_loops
from ..surface.operators import smooth_on
from ..surface.personalising import personalised
from ..surface.skinning import Skinning
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
    whole, attachments = _as_made(model, garment, label_id, mesh, settings)
    cloth = attachments.cloth_of(whole)
    under = _surface_under(model, person, samples, over)
    carried = replace(cloth, rest=move_with_body(cloth.rest, model.v_template, under, settings.fit_reach))
    fitted = carried
    if samples:
        register = partial(_registered, model, person, samples, settings, over)
        poses = [tracked for _, tracked, _, _ in samples]
        fitted = personalised(model, person, carried, poses, register, settings, covered=bool(over))
    flares = Girths(fitted.rest, fitted.faces, fitted.loops, settings.girth_distance).flares(carried.rest)
    rest = attachments.follow(whole.rest, fitted.rest)
    return replace(whole, rest=rest, opening_lengths=fitted.opening_lengths, flares=flares)


def _as_made(model, garment, label_id, mesh, settings):
    """The GarmentTemplate over the body model at rest, as its file gives it, and its Attachments."""
    V, F = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int32)
    loops = tuple(kernels.boundary_loops(F)) if len(F) else ()
    if not loops:
        raise UserError(f"{garment.template}: the template of garment {garment.name} has no open loop")
    uv, face_uv = (mesh.uv, mesh.face_uv) if mesh.uv is not None and mesh.face_uv is not None else unwrap(V, F)
    attachments = Attachments(F, len(V))
    skin = transfer_skin(model, V[attachments.cloth], attachments.faces, settings.skin_smoothing)
    skin, names = attachments.extend(V, skin), name_loops(model, V, loops)
    return GarmentTemplate(garment.name, int(label_id), V, F, uv, face_uv, skin, loops, names), attachments


def _surface_under(model, person, samples, over):
    """The person's rest surface (n,3); where garments `over` lie on it, the body that the model has there."""
    if not samples or not over:
        return person.rest
    share = np.mean([np.isin(segmented.vertices, over) for _, _, segmented, _ in samples], axis=0)
    share = smooth_on(model.f, share, 2)[:, None]
    return person.rest + share * (model.rest(person.shape)[0] - person.rest)


def _registered(model, person, samples, settings, over, template):
    """[(Dressed, [LoopMatch])] of the samples by a template."""
    return parallel_map_with(
        lambda: Dresser(model, person, template, settings, over),
        lambda dresser, sample: dresser.register(*sample[:3], sample[3]()),
        samples,
    )


def fit_samples(samples: Sequence[Sample], settings: DressSettings) -> Sequence[Sample]:
    """Those of the sampled frames that personalise a template."""
    return samples[:: max(len(samples) // max(settings.fit_frames, 1), 1)][: settings.fit_frames]


class _Cloth(NamedTuple):
    """What carries the garment's label in one frame, of the faces that cameras see."""

    mesh: Mesh
    closest: Callable  # of points (k,3), as SurfaceIndex.closest says it within `observed_distance`
    scanned: bool  # else a guess: the tracked surface stands in for a scan that is missing


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
        t, s = self.template, self.settings
        skinning = Skinning(self.model, self.person, t.skin, tracked.rotations, tracked.translation)
        posed, sleeves = skinning.pose(t.rest), Sleeves(self.model, tracked.vertices, skinning.joints)
        rivals = Rivals(evidence.scan.vertices, evidence.scan.faces, segmented, t.label, self.over)
        matches, unclaimed = self._on_scan(posed, segmented, evidence.scan, rivals, sleeves)
        traced = s.trace_openings and bool(evidence.views)
        first = self._first(posed, matches) if traced else matches
        start = self._to_openings(posed, first)
        cloth = self._cloth(frame, segmented, evidence)
        vertices = self._fitted(self.solver, cloth, start, first)
        if traced:
            trace = self._tracing(evidence, rivals, sleeves, cloth)
            fit = partial(self._fitted, self.traced_solver, cloth)
            vertices, matches = self._traced(vertices, matches, trace, fit, cloth.closest)
        distance = cloth.closest(vertices)[3]
        confidence = self._confidence(vertices, distance, matches)
        diagnostics = self._of_surface(vertices, confidence, distance, start)
        diagnostics |= {"unclaimed_opening_mm": 1e3 * unclaimed}
        diagnostics |= self._of_loops(vertices, matches) | self._of_hands(vertices, tracked)
        diagnostics |= crumpling(t.rest, posed, vertices, t.faces)
        return Dressed(vertices, confidence, diagnostics), matches

    def _on_scan(self, posed, segmented, scan, rivals, sleeves):
        """The LoopMatch of each loop, as `posed` (g,3), on the openings that labels show on the scan; and the length of opening that no
        loop claimed [m]."""
        t, settings = self.template, self.settings.loop
        openings = _openings_of(segmented, t.label, scan.vertices, scan.faces, rivals)
        loops = [posed[loop] for loop in t.loops]
        matches, unclaimed = match_loops(loops, openings, settings)
        return [sleeves.parted(*of, settings) for of in zip(t.loop_names, loops, matches)], unclaimed

    def _cloth(self, frame, segmented, evidence):
        """The garment's _Cloth in a frame. UserError: there is hardly any."""
        t, s, scan = self.template, self.settings, evidence.scan
        inside = (segmented.scan_faces == t.label) & evidence.seen
        if inside.sum() < s.min_faces:
            carried = f"{inside.sum()} faces of the scan carry garment {t.name}"
            raise UserError(f"frame {frame.number}: dress: {carried}: too few to register")
        mesh = Mesh(scan.vertices, scan.faces[inside], confidence=scan.confidence)
        return _Cloth(mesh, partial(mesh.index.closest, radius=s.observed_distance), frame.scan is not None)

    def _tracing(self, evidence, rivals, sleeves, cloth):
        """-> trace(i, garment, match): the LoopMatch of loop i of the garment, a Mesh, on the opening that pictures show along it."""
        t, settings = self.template, self.settings.loop
        in_silhouettes = cloth_within(cloth.mesh, evidence)

        def trace(i, garment, match):
            loop, at = t.loops[i], garment.vertices[t.loops[i]]
            match = trace_opening(garment, loop, evidence, rivals, match, settings)
            match = sleeves.parted(t.loop_names[i], at, match, settings)
            return within(at, match, evidence, in_silhouettes, settings)

        return trace

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

    def _fitted(self, solver, cloth, start, matches):
        """Vertices (g,3) from `start` onto the cloth. Where that is a guess, what finds nothing of it stays at `start`."""
        mesh, boundary = cloth.mesh, self._boundary(matches)
        fit = solver.solve(mesh.vertices, mesh.faces, start=start, boundary=boundary, scan_confidence=mesh.confidence)
        if fit.stop == "no_overlap" and not cloth.scanned:
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

    def _confidence(self, vertices, distance, matches):
        """(g,) of vertices (g,3) at this `distance` (g,) from the cloth. Observed: it is near; interpolated: an observed vertex is near;
        hidden: neither. A loop's vertex whose opening was not seen is at most interpolated."""
        from scipy.spatial import cKDTree

        s = self.settings
        seen = distance < s.observed_distance
        confidence = np.where(seen, OBSERVED, HIDDEN).astype(np.uint8)
        if seen.any() and not seen.all():
            off = cKDTree(vertices[seen]).query(vertices[~seen], distance_upper_bound=s.interpolated_distance)[0]
            confidence[~seen] = np.where(np.isfinite(off), INTERPOLATED, HIDDEN)
        for loop, match in zip(self.template.loops, matches):
            unseen = loop[~match.observed]
            confidence[unseen] = np.minimum(confidence[unseen], INTERPOLATED)
        return confidence

    def _of_surface(self, vertices, confidence, distance, start):
        """What the diagnostics say of the garment on its scan."""
        seen = confidence == OBSERVED
        return {
            "observed": float(seen.mean()),
            "surface_mm": float(1e3 * distance[seen].mean()) if seen.any() else -1.0,
            "moved_mm": float(1e3 * np.linalg.norm(vertices - start, axis=1).mean()),
        }

    def _of_loops(self, vertices, matches):
        """What the diagnostics say of its loops: how much of their openings was seen and how far they lie from them, and their lengths
        against those of the sampled frames, and against what their girths lead to expect."""
        t, out = self.template, {}
        for name, match, loop in zip(t.loop_names, matches, t.loops):
            out[f"loop_observed.{name}"] = float(match.observed.mean()) if match.shown is None else match.shown
            gap = np.linalg.norm(vertices[loop] - match.target, axis=1)[match.observed]
            out[f"loop_mm.{name}"] = float(1e3 * gap.mean()) if len(gap) else -1.0
        if t.opening_lengths is not None:
            for name, loop, length in zip(t.loop_names, t.loops, t.opening_lengths):
                if length > 0:
                    out[f"loop_length.{name}"] = float(loop_length(vertices[loop]) / length)
        if self.girths is not None:
            shares = self.girths.flares(vertices) / t.flares
            out |= {f"loop_share.{name}": float(x) for name, x in zip(t.loop_names, shares) if np.isfinite(x)}
        return out

    def _of_hands(self, vertices, tracked):
        """What the diagnostics say of hands that touch it."""
        contact = float(max(self._touching(vertices, tracked), default=0.0))
        return {"hand_contact": contact, "unsupported_contact": float(contact > self.settings.contact_share)}

    def _touching(self, vertices, tracked):
        """The share of each hand's vertices that touch the garment."""
        garment, reach = Mesh(vertices, self.template.faces), self.settings.contact
        low, high = vertices.min(0) - reach, vertices.max(0) + reach
        for hand in self.hands:
            V = tracked.vertices[hand]
            about = V[((V > low) & (V < high)).all(1)]
            yield (garment.index.closest(about, reach)[3] < reach).sum() / len(V) if len(about) else 0.0


def _moved(at, match):
    """How far [m] pictures move a loop at (k,3): what three quarters of its seen vertices stay below."""
    seen = match.observed
    return np.quantile(np.linalg.norm(match.target - at, axis=1)[seen], 0.75) if seen.any() else 0.0


def _openings_of(segmented, label, V, F, rivals):
    """The border that the pictures gave, or the 0.5 isoline of the garment's probability on the scan; without what
    another garment over it hides."""
    curves = segmented.openings.get(label)
    if not curves:
        column = int(np.searchsorted(segmented.ids, label))
        curves = isolines(V, F, segmented.scan_probability[:, column].astype(np.float64))
    return [piece for curve in curves for piece in pieces(curve, ~rivals.hide(curve.points))]
