"""What is behind people: rooms that are none, drawn at random from walls, boxes, printed quadrilaterals, cables and clutter."""

from __future__ import annotations

import cv2
import numpy as np

from ..paint import SKIN_TONES

PRINT = 128  # texels a side of a picture on cloth
LETTERS = "ABDEFGHKMNOPRSTUVXZ0123456789"
PLAIN, ABSTRACT = 0.12, 0.3  # shares of backgrounds that are a plain wall, and that are no room at all
PHOTOGRAPHED = 0.35  # share of backgrounds and prints that are cut out of photographs, where some are given


def any_colour(rng):
    """RGB (3,) in 0..1; greys and dark ones as often as clothes have them."""
    value, chroma = rng.uniform(0.04, 1), rng.choice([0.0, 0.25, 1.0]) * rng.uniform(0.3, 1)
    hue = rng.uniform(0, 2 * np.pi) + np.array([0, 2.1, 4.2])
    return np.clip(value * (1 + chroma * (0.5 * np.cos(hue) - 0.5)), 0, 1)


def thing_colour(rng):
    """As `any_colour`; wood and walls look like skin from time to time."""
    return any_colour(rng) if rng.uniform() > 0.15 else skin_colour(rng)


def earth_colour(rng):
    """RGB (3,) in 0..1 of cloth as earth is: beige, khaki, olive, brown; skin lies among them."""
    value, chroma = rng.uniform(0.08, 0.95), rng.uniform(0.05, 0.65)
    return value * np.array([1, 1 - chroma * rng.uniform(0.1, 0.7), 1 - chroma])


def skin_colour(rng):
    """RGB (3,) in 0..1 about a tone of skin."""
    return np.clip(np.array(SKIN_TONES[rng.integers(len(SKIN_TONES))]) * rng.uniform(0.7, 1.2, 3), 0, 1)


def blotches(size, cells, rng, channels=1):
    """Smooth noise (size,size,channels) float32 in about -1..1, `cells` bumps a side."""
    coarse = rng.standard_normal((int(cells) + 3, int(cells) + 3, channels), np.float32)
    return 0.7 * cv2.resize(coarse, (size, size), interpolation=cv2.INTER_CUBIC).reshape(size, size, channels)


