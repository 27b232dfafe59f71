"""Brightness of pictures: cameras against one another, and each camera's pictures over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from ...frame_numbers import frame_ranges
from ...kernels.arrays import Anything, Floats
from ...scene import Frame
from .cameras import Finding

DARK = 4.0  # mean of a picture, or of the person in it, that is black
STOPS = 1.0  # of brightness that a camera, or a picture, may differ
GAMMA = 2.2  # sRGB's exponent
FEWEST = 3  # frames, or cameras, of which one is told from the others
MANY = 4  # numbers in a message


def exposures(frames: Sequence[Frame]) -> list[Finding]:
    """Black pictures; cameras that show the person brighter or darker than the others do; pictures and frames that are brighter or
    darker than the others of the same cameras."""
    person: dict[str, dict[int, float]] = {}
    room: dict[str, dict[int, float]] = {}
    found = []
    for frame in frames:
        for name, image in frame.images.items():
            grey, mask = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), frame.masks.get(name)
            shown = mask is not None and mask.any()
            bright = float(grey[mask].mean() if shown else grey.mean())
            if bright < DARK and (mask is None or shown):
                found.append(Finding(f"{name}: frame {frame.number} is black", serious=False))
                continue
            person.setdefault(name, {})[frame.number] = bright
            room.setdefault(name, {})[frame.number] = _outside(grey, mask if shown else None)
    return found + _of_cameras(person) + _over_time(person, room)


def _outside(grey: Anything, mask: Anything) -> float:
    """Mean of what lies behind the person, who may turn a brighter side; of the whole picture without a mask."""
    rest = grey if mask is None else grey[~mask]
    return float(rest.mean()) if rest.size else 0.0


def _of_cameras(person: Mapping[str, Mapping[int, float]]) -> list[Finding]:
    if len(person) < FEWEST:
        return []
    usual = {name: float(np.median(list(values.values()))) for name, values in person.items()}
    off = _stops(np.array(list(usual.values())))
    return [
        Finding(f"{name}: {_words(stops)} than the other cameras", serious=False)
        for name, stops in zip(usual, off)
        if abs(stops) > STOPS
    ]


def _over_time(person: Mapping[str, Mapping[int, float]], room: Mapping[str, Mapping[int, float]]) -> list[Finding]:
    """By the room behind the person, which stands still; in cameras where that is black by the person, of whom only all together tell."""
    still = {name: values for name, values in room.items() if min(values.values()) >= DARK}
    told = {
        name: dict(zip(values, _stops(np.array(list(values.values())))))
        for name, values in {**person, **still}.items()
        if len(values) >= FEWEST
    }
    found, numbers = [], sorted({number for of in told.values() for number in of})
    for number in numbers:
        off = [of[number] for of in told.values() if number in of]
        if len(off) >= FEWEST and abs(stops := float(np.median(off))) > STOPS:
            text = f"frame {number}: its pictures are {_words(stops)} than those of the other frames"
            found.append(Finding(f"{text}: does the light flicker, or the exposure change?", serious=False))
            told = {name: {n: value for n, value in of.items() if n != number} for name, of in told.items()}
    for name in still:
        if odd := [number for number, stops in told.get(name, {}).items() if abs(stops) > STOPS]:
            stops = max((told[name][number] for number in odd), key=abs)
            text = f"{name}: in frames {frame_ranges(odd, MANY)} {_words(stops)} than in its others"
            found.append(Finding(f"{text}: does its exposure change?", serious=False))
    return found


def _stops(values: Floats) -> Floats:
    """By how many stops each of some brightnesses (k,) differs from their median."""
    bounded = np.maximum(values, 0.5)
    return np.log2(bounded / max(float(np.median(bounded)), 0.5)) * GAMMA


def _words(stops: float) -> str:
    return f"about {abs(stops):.1f} stops {'brighter' if stops > 0 else 'darker'}"
