"""The print that all frames are laid upon: the mean over the anchors, the run's first chunk, and over frames spread over it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..kernels import bilinear
from ..surface.sampling import evenly
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
    start: np.ndarray | None = None  # (g,2) the slide that a frame without one before it begins with [m]


def anchors_and_samples(frames, first, anchors, samples):
    """(anchors, samples): frames spread evenly over the `first` chunk, and over all of `frames`, without those."""
    near = evenly(first, anchors)
    return near, [n for n in evenly(frames, samples) if n not in near]


def pyramid_of(matcher, views, offsets):
    """The pyramid of a frame's print, from its Unwrapped a camera and the cameras' colours `offsets` (c,3)."""
    return matcher.pyramid(*blended(views, offsets, len(matcher.surface.lattice)))


def reference_of(matcher, frames, posed, anchors, texture=None):
    """The Reference of `frames`, lists of Unwrapped a camera, and their surfaces (f,g,3), the `anchors` first. `texture`: the
    print (N,3) that the template itself shows, see `print_of_texture`: then also the slide that all frames share is known."""
    offsets = camera_offsets(frames, len(matcher.surface.lattice))
    pyramids = [pyramid_of(matcher, views, offsets) for views in frames]
    if texture is None:
        found = make_reference(matcher, pyramids, posed, anchors, matcher.settings.mean_rounds)
        return Reference(matcher.surface.rest, *found, offsets)
    wide, everywhere = matcher.widened(), np.ones(len(texture))
    start = wide.match(pyramid_of(wide, frames[0], offsets), wide.target(texture, everywhere), posed[0]).d
    near, onto = matcher.about(start), matcher.target(texture, everywhere)
    slides = [near.match(pyramid, onto, V, start).d for pyramid, V in zip(pyramids, posed)]
    return Reference(matcher.surface.rest, *mean_print(matcher, pyramids, slides), offsets, start)


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


def make_reference(matcher, pyramids, posed, anchors, rounds):
    """values, weights of the mean print, of pyramids of frames and their posed surfaces (f,g,3), the `anchors` first and in
    their order.

    Prints fix slides only up to one that all frames share: it is chosen so that edges keep the template's lengths."""
    slides = [matcher.unstretched(posed[:1])]
    for k in range(1, anchors):
        recent = slice(max(0, k - RECENT), k)
        onto = matcher.target(*mean_print(matcher, pyramids[recent], slides[recent]))
        slides.append(matcher.match(pyramids[k], onto, posed[k], slides[-1]).d)
    slides = shared_out(matcher, posed[:anchors], slides)
    for _ in range(rounds):
        onto = matcher.target(*mean_print(matcher, pyramids[: len(slides)], slides))
        starts = slides + [None] * (len(pyramids) - len(slides))
        slides = [matcher.match(p, onto, V, d).d for p, V, d in zip(pyramids, posed, starts)]
        slides = shared_out(matcher, posed, slides)
    return mean_print(matcher, pyramids, slides)


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
