"""Colours, prints, light, backgrounds and the camera's faults, drawn anew each time a PersonView is looked at."""

from __future__ import annotations

import cv2
import numpy as np

from ..paint import SKIN_TONES
from . import CLASSES
from .rooms import PRINT, any_colour, background, blotches, earth_colour, printed, skin_colour

PRINTS, BACKGROUNDS = 160, 160  # how many are kept
RENEWED = 0.04  # backgrounds drawn anew a picture
BLANKED = 0.45  # share of pictures of which a mask is given: what is off it is blanked
BLANK = (124, 116, 104)  # RGB, about the mean that networks take for zero
SKIN, HAIR, SHOES = (CLASSES.index(name) for name in ("skin", "hair", "shoes"))
HAIRS = ((0.05, 0.04, 0.04), (0.17, 0.10, 0.06), (0.35, 0.22, 0.12), (0.75, 0.60, 0.38), (0.6, 0.6, 0.6))
BOXED, PADDING = 0.65, 1.25  # share of pictures that show a box about the person, and how much larger that is
ZOOM = (0.85, 1.5)  # of the others, of a view whose sides are the picture's
TURN, SHIFT, STRETCH = 10.0, 0.04, 0.06  # degrees, share of the picture, log of the aspect: standard deviations
LIPS, EYES = (0.0, -0.167, 1.658), ((0.033, -0.145, 1.715), (-0.033, -0.145, 1.715))  # m on the neutral body


