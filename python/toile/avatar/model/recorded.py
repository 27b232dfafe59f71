"""Decoding as one graph of a CUDA device: recorded once and replayed, so that the host issues one operation in place of hundreds, for
which the device would wait."""

from __future__ import annotations

from dataclasses import fields

import torch

from .layer_model import Decoded
from .networks import Conv

READ = ("rotations", "translation", "face", "face_seen", "T_camera_world")  # of a batch, by `decode`


def repeatable():
    """Within it a GPU's convolutions give the same bits each time, as everything else in decoding and shadows does; on an H200 that
    costs nothing that can be measured."""
    return torch.backends.cudnn.flags(enabled=True, deterministic=True, allow_tf32=torch.backends.cudnn.allow_tf32)


def decoder(avatar):
    """What decodes as `avatar.decode` does where no gradient is asked for: on a CUDA device a `Recorded`, but of an avatar that regresses
    its codes from poses."""
    if not avatar.up.is_cuda:
        return avatar.decode
    return Recorded(avatar) if avatar.projection is None else repeatable()(avatar.decode)


class Recorded:
    """`avatar.decode` of an avatar that changes no more. Each kind of call, by its shapes, is recorded at its first use."""

    def __init__(self, avatar):
        self.avatar, self.graphs = avatar, {}

    @torch.no_grad()
    def __call__(self, batch, latents, names=None, texture=True):
        given = {key: batch[key] for key in READ} | {("code", name): z for name, z in latents.items()}
        names = None if names is None else tuple(names)
        kind = names, texture, tuple((key, tuple(x.shape), x.dtype) for key, x in given.items())
        if kind not in self.graphs:
            self.graphs[kind] = _Graph(self.avatar, given, names, texture)
        return self.graphs[kind].play(given)


class _Graph:
    """A call's operations on tensors that stay in their places."""

    def __init__(self, avatar, given, names, texture):
        self.given = {key: x.clone() for key, x in given.items()}
        batch = {key: x for key, x in self.given.items() if isinstance(key, str)}
        latents = {key[1]: x for key, x in self.given.items() if not isinstance(key, str)}
        call = lambda: avatar.decode(batch, latents, names, texture)
        with repeatable():
            aside = torch.cuda.Stream()
            aside.wait_stream(torch.cuda.current_stream())
            with torch.cuda.stream(aside):
                call()  # libraries choose their ways, and what is made once is made
            torch.cuda.current_stream().wait_stream(aside)
            self.weights = [conv.folded for conv in avatar.modules() if isinstance(conv, Conv)]  # in their places too
            self.graph = torch.cuda.CUDAGraph()
            with torch.cuda.graph(self.graph):
                self.found = call()

    def play(self, given):
        """{layer: Decoded}, copies that the next call leaves alone."""
        for key, place in self.given.items():
            place.copy_(given[key])
        self.graph.replay()
        return {name: Decoded(*map(_copy, _values(one))) for name, one in self.found.items()}


def _values(decoded):
    return [getattr(decoded, field.name) for field in fields(decoded)]


def _copy(tensor):
    return None if tensor is None else tensor.clone()
