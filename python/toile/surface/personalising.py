"""A garment template personalised: its rest shape is the mean of sampled frames that it was registered to, unposed, without the
cloth about openings that a scan shows too short or joined to other cloth."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from .. import kernels
from ..scene import OBSERVED, BodyModel, Dressed, GarmentTemplate, Person, Tracked
from .girth import Girths
from .joined import Sleeves
from .loops import LoopMatch, astray, beside_loops, loop_length
from .operators import umbrella_laplacian
from .skinning import Skinning

Registered = tuple[Dressed, list[LoopMatch]]  # a garment's cloth in one frame, and the LoopMatch of each of its loops


def personalised(
    model: BodyModel,
    person: Person,
    template: GarmentTemplate,
    poses: Sequence[Tracked],
    register: Callable[[GarmentTemplate], Sequence[Registered]],
    settings,
    covered: bool,
) -> GarmentTemplate:
    """The template with the rest shape that sampled frames show, and the lengths of their openings. `poses` are of these frames,
    `register(template)` registers a template to all of them; `covered`: it is worn under another. `settings` are DressSettings.

    A loop that is false in one frame is left out of all, so that its rim goes on as the cloth about it leads: of another's size
    it is laid on wrong borders. Then the frames are registered again, with a loop of this size. Warns where the template does
    not fit."""
    samples = _Samples(model, person, template, poses, settings, covered)
    fitted, registered = template, register(template)
    false = samples.false(registered)
    if false.any():
        fitted = samples.averaged(template, registered, samples.unlike_others(registered) | false.any(0))
        registered = register(fitted)
        false = samples.false(registered)
    lengths = _medians(np.where(false, np.nan, samples.lengths(registered)))
    _warn_of_size(template, lengths, settings.size_tolerance)
    fitted = samples.averaged(fitted, registered, samples.unlike_others(registered) | false)
    return replace(fitted, opening_lengths=lengths)


class _Samples:
    """The sampled frames (s) of one garment, and what they say of the openings (l) of its template."""

    def __init__(self, model, person, template, poses, settings, covered):
        self.model, self.person, self.poses, self.settings = model, person, poses, settings
        self.stay = settings.covered_weight if covered else settings.unseen_weight
        self.loops, self.loop_names = template.loops, template.loop_names
        self.girths = Girths(template.rest, template.faces, template.loops, settings.girth_distance)
        self.flares = self.girths.flares(template.rest)

    def lengths(self, registered):
        """Lengths (s,l) [m] of the openings that frames show, NaN where none."""
        least = self.settings.measured_share
        length = lambda match: loop_length(match.target) if match.observed.mean() > least else np.nan
        return np.array([[length(match) for match in matches] for _, matches in registered])

    def unlike_others(self, registered):
        """Which openings (s,l) say nothing of the cloth about them, beside the other frames. A scan that lacks the fold under a
        sleeve shows its opening too short, often; labels that run over it show it too long, at times."""
        rank, share = self.settings.whole_rank, self.settings.whole_opening
        return np.stack([astray(lengths, rank, share) for lengths in self.lengths(registered).T], axis=1)

    def false(self, registered):
        """Which openings (s,l) are webs' or other cloth's: beside their own cloth, or beside the body."""
        return (self._at_trunk(registered) > self.settings.joined_share) | self._unlike_cloth(registered)

    def _unlike_cloth(self, registered):
        """Which openings (s,l) are much shorter, or joined to other cloth, beside what the cloth a hand's breadth away leads to
        expect by the template's flares: webs may cut a sleeve off in every frame."""
        shares = np.array([self.girths.flares(dressed.vertices) for dressed, _ in registered]) / self.flares
        return (shares < self.settings.whole_opening) | (shares > self.settings.joined_opening)

    def _at_trunk(self, registered):
        """Share (s,l) of each sleeve's opening that lies at the trunk, 0 of other loops."""
        shares = []
        for tracked, (dressed, _) in zip(self.poses, registered):
            joints = self.model.joint_transforms(self.person.J, tracked.rotations, tracked.translation)[1]
            sleeves = Sleeves(self.model, tracked.vertices, joints)
            at_trunk = [sleeves.at_trunk(*of) for of in zip(self.loop_names, (dressed.vertices[l] for l in self.loops))]
            shares.append([0.0 if points is None else points.mean() for points in at_trunk])
        return np.array(shares)

    def averaged(self, template, registered, wrong):
        """The template with the mean of registered frames, unposed, without the cloth about loops that are `wrong` (s,l) there."""
        total, weight, s = 0, 0, self.settings
        for tracked, (dressed, _), loops in zip(self.poses, registered, wrong):
            skinning = Skinning(self.model, self.person, template.skin, tracked.rotations, tracked.translation)
            rest = skinning.unpose(dressed.vertices)
            about = beside_loops(template.rest, [template.loops[i] for i in np.flatnonzero(loops)], s.rim)
            w = ((dressed.confidence == OBSERVED) & ~about)[:, None]
            total, weight = total + w * (rest - template.rest), weight + w
        mean, share = total / np.maximum(weight, 1), weight[:, 0] / len(self.poses)
        return replace(template, rest=template.rest + _filled(template.faces, mean, share, s.fit_stiffness, self.stay))


def _filled(F, shift, weight, stiffness, stay):
    """argmin_s sum_i weight_i |s_i - shift_i|^2 + stay |s_i|^2 + stiffness |(L s)_i|^2 with the umbrella Laplacian,
    so that what no sample showed follows its surroundings."""
    from scipy.sparse import diags

    L = umbrella_laplacian(F, len(shift))
    factor = kernels.CholeskyFactor().factorize((diags(weight + stay) + stiffness * (L.T @ L)).tocsc())
    return factor.solve(weight[:, None] * shift)


def _medians(lengths):
    """Of each column of lengths (s,l); NaN where it has none."""
    known = [column[np.isfinite(column)] for column in lengths.T]
    return np.array([np.median(column) if len(column) else np.nan for column in known])


def _warn_of_size(template, lengths, tolerance):
    """Warns of loops whose openings no frame shows, and of those of other `lengths` (l,) [m] than the template's."""
    for name, loop, length in zip(template.loop_names, template.loops, lengths):
        share = length / loop_length(template.rest[loop])
        if np.isnan(length):
            warnings.warn(
                f"garment {template.name}: no sampled frame shows loop {name} whole: it is missing, tucked in, covered or joined to other cloth; "
                "its border is extrapolated",
                stacklevel=4,
            )
        elif abs(share - 1) > tolerance:
            warnings.warn(
                f"garment {template.name}: loop {name} is {share:.2f} times as long in the capture as "
                "in the template: is it of another size, or labelled wrong?",
                stacklevel=4,
            )
