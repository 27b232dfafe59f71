"""Colours, prints, light, backgrounds and the camera's faults, drawn anew each time a PersonView is looked at."""

from __future__ import annotations

import cv2
import numpy as np

from ..paint import SKIN_TONES
from . import CLASSES

PRINTS, PRINT = 160, 128  # pictures on cloth: how many are kept, texels a side
BACKGROUNDS = 160
PLAIN = 0.2  # share of plain backgrounds
LETTERS = "ABDEFGHKMNOPRSTUVXZ0123456789"
SKIN, HAIR, SHOES = (CLASSES.index(name) for name in ("skin", "hair", "shoes"))


def any_colour(rng):
    """RGB (3,) in 0..1; greys and dark ones as often as clothes have them."""
    value, chroma = rng.uniform(0.04, 1), rng.choice([0.0, 0.25, 1.0]) * rng.uniform(0.3, 1)
    hue = rng.uniform(0, 2 * np.pi) + np.array([0, 2.1, 4.2])
    return np.clip(value * (1 + chroma * (0.5 * np.cos(hue) - 0.5)), 0, 1)


def blotches(size, cells, rng, channels=1):
    """Smooth noise (size,size,channels) in about -1..1, `cells` bumps a side."""
    coarse = rng.standard_normal((int(cells) + 3, int(cells) + 3, channels)).astype(np.float32)
    return 0.7 * cv2.resize(coarse, (size, size), interpolation=cv2.INTER_CUBIC).reshape(size, size, channels)


