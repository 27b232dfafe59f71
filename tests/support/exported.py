"""Clips written by the exporters, for tests that read them back."""

from toile.io.export.writing import format_of, write_clip

NEAR = 1e-6  # m: half a step of single precision at 16 m


def quiet(*_):
    pass


def write(clip, out, kind=None, motion=None):
    return write_clip(clip, out, format_of(out, kind), motion, quiet)


def usd_name(layer):
    return layer.name.replace("-", "_")