def shapes(image, rng, count, large):
    """Boxes, discs, lines, polygons and letters on an image (S,S,3) in 0..1."""
    S, image = len(image), (255 * np.clip(image, 0, 1)).astype(np.uint8)
    for _ in range(count):
        colour = tuple(map(float, 255 * thing_colour(rng)))
        a, b = (tuple(map(int, rng.integers(-S // 8, S + S // 8, 2))) for _ in range(2))
        near = tuple(int(v + rng.integers(-S // large, S // large + 1)) for v in a)
        kind = rng.integers(6)
        if kind == 0:
            cv2.rectangle(image, a, near, colour, -1)
        elif kind == 1:
            axes = S // large // 2 + 1, int(rng.integers(2, S // large + 3))
            cv2.ellipse(image, a, axes, rng.uniform(0, 360), 0, 360, colour, -1)
        elif kind == 2:
            cv2.line(image, a, b, colour, int(rng.integers(1, 2 + S // 24)), cv2.LINE_AA)
        elif kind == 3:
            corners = np.array(a) + rng.integers(-S // large, S // large + 1, (4, 2))
            cv2.fillPoly(image, [corners.astype(np.int32)], colour)
        elif kind == 4:  # as a limb: a tapering stroke
            cv2.line(image, a, near, colour, int(rng.integers(2, 3 + S // 10)), cv2.LINE_AA)
        else:
            word, scale = "".join(rng.choice(list(LETTERS), rng.integers(1, 6))), rng.uniform(0.4, 3) * S / 256
            cv2.putText(image, word, a, int(rng.integers(0, 5)), scale, colour, 1 + S // 60, cv2.LINE_AA)
    return image.astype(np.float32) / 255


def cut_out(size, rng, photographs):
    """A part of one of some photographs (h,w,3) uint8, at any scale, as (size,size,3) float32 in 0..1."""
    photograph = photographs[rng.integers(len(photographs))]
    height, width = photograph.shape[:2]
    tall = rng.uniform(0.1, 1) * min(height, width)
    wide = min(tall * np.exp(rng.normal(0, 0.2)), width)
    top, left = (int(rng.uniform(0, 1) * (side - part)) for side, part in ((height, tall), (width, wide)))
    part = photograph[top : top + max(int(tall), 8), left : left + max(int(wide), 8)]
    return cv2.resize(part, (size, size), interpolation=cv2.INTER_AREA).astype(np.float32) / 255


def printed(rng, photographs=()):
    """A picture on cloth (PRINT,PRINT,3) float32 in 0..1."""
    if len(photographs) and rng.uniform() < PHOTOGRAPHED:
        return cut_out(PRINT, rng, photographs)
    image = np.broadcast_to(any_colour(rng), (PRINT, PRINT, 3)).astype(np.float32).copy()
    kind, ink = rng.integers(5), any_colour(rng)
    i, j = np.mgrid[:PRINT, :PRINT]
    period, width = int(rng.integers(4, 40)), rng.uniform(0.1, 0.6)
    if kind == 0:
        image[(i if rng.uniform() < 0.7 else j) % period < width * period] = ink
    elif kind == 1:
        image[(i % period < width * period) ^ (j % period < width * period)] = ink
    elif kind == 2:
        image[(i % period - period / 2) ** 2 + (j % period - period / 2) ** 2 < (0.5 * width * period) ** 2] = ink
    elif kind == 3:
        image += rng.uniform(0.1, 0.5) * blotches(PRINT, rng.integers(3, 30), rng, 3)
    return np.clip(shapes(image, rng, int(rng.integers(0, 8)), 3), 0, 1)


def background(size, rng, prints, photographs=()):
    """A background (size,size,3) float32 in 0..1; some of its quadrilaterals carry one of `prints` (n,PRINT,PRINT,3)."""
    if len(photographs) and rng.uniform() < PHOTOGRAPHED:
        return cut_out(size, rng, photographs)
    kind = rng.uniform()
    if kind < PLAIN:
        plain = np.broadcast_to(any_colour(rng), (size, size, 3)).astype(np.float32)
        return np.clip(plain + rng.uniform(0, 0.06) * blotches(size, rng.integers(1, 5), rng), 0, 1)
    image = abstract(size, rng) if kind < PLAIN + ABSTRACT else room(size, rng, prints)
    image = image + rng.uniform(0, 0.06) * blotches(size, rng.integers(20, size // 2), rng)
    return np.clip(cv2.GaussianBlur(image, (0, 0), np.exp(rng.uniform(-1.5, 0.8))), 0, 1).astype(np.float32)


def abstract(size, rng):
    """Coarse shapes, blotches and fine shapes, turned."""
    up, down = thing_colour(rng), thing_colour(rng)
    t = np.clip((np.linspace(0, 1, size) - rng.uniform(0.2, 0.9)) * np.exp(rng.uniform(0, 5)) + 0.5, 0, 1)
    image = np.ascontiguousarray(np.broadcast_to(up + (down - up) * t[:, None, None], (size, size, 3)), np.float32)
    image = shapes(image, rng, int(rng.integers(0, 12)), 2)
    image += rng.uniform(0, 0.3) * blotches(size, np.exp(rng.uniform(0.5, 4)), rng, int(rng.choice([1, 3])))
    image = shapes(image, rng, int(rng.integers(0, 40)), 6)
    turn = cv2.getRotationMatrix2D((size / 2, size / 2), rng.normal(0, 15), rng.uniform(1, 1.6))
    return cv2.warpAffine(image, turn, (size, size), borderMode=cv2.BORDER_REFLECT)


def room(size, rng, prints):
    """Walls and a floor with mats, boxes, windows and posters, furniture of bars, cables, and lamps' light on all."""
    S = size
    image = np.ascontiguousarray(np.broadcast_to(thing_colour(rng), (S, S, 3)), np.float32)
    for _ in range(rng.integers(0, 3)):  # walls that meet, ceilings
        side = rng.uniform(-0.2, 1.2, 2) * S
        corners = [(side[0], -S), (side[1], 2 * S), (2 * S, 2 * S), (2 * S, -S)]
        filled(image, corners, image[0, -1] * rng.uniform(0.6, 1.3), rng)
    level, slope = rng.uniform(0.35, 0.95), rng.normal(0, 0.15)
    filled(
        image,
        [(-S, (level - slope) * S), (2 * S, (level + slope) * S), (2 * S, 3 * S), (-S, 3 * S)],
        thing_colour(rng),
        rng,
    )
    for _ in range(rng.integers(2, 22)):
        middle, half = rng.uniform(-0.1, 1.1, 2) * S, S * np.exp(rng.uniform(-3.5, -0.9))
        thing = quadrilateral(rng) * half + middle
        kind = rng.uniform()
        if kind < 0.3:
            pasted(image, thing, prints[rng.integers(len(prints))] * rng.uniform(0.5, 1.2))
        elif kind < 0.6:
            box(image, thing, rng)
        elif kind < 0.75:
            bars(image, thing, rng)
        else:
            filled(image, thing, thing_colour(rng), rng)
    for _ in range(rng.integers(0, 5)):  # cables
        path = np.cumsum(rng.normal(0, S / 16, (12, 2)) + rng.normal(0, S / 24, 2), 0) + rng.uniform(0, S, 2)
        cv2.polylines(image, [path.astype(np.int32)], False, thing_colour(rng), int(rng.integers(1, 4)), cv2.LINE_AA)
    return image * (1 + rng.uniform(0, 0.35) * blotches(S, rng.integers(1, 4), rng))


def quadrilateral(rng):
    """Corners (4,2) of a rectangle turned a little and seen aslant, about 0, of size 1 or less."""
    wide = np.array([1, np.exp(rng.uniform(-1.6, 0))])[:: rng.choice([-1, 1])]
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * wide
    shear, turn = rng.normal(0, 0.35, (2, 2)) * rng.choice([0.2, 1]) + np.eye(2), rng.normal(0, 0.2)
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return corners @ (R @ shear).T * (1 + 0.15 * rng.normal(size=(4, 1)))


def filled(image, corners, colour, rng):
    """A polygon on the image, in place, its colour fading along a direction."""
    on = np.zeros(image.shape[:2], np.uint8)
    cv2.fillPoly(on, [np.array(corners).astype(np.int32)], 1)
    rows, columns = np.nonzero(on)
    if len(rows) == 0:
        return
    ramp = (rows * rng.normal() + columns * rng.normal()) * (0.3 / len(image))
    image[rows, columns] = np.clip(colour * (1 + ramp - ramp.mean())[:, None], 0, 1)


def pasted(image, corners, picture):
    """A picture (P,P,3) on a quadrilateral of the image, in place."""
    S, P = len(image), len(picture)
    source = np.array([(0, 0), (P, 0), (P, P), (0, P)], np.float32)
    M = cv2.getPerspectiveTransform(source, corners.astype(np.float32))
    on = np.zeros((S, S), np.uint8)
    cv2.fillConvexPoly(on, corners.astype(np.int32), 1)
    on = on > 0
    image[on] = np.clip(cv2.warpPerspective(picture, M, (S, S), borderMode=cv2.BORDER_REFLECT)[on], 0, 1)


def box(image, front, rng):
    """A box with this front, its top and one side."""
    colour, depth = thing_colour(rng), rng.normal(0, 0.5, 2) * np.ptp(front, axis=0)
    for i in range(4):
        a, b = front[i], front[(i + 1) % 4]
        filled(image, [a, b, b + depth, a + depth], colour * rng.uniform(0.5, 1.2), rng)
    filled(image, front, colour, rng)


def bars(image, corners, rng):
    """Parallel bars between two sides of a quadrilateral: blinds, shelves, legs of tables."""
    colour, thick = thing_colour(rng), int(rng.integers(1, 5))
    for t in np.linspace(0, 1, int(rng.integers(2, 12))):
        a, b = (corners[i] + t * (corners[j] - corners[i]) for i, j in ((0, 3), (1, 2)))
        cv2.line(image, tuple(map(int, a)), tuple(map(int, b)), tuple(map(float, colour)), thick, cv2.LINE_AA)