class Looks:
    """Pictures of PersonViews. `picture` gives RGB (S,S,3) uint8 and classes (S,S) uint8, S being `size`. `photographs`:
    RGB (h,w,3) uint8 of what is no person, to print on cloth and to stand behind people."""

    def __init__(self, size, rng, photographs=()):
        self.size, self.rng, self.photographs = size, rng, photographs
        self.prints = np.stack([printed(rng, photographs) for _ in range(PRINTS)])
        self.backgrounds = [background(size, rng, self.prints, photographs) for _ in range(BACKGROUNDS)]

    def picture(self, view):
        """Of the fields of a PersonView."""
        inside, rows, columns = self.window(view[1])
        classes, cover = (np.where(inside, field[rows, columns], 0) for field in view[:2])
        on = cover > 0
        place, normal = (field[rows[on], columns[on]].astype(np.float32) for field in view[2:])
        colour = np.zeros((*on.shape, 3), np.float32)
        colour[on] = self.painted(classes[on], place) * self.light(normal / 127)[:, None]
        alpha = (cv2.blur(cover.astype(np.float32) / 255, (3, 3)) * on)[..., None]
        image = alpha * colour + (1 - alpha) * self.shadowed(self.behind(), alpha)
        self.hide(image, classes)
        image = self.seen(image)
        if self.rng.uniform() < BLANKED:
            off = ~self.mask(classes > 0)
            image[off], classes[off] = BLANK, 0
        return image, classes

    def mask(self, on):
        """A mask (S,S) bool of what is shown of a person, as wrong as masks are: too wide or narrow, ragged, parts of it
        missing and parts of the background in it."""
        rng, S = self.rng, self.size
        if rng.uniform() < 0.3:
            return on
        soft = cv2.GaussianBlur(on.astype(np.float32), (0, 0), np.exp(rng.uniform(-1, 1.2)) * S / 192)
        soft += rng.uniform(0, 0.3) * blotches(S, int(np.exp(rng.uniform(1.5, 4))), rng)[..., 0] * (soft > 0.02)
        mask = (soft > rng.uniform(0.15, 0.75)).astype(np.uint8)
        for value in (0, 1):
            for _ in range(rng.integers(0, 3)):
                rows, columns = np.nonzero(mask)
                if len(rows) > 0:
                    k, axes = rng.integers(len(rows)), np.exp(rng.uniform(0, np.log(S / 10), 2)).astype(int)
                    at = int(columns[k]), int(rows[k])
                    cv2.ellipse(mask, at, tuple(map(int, axes)), rng.uniform(0, 180), 0, 360, value, -1)
        return mask > 0

    def window(self, cover):
        """Which pixels of a view (side,side) the picture's show: whether any, rows and columns, each (S,S). Of most views those
        of a box about the person, as networks are shown it."""
        rng, S, side = self.rng, self.size, len(cover)
        scale, middle = side / S / np.exp(rng.uniform(*np.log(ZOOM))), np.full(2, side / 2)
        shown = cv2.boundingRect(cover)
        if rng.uniform() < BOXED and min(shown[2:]) > 0:
            scale, middle = (
                PADDING * max(shown[2:]) / S * np.exp(rng.normal(0, 0.1)),
                np.add(shown[:2], np.divide(shown[2:], 2)),
            )
        turn = np.radians(TURN * rng.standard_normal())
        A = scale * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        A = A @ np.diag([rng.choice([-1, 1]) * np.exp(rng.normal(0, STRETCH)), 1])
        b = middle + SHIFT * S * scale * rng.standard_normal(2)
        at = (np.arange(S) + 0.5 - S / 2)[:, None]
        columns, rows = (A[i, 0] * at.T + A[i, 1] * at + b[i] for i in range(2))
        inside = (rows >= 0) & (rows < side) & (columns >= 0) & (columns < side)
        return inside, *(np.clip(values, 0, side - 1).astype(np.intp) for values in (rows, columns))

    def behind(self):
        """A background, cut out and flipped, and from time to time a new one."""
        rng, k = self.rng, self.rng.integers(BACKGROUNDS)
        side = len(self.backgrounds[k])
        if rng.uniform() < RENEWED:
            self.backgrounds[k] = background(side, rng, self.prints, self.photographs)
        part = int(rng.integers(min(self.size, side // 2), side + 1))
        top, left = rng.integers(side - part + 1, size=2)
        image = self.backgrounds[k][top : top + part, left : left + part]
        image = cv2.resize(image, (self.size, self.size), interpolation=cv2.INTER_AREA)
        return image[:, :: rng.choice([-1, 1]), rng.permutation(3) if rng.uniform() < 0.3 else slice(None)]

    def shadowed(self, image, alpha):
        """The background with the person's shadow on it, now and then."""
        rng, S = self.rng, self.size
        if rng.uniform() < 0.5:
            return image
        M = np.array(
            [[1, rng.normal(0, 0.3), rng.normal(0, 0.1) * S], [0, rng.uniform(0.3, 1), rng.uniform(0, 0.4) * S]]
        )
        shade = cv2.GaussianBlur(cv2.warpAffine(alpha, M, (S, S)), (0, 0), rng.uniform(0.01, 0.06) * S)
        return image * (1 - rng.uniform(0.1, 0.6) * shade[..., None])

    def painted(self, classes, place):
        """Colours (p,3): cloth plain or printed, skin and hair mottled."""
        rng, out = self.rng, np.zeros((len(classes), 3), np.float32)
        tone = self.tone()
        alike = (any_colour(rng), tone, None)[rng.choice(3, p=[0.12, 0.13, 0.75])]
        for kind in np.unique(classes[classes > 0]):
            mine = classes == kind
            P = place[mine]
            if kind in (SKIN, HAIR, SHOES):
                out[mine] = self.skin(P, tone) if kind == SKIN else self.hair() if kind == HAIR else any_colour(rng)
            else:
                out[mine] = self.cloth(P, alike)
            k = (rng.standard_normal((3, 6)) * np.exp(rng.uniform(2.7, 6))).astype(np.float32)
            waves = np.cos(P @ k + rng.uniform(0, 6, 6).astype(np.float32)).mean(1, keepdims=True)
            out[mine] *= 1 + rng.uniform(0, 0.15 if kind == SKIN else 0.4) * waves
        return out

    def cloth(self, P, alike):
        """Colours (p,3) of a garment at points (p,3): one stuff, or bands, borders, yokes, sides and sleeves of another."""
        rng, out = self.rng, self.stuff(P, alike)
        for _ in range(rng.choice([0, 1, 2, 3], p=[0.6, 0.2, 0.12, 0.08])):
            along = (P[:, 2], P[:, 2], P[:, 2], np.abs(P[:, 0]), P[:, 0])[rng.integers(5)]
            at = rng.uniform(along.min(), along.max())
            other = along > at if rng.uniform() < 0.5 else np.abs(along - at) < np.exp(rng.uniform(-5, -2.3))
            out[other] = self.stuff(P[other], alike)
        return out

    def stuff(self, P, alike):
        """Colours (p,3), plain or printed; a plain one is near the colour `alike` where one is given, or as earth or skin are."""
        rng, kind = self.rng, self.rng.uniform()
        if kind > 0.55:
            return self.print_at(P)
        plain = (
            any_colour(rng)
            if kind > 0.3
            else earth_colour(rng)
            if kind > 0.12
            else skin_colour(rng) * rng.uniform(0.5, 1.2)
        )
        if alike is not None and rng.uniform() < 0.7:
            plain = alike * rng.uniform(0.75, 1.25) * rng.uniform(0.9, 1.1, 3)
        return np.broadcast_to(np.clip(plain, 0.02, 1), (len(P), 3)).astype(np.float32)

    def tone(self):
        """RGB (3,) of a person's skin, between two known tones."""
        a, b = np.array(SKIN_TONES)[self.rng.integers(len(SKIN_TONES), size=2)]
        return np.clip((a + self.rng.uniform(-0.3, 1) * (b - a)) * self.rng.uniform(0.9, 1.1, 3), 0.05, 1)

    def skin(self, P, tone):
        """Colours (p,3) of skin of a tone: with lips, eyes, at times a beard and marks."""
        rng = self.rng
        colour = np.broadcast_to(tone, (len(P), 3)).astype(np.float32)
        near = lambda middle, wide: np.exp(-0.5 * (((P - np.float32(middle)) / np.float32(wide)) ** 2).sum(1))
        face = 0.4 * near(LIPS, (0.022, 0.02, 0.007)) + sum(0.8 * near(eye, (0.014, 0.02, 0.008)) for eye in EYES)
        if rng.uniform() < 0.25:
            face = face + rng.uniform(0.3, 0.8) * near((0, -0.15, 1.63), (0.06, 0.04, 0.03))
        for _ in range(rng.integers(0, 3)):
            face = face + rng.uniform(-0.5, 0.7) * near(P[rng.integers(len(P))], rng.uniform(0.004, 0.02, 3))
        return colour * (1 - face)[:, None]

    def hair(self):
        rng = self.rng
        return (
            any_colour(rng)
            if rng.uniform() < 0.3
            else np.array(HAIRS[rng.integers(len(HAIRS))]) * rng.uniform(0.6, 1.4)
        )

    def print_at(self, P):
        """A print of its own on front and back, by x and z of points (p,3)."""
        rng, scale = self.rng, PRINT * np.exp(self.rng.uniform(-0.9, 0.9))
        sides = self.prints[rng.integers(PRINTS, size=2)]
        if rng.uniform() < 0.5:
            sides[1] = sides[0]
        u, v = ((P[:, a] * scale + o).astype(int) % PRINT for a, o in zip((0, 2), rng.uniform(0, PRINT, 2)))
        return sides[(P[:, 1] < -0.02).astype(int), PRINT - 1 - v, u]

    def light(self, N):
        """Brightness (p,) under some lamps, of surfaces that face N (p,3), z away from the camera, y down."""
        rng = self.rng
        total = np.full(len(N), rng.uniform(0.25, 0.8), np.float32)
        for _ in range(rng.integers(1, 4)):
            d = rng.standard_normal(3) + [0, -0.8, -0.8]  # mostly from above and from the camera's side
            facing = np.maximum(N @ (d / np.linalg.norm(d)).astype(np.float32), 0)
            total += rng.uniform(0.1, 0.7) * facing
            if rng.uniform() < 0.3:
                total += rng.uniform(0, 0.25) * facing**20
        return total

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
        """(S,S,3) uint8 as a camera gives it: uneven light, a shadow's edge, exposure, tint, blur, noise, compression."""
        rng, S = self.rng, self.size
        image = image.astype(np.float32) * (1 + rng.uniform(0, 0.25) * blotches(S, rng.integers(1, 4), rng))
        if rng.uniform() < 0.25:
            edge = np.zeros((S, S), np.float32)
            cv2.fillPoly(edge, [rng.integers(-S // 2, 3 * S // 2, (4, 2)).astype(np.int32)], 1.0)
            edge = cv2.GaussianBlur(edge, (0, 0), np.exp(rng.uniform(-0.5, 2)))
            image *= 1 - rng.uniform(0.1, 0.5) * edge[..., None]
        exposed = rng.uniform(0.25, 0.6) / max(float(image.mean()), 0.02)  # cameras expose for the whole picture
        image *= (rng.uniform(0.9, 1.1, 3) * exposed ** rng.uniform(0.2, 1)).astype(np.float32)
        image = np.clip(image + np.float32(rng.normal(0, 0.03)), 0, 1) ** np.float32(np.exp(rng.normal(0, 0.25)))
        if rng.uniform() < 0.08:
            image[:] = image.mean(2, keepdims=True)
        if rng.uniform() < 0.5:
            image = cv2.GaussianBlur(image, (0, 0), rng.uniform(0.3, 1.3) * S / 192)
        if rng.uniform() < 0.1:
            length = int(rng.integers(3, 8))
            kernel = np.zeros((length, length), np.float32)
            cv2.line(kernel, tuple(map(int, rng.integers(0, length, 2))), (length // 2, length // 2), 1.0)
            image = cv2.filter2D(image, -1, kernel / kernel.sum())
        if rng.uniform() < 0.7:
            image = image + rng.standard_normal(image.shape, np.float32) * np.float32(rng.uniform(0, 0.05))
        image = (np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8)
        if rng.uniform() < 0.2:
            quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(25, 95))]
            image = cv2.imdecode(cv2.imencode(".jpg", image, quality)[1], 1)
        return image
