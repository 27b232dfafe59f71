"""All methods that are measured: the presets of toile, and peers."""

from . import ours, peers


def methods():
    return [*ours.methods(), *peers.methods()]
