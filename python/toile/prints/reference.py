"""The print that all frames are laid upon: the mean over the anchors, the run's first block, and over frames spread over it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..frame_numbers import evenly
from ..kernels import bilinear
from .colours import CHANNELS, blended, camera_offsets, logarithms

SEEN = 0.3  # share of the reference's frames in which a point must have been seen to count in full
NEAR = 10  # frame numbers within which a frame starts from the one before
RECENT = 8  # frames before it that an anchor is first laid upon


@dataclass(frozen=True)
class Reference:
    """What the preparation keeps of a garment."""

    rest: np.ndarray  # (g,3) the rest shape that slides are measured on [m]
    values: np.ndarray  # (N,3) channels at the lattice's points
    weights: np.ndarray  # (N,) 0..1
    offsets: np.ndarray  # (c,3) the cameras' colours
    frames: np.ndarray  # (f,) numbers of the frames that it was made of
    slides: np.ndarray  # (f,g,2) theirs [m]
    start: np.ndarray | None = None  # (g,2) the slide that all frames share where the template's texture tells it [m]

    def starts(self, number):
        """What the slide of frame `number` may begin with, where none before it is known: that of the nearest frame of the
        reference, and what all share. A print that repeats fits in more places than its own."""
        return [nearest(number, self.frames, self.slides), self.start]


def anchors_and_samples(frames, first, anchors, samples):
    """(anchors, samples): frames spread evenly over the `first` block, and over all of `frames`, without those."""
    near = evenly(first, anchors)
    return near, [n for n in evenly(frames, samples) if n not in near]


def nearest(number, frames, slides):
    """The slide of that one of the `frames` that lies nearest to `number`, of two the first."""
    return slides[int(np.abs(np.asarray(frames) - number).argmin())]


def pyramid_of(matcher, views, offsets):
    """The pyramid of a frame's print, from its Unwrapped a camera and the cameras' colours `offsets` (c,3)."""
    return matcher.pyramid(*blended(views, offsets, len(matcher.surface.lattice)))


def reference_of(matcher, numbers, frames, posed, anchors, texture=None):
    """The Reference of `frames`, lists of Unwrapped a camera, their `numbers` and surfaces (f,g,3), the `anchors` first. `texture`: the
    print (N,3) that the template itself shows, see `print_of_texture`: then also the slide that all frames share is known."""
    offsets, start = camera_offsets(frames, len(matcher.surface.lattice)), None
    pyramids = [pyramid_of(matcher, views, offsets) for views in frames]
    if texture is None:
        slides = common_slides(matcher, numbers, pyramids, posed, anchors, matcher.settings.mean_rounds)
    else:
        wide, everywhere = matcher.widened(), np.ones(len(texture))
        start = wide.match(pyramid_of(wide, frames[0], offsets), wide.target(texture, everywhere), posed[0]).d
        near, onto = matcher.about(start), matcher.target(texture, everywhere)
        slides = [near.match(pyramid, onto, V, start).d for pyramid, V in zip(pyramids, posed)]
    values, weights = mean_print(matcher, pyramids, slides)
    return Reference(matcher.surface.rest, values, weights, offsets, np.array(numbers), np.array(slides), start)


def print_of_texture(lattice, uv, face_uv, texture):
    """Channels (N,3) at a lattice's points of a picture `texture` (H,W,3) uint8 over `uv` (t,2), v up, with corners
    `face_uv` (m,3). A point stands for what lies about it in its face, half way to its neighbours."""
    size, corners = np.array(texture.shape[1::-1]), uv[face_uv[lattice.face]]
    turns = [np.roll(np.array(step), k) for step in ((1.0, -1.0, 0.0), (-1.0, 1.0, 0.0)) for k in range(3)]
    total = 0.0
    for step in (np.zeros(3), *turns):
        bary = np.clip(lattice.bary + step / (2 * lattice.n), 0, None)
        u, v = np.einsum("nk,nkx->xn", bary / bary.sum(1, keepdims=True), corners)
        total = total + bilinear(texture.astype(np.float32), np.stack([u, 1 - v], 1) * size)
    return logarithms(total / (1 + len(turns))) @ CHANNELS.T


def common_slides(matcher, numbers, pyramids, posed, anchors, rounds):
    """Slides that lay the frames `numbers` upon their mean, of their pyramids and posed surfaces (f,g,3), the `anchors` first and
    in their order.

    Prints fix slides only up to one that all frames share: it is chosen so that edges keep the template's lengths."""
    slides = [matcher.unstretched(posed[:1])]
    for k in range(1, anchors):
        recent = slice(max(0, k - RECENT), k)
        onto = matcher.target(*mean_print(matcher, pyramids[recent], slides[recent]))
        slides.append(matcher.match(pyramids[k], onto, posed[k], slides[-1]).d)
    slides = shared_out(matcher, posed[:anchors], slides)
    for _ in range(rounds):
        known = len(slides)
        onto = matcher.target(*mean_print(matcher, pyramids[:known], slides))
        slides = [matcher.match(p, onto, V, d).d for p, V, d in zip(pyramids, posed, slides)]
        for k in range(known, len(pyramids)):
            starts = [nearest(numbers[k], numbers[:k], slides), None]
            slides.append(matcher.best(pyramids[k], onto, posed[k], starts).d)
        slides = shared_out(matcher, posed, slides)
    return slides


def shared_out(matcher, posed, slides):
    """The slides with what lengths ask of all of them alike."""
    surface = matcher.surface
    moved = [surface.points_at(V, *surface.slid(d)) for V, d in zip(posed, slides)]
    shared = matcher.unstretched(moved, np.mean(slides, axis=0))
    return [d + shared for d in slides]


def mean_print(matcher, pyramids, slides):
    """values (N,3), weights (N,): the mean of the sharpest levels, each drawn back by its slide."""
    total = weight = 0.0
    for pyramid, d in zip(pyramids, slides):
        values, seen = matcher.pulled(pyramid[-1], d)
        total, weight = total + values * seen[:, None], weight + seen
    return total / np.maximum(weight, 1e-9)[:, None], np.minimum(weight / (SEEN * len(pyramids)), 1)