def shapes(image, rng, count, large):
    """Boxes, discs, lines, polygons and letters on an image (S,S,3) in 0..1."""
    S, image = len(image), (255 * np.clip(image, 0, 1)).astype(np.uint8)
    for _ in range(count):
        colour = tuple(map(float, 255 * any_colour(rng)))
        a, b = (tuple(map(int, rng.integers(-S // 8, S + S // 8, 2))) for _ in range(2))
        near = tuple(int(v + rng.integers(-S // large, S // large + 1)) for v in a)
        kind = rng.integers(6)
        if kind == 0:
            cv2.rectangle(image, a, near, colour, -1)
        elif kind == 1:
            cv2.ellipse(
                image,
                a,
                (S // large // 2 + 1, int(rng.integers(2, S // large + 3))),
                rng.uniform(0, 360),
                0,
                360,
                colour,
                -1,
            )
        elif kind == 2:
            cv2.line(image, a, b, colour, int(rng.integers(1, 2 + S // 24)), cv2.LINE_AA)
        elif kind == 3:
            corners = np.array(a) + rng.integers(-S // large, S // large + 1, (4, 2))
            cv2.fillPoly(image, [corners.astype(np.int32)], colour)
        elif kind == 4:  # as a limb: a tapering stroke
            cv2.line(image, a, near, colour, int(rng.integers(2, 3 + S // 10)), cv2.LINE_AA)
        else:
            word = "".join(rng.choice(list(LETTERS), rng.integers(1, 6)))
            cv2.putText(
                image, word, a, int(rng.integers(0, 5)), rng.uniform(0.4, 3) * S / 256, colour, 1 + S // 60, cv2.LINE_AA
            )
    return image.astype(np.float32) / 255


def background(size, rng):
    """A room that is none (size,size,3) in 0..1: walls, floor, clutter."""
    if rng.uniform() < PLAIN:
        plain = np.broadcast_to(any_colour(rng), (size, size, 3)).astype(np.float32).copy()
        return plain + rng.uniform(0, 0.06) * blotches(size, rng.integers(1, 5), rng)
    up, down = any_colour(rng), any_colour(rng)
    t = np.clip((np.linspace(0, 1, size) - rng.uniform(0.2, 0.9)) * np.exp(rng.uniform(0, 5)) + 0.5, 0, 1)[
        :, None, None
    ]
    image = np.ascontiguousarray(np.broadcast_to(up + (down - up) * t, (size, size, 3)), np.float32)
    image = shapes(image, rng, int(rng.integers(0, 12)), 2)
    image += rng.uniform(0, 0.3) * blotches(size, np.exp(rng.uniform(0.5, 4)), rng, int(rng.choice([1, 3])))
    image = shapes(image, rng, int(rng.integers(0, 40)), 6)
    if rng.uniform() < 0.3:
        image = np.concatenate([image[: size // 2], image[: size - size // 2] * rng.uniform(0.3, 1)])
    turn = cv2.getRotationMatrix2D((size / 2, size / 2), rng.normal(0, 15), rng.uniform(1, 1.6))
    image = cv2.warpAffine(image, turn, (size, size), borderMode=cv2.BORDER_REFLECT)
    return np.clip(cv2.GaussianBlur(image, (0, 0), np.exp(rng.uniform(-1.5, 1.2))), 0, 1)


def printed(rng):
    """A picture on cloth (PRINT,PRINT,3) in 0..1."""
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


class Looks:
    """Pictures of PersonViews. `picture` gives RGB (S,S,3) uint8 and classes (S,S) uint8, S being `size`."""

    def __init__(self, size, rng):
        self.size, self.rng = size, rng
        self.prints = [printed(rng) for _ in range(PRINTS)]
        self.backgrounds = [background(size, rng) for _ in range(BACKGROUNDS)]

    def picture(self, view):
        rng = self.rng
        step = rng.choice([-1, 1])
        every = rng.integers(1, len(view[0]) // self.size + 1)
        top, left = rng.integers(len(view[0]) - every * (self.size - 1), size=2)
        window = slice(top, top + every * self.size, every), slice(left, left + every * self.size, every)
        classes, cover, place, normal = (a[window][:, ::step] for a in view)
        classes = classes.copy()
        on = cover > 0
        colour = np.zeros((*on.shape, 3), np.float32)
        colour[on] = self.painted(classes[on], place[on].astype(np.float32)) * self.light(normal[on] / 127.0)[:, None]
        alpha = cv2.blur(cover.astype(np.float32) / 255, (3, 3)) * on
        image = alpha[..., None] * colour + (1 - alpha[..., None]) * self.behind()
        self.hide(image, classes)
        return self.seen(image), classes

    def behind(self):
        """A background, flipped, and from time to time a new one."""
        rng, k = self.rng, self.rng.integers(BACKGROUNDS)
        if rng.uniform() < 0.15:
            self.backgrounds[k] = background(len(self.backgrounds[k]), rng)
        top, left = rng.integers(len(self.backgrounds[k]) - self.size + 1, size=2)
        image = self.backgrounds[k][top : top + self.size, left : left + self.size][:, :: rng.choice([-1, 1])]
        return image[..., rng.permutation(3)] * rng.uniform(0.6, 1.2)

    def painted(self, classes, place):
        """Colours (p,3): cloth plain or printed, skin and hair mottled."""
        rng, out = self.rng, np.zeros((len(classes), 3), np.float32)
        for kind in np.unique(classes[classes > 0]):
            mine = classes == kind
            P, base = place[mine], any_colour(rng)
            if kind == SKIN:
                a, b = rng.integers(len(SKIN_TONES), size=2)
                base = np.array(SKIN_TONES[a]) + rng.uniform(-0.3, 1) * (np.array(SKIN_TONES[b]) - SKIN_TONES[a])
                base = base * rng.uniform(0.9, 1.1, 3)
            if kind in (SKIN, HAIR, SHOES) or rng.uniform() < 0.4:
                out[mine] = base
            else:
                out[mine] = self.print_at(P)
            waves = np.cos(
                P @ (rng.standard_normal((3, 8)) * rng.uniform(20, 250)).astype(np.float32) + rng.uniform(0, 6, 8)
            )
            out[mine] *= 1 + rng.uniform(0, 0.12) * waves.mean(1, keepdims=True) * 2
        return out

    def print_at(self, P):
        """A print of its own on front and back, by x and z of points (p,3)."""
        rng, scale = self.rng, PRINT * np.exp(self.rng.uniform(-0.9, 0.9))
        sides = [self.prints[k] for k in rng.integers(PRINTS, size=2)]
        if rng.uniform() < 0.5:
            sides[1] = sides[0]
        u, v = ((P[:, a] * scale + o).astype(int) % PRINT for a, o in zip((0, 2), rng.uniform(0, PRINT, 2)))
        return np.where((P[:, 1] < -0.02)[:, None], sides[0][PRINT - 1 - v, u], sides[1][PRINT - 1 - v, u])

    def light(self, N):
        """Brightness (p,) under some lamps, of surfaces that face N (p,3), z towards the camera."""
        rng = self.rng
        total = np.full(len(N), rng.uniform(0.3, 0.8))
        for _ in range(rng.integers(1, 4)):
            d = rng.standard_normal(3) + [0, -0.8, -0.8]  # mostly from above and from the camera's side
            d /= np.linalg.norm(d)
            total += rng.uniform(0.1, 0.7) * np.maximum(N @ d, 0)
            total += rng.uniform(0, 0.15) * np.maximum(N @ d, 0) ** 20
        return total.astype(np.float32)

    def hide(self, image, classes):
        """Something before the person, now and then."""
        rng = self.rng
        if rng.uniform() > 0.15:
            return
        a, S = rng.integers(0, self.size, 2), self.size
        wide, tall = rng.integers(4, S // 3, 2)
        if rng.uniform() < 0.4:
            wide = S
        box = (slice(a[0], a[0] + tall), slice(a[1] if wide < S else 0, a[1] + wide))
        image[box] = self.behind()[box]
        classes[box] = 0

    def seen(self, image):
        """(S,S,3) uint8 as a camera gives it: uneven light, exposure, tint, blur, noise, compression."""
        rng, S = self.rng, self.size
        image = image * (1 + rng.uniform(0, 0.25) * blotches(S, rng.integers(1, 4), rng))
        image = np.clip(image * rng.uniform(0.85, 1.15, 3) * np.exp(rng.normal(0, 0.25)) + rng.normal(0, 0.03), 0, 1)
        image = image ** np.exp(rng.normal(0, 0.25))
        if rng.uniform() < 0.1:
            image = np.broadcast_to(image.mean(2, keepdims=True), image.shape)
        if rng.uniform() < 0.5:
            image = cv2.GaussianBlur(image, (0, 0), rng.uniform(0.3, 1.8))
        if rng.uniform() < 0.15:
            length = int(rng.integers(3, 9))
            kernel = np.zeros((length, length), np.float32)
            cv2.line(kernel, tuple(map(int, rng.integers(0, length, 2))), (length // 2, length // 2), 1.0)
            image = cv2.filter2D(image, -1, kernel / kernel.sum())
        image = image + rng.normal(0, 1, image.shape) * rng.uniform(0, 0.05)
        image = (np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8)
        if rng.uniform() < 0.3:
            image = cv2.imdecode(
                cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(25, 95))])[1], 1
            )
        return image
