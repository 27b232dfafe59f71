"""Procedural looks: which part of the outer surface a point belongs to, and its colour."""

from __future__ import annotations

import numpy as np

from .surface import smooth_noise

LABELS = {
    "skin": 1, "hair": 2, "tshirt": 3, "trousers": 4, "shoes": 5,
    "longsleeve": 6, "tank": 7, "dress": 8, "shorts": 9, "skirt": 10, "baselayer": 11,
}  # fmt: skip
PAINTED = ("skin", "hair", "trousers", "shoes")  # on the body itself
LOWER = ("trousers", "shorts", "skirt", "dress")  # under which legs are bare
TEXTURE = 1024  # texels per side of a garment's front and back
SHIRT_BOX = (-0.40, 0.40, -0.42, 0.38)  # m: x and z range of the flat garment about its centre that the texture spans
WIDE_BOX = (-0.55, 0.55, -0.55, 0.55)
BOXES = {"tshirt": SHIRT_BOX, "tank": SHIRT_BOX}

LOOKS = {  # RGB 0..1
    "fitted": {
        "shirt": (0.16, 0.30, 0.62), "ink": (0.93, 0.90, 0.80),
        "trousers": (0.22, 0.22, 0.25), "hair": (0.20, 0.13, 0.08),
    },
    "logo": {
        "shirt": (0.88, 0.87, 0.83), "ink": (0.75, 0.10, 0.12),
        "trousers": (0.15, 0.20, 0.36), "hair": (0.08, 0.07, 0.06),
    },
    "loose": {
        "shirt": (0.12, 0.42, 0.30), "ink": (0.95, 0.80, 0.25),
        "trousers": (0.42, 0.36, 0.27), "hair": (0.45, 0.30, 0.15),
    },
}  # fmt: skip
LOOKS |= {"child": LOOKS["loose"], "tall": LOOKS["logo"], "heavy": LOOKS["fitted"]}
UNDER = (0.85, 0.55, 0.30)  # of a shirt under a shirt
SKIN_TONES = ((0.93, 0.76, 0.66), (0.80, 0.60, 0.47), (0.58, 0.40, 0.29), (0.38, 0.25, 0.18))
SHOES = (0.70, 0.68, 0.66)
EYES = (0.55, 0.55, 0.54)


class Appearance:
    """Colours and parts of one person. `garments`: name and flat vertices (G,3) of each, inner to outer."""

    def __init__(self, subject, body, garments, rng):
        names = body.model.joint_names
        limb = np.array([n.startswith(("upperarm", "lowerarm", "wrist", "finger", "metacarpal")) for n in names])
        self.arm = body.dense_weights[:, limb].sum(1)
        self.head = body.dense_weights[:, [n in ("head", "neck03") for n in names]].sum(1)
        self.skin_vertex = np.zeros(len(body.rest), bool)
        self.skin_vertex[body.skin_faces] = True
        self.neutral = body.neutral
        self.colours = LOOKS[subject]
        self.skin = np.array(SKIN_TONES[rng.integers(len(SKIN_TONES))])
        self.noise_seed = int(rng.integers(2**31))
        shirts = [name for name, _ in garments if name not in LOWER]
        self.prints = []
        for i, (name, flat) in enumerate(garments):
            draw = shirt_textures if name not in LOWER or name == "dress" else trousers_textures
            colours = self.colours | {"shirt": UNDER} if name in shirts[:-1] else self.colours
            self.prints.append(Print(name, flat, draw(subject, colours), self.noise_seed + len(garments) - i))
        self.owner = np.repeat(np.arange(len(garments)), [len(p.flat) for p in self.prints])
        self.bare_legs = any(name in LOWER for name, _ in garments)

    def body_labels(self, neutral, arm, head):
        """Part ids of body points: coordinates (n,3) on the neutral body, shares of arm and head weights (n,)."""
        x, y, z = neutral.T
        label = np.full(len(neutral), LABELS["skin"], np.uint8)
        if not self.bare_legs:
            label[(z < 1.085) & (arm < 0.5)] = LABELS["trousers"]
        label[(z < 0.115) & (arm < 0.5)] = LABELS["shoes"]
        hairline = (z - 1.76) + 1.1 * (y + 0.07)
        label[(hairline > 0) & (head > 0.5) & (z > 1.67)] = LABELS["hair"]
        return label

    def vertex_labels(self):
        """Part ids (n,) per body vertex, under whatever covers it."""
        return self.body_labels(self.neutral, self.arm, self.head)

    def body_colours(self, neutral, label, is_skin):
        table = np.zeros((6, 3))
        table[LABELS["skin"]], table[LABELS["hair"]] = self.skin, self.colours["hair"]
        table[LABELS["trousers"]], table[LABELS["shoes"]] = self.colours["trousers"], SHOES
        colour = table[label]
        rng = np.random.default_rng(self.noise_seed)
        coarse, fine = smooth_noise(neutral, 0.03, rng, 24), smooth_noise(neutral, 0.006, rng, 24)
        strength = np.array([0, 0.025, 0.10, 0, 0.05, 0.04])[label]
        colour = colour * (1 + strength * (coarse + fine))[:, None]
        lips = np.exp(-0.5 * (((neutral - [0, -0.167, 1.658]) / [0.022, 0.02, 0.007]) ** 2).sum(1))
        colour = colour + (lips * (label == LABELS["skin"]))[:, None] * [0.05, -0.15, -0.12]
        seam = (label == LABELS["trousers"]) & (np.abs(neutral[:, 1] + 0.002) < 0.006)
        colour[seam] *= 0.6
        colour[~is_skin] = EYES
        return colour

    def cloth_labels(self, vertices):
        """Part ids (p,) of vertices (p,) among those of all garments, one garment after the other."""
        return np.array([LABELS[p.name] for p in self.prints], np.int64)[self.owner[vertices]]

    def cloth_colours(self, corners, bary):
        """Colours (p,3) of points on the garments: `corners` (p,3) as in `cloth_labels`, `bary` (p,3)."""
        colour, start = np.zeros((len(corners), 3)), 0
        for i, printed in enumerate(self.prints):
            mine = self.owner[corners[:, 0]] == i
            flat = printed.flat[corners[mine] - start]
            colour[mine] = printed.colours(np.einsum("pc,pcd->pd", bary[mine], flat))
            start += len(printed.flat)
        return colour


class Print:
    """What is printed on a garment: pictures of its front, where y < 0, and its back over x and z of the flat garment."""

    def __init__(self, name, flat, textures, seed):
        self.name, self.box, self.textures, self.seed = name, BOXES.get(name, WIDE_BOX), textures, seed
        self.flat = flat - 0.5 * (flat.min(0) + flat.max(0))

    def texels(self, flat):
        """Texel coordinates (u to the right, v down) on the front's picture of flat points (n,3)."""
        left, right, low, high = self.box
        return (flat[:, 0] - left) / (right - left) * (TEXTURE - 1), (high - flat[:, 2]) / (high - low) * (TEXTURE - 1)

    def colours(self, flat):
        """Colours (n,3) at flat points (n,3), with the weave."""
        u, v = self.texels(flat)
        front = bilinear(self.textures[0], u, v)
        back = bilinear(self.textures[1], TEXTURE - 1 - u, v)
        weave = smooth_noise(flat, 0.004, np.random.default_rng(self.seed), 24)
        return np.where((flat[:, 1] < 0)[:, None], front, back) * (1 + 0.03 * weave)[:, None]

    def atlas(self):
        """Front and back beside each other (TEXTURE, 2 TEXTURE, 3), with the weave."""
        rng = np.random.default_rng(self.seed)
        i, j = np.mgrid[:TEXTURE, : 2 * TEXTURE].reshape(2, -1) * (self.box[1] - self.box[0]) / TEXTURE
        weave = smooth_noise(np.stack([j, np.zeros(len(i)), i], 1), 0.004, rng, 24).reshape(TEXTURE, -1, 1)
        return np.concatenate(self.textures, 1) * (1 + 0.03 * weave)


def bilinear(image, u, v):
    u, v = np.clip(u, 0, image.shape[1] - 1.001), np.clip(v, 0, image.shape[0] - 1.001)
    i, j = v.astype(int), u.astype(int)
    a, b = (v - i)[:, None], (u - j)[:, None]
    above = (1 - b) * image[i, j] + b * image[i, j + 1]
    below = (1 - b) * image[i + 1, j] + b * image[i + 1, j + 1]
    return (1 - a) * above + a * below


def shirt_textures(subject, colours):
    """Front and back pictures (TEXTURE, TEXTURE, 3) in 0..1, as seen from outside; x grows to the wearer's left."""
    from PIL import Image, ImageDraw, ImageFont

    ink = tuple(int(255 * c) for c in colours["ink"])
    sides = []
    for side in ("front", "back"):
        image = Image.new("RGB", (TEXTURE, TEXTURE), tuple(int(255 * c) for c in colours["shirt"]))
        draw = ImageDraw.Draw(image)
        if subject == "loose":
            for y in range(0, TEXTURE, 48):
                draw.rectangle((0, y, TEXTURE, y + 12), fill=ink)
        for y in range(24, TEXTURE, 64):  # a small allover print: texture everywhere, as stereo needs
            for x in range(24 + (y // 64 % 2) * 32, TEXTURE, 64):
                draw.ellipse((x - 3, y - 3, x + 3, y + 3), fill=ink)
        if side == "front":
            if subject == "logo":
                draw.ellipse((392, 300, 632, 540), fill=ink)
                draw.polygon([(512, 330), (600, 490), (424, 490)], fill=tuple(int(255 * c) for c in colours["shirt"]))
            top = 620 if subject == "logo" else 420
            draw.text((512, top), "TOILE", font=ImageFont.load_default(120), fill=ink, anchor="mm")
            draw.text((512, top + 110), "cut once", font=ImageFont.load_default(64), fill=ink, anchor="mm")
        else:
            draw.text((512, 330), "07", font=ImageFont.load_default(220), fill=ink, anchor="mm")
        sides.append(np.asarray(image, np.float64) / 255)
    return sides


def trousers_textures(subject, colours):
    """As `shirt_textures`, for trousers: uneven checks, a number on each thigh."""
    from PIL import Image, ImageDraw, ImageFont

    base = np.array(colours["trousers"])
    light, dark = (tuple(int(255 * c) for c in np.clip(base * f + a, 0, 1)) for f, a in ((0.8, 0.22), (0.55, 0.0)))
    sides = []
    for numbers in (("4", "2"), ("9", "1")):  # front, back
        image = Image.new("RGB", (TEXTURE, TEXTURE), tuple(int(255 * c) for c in base))
        draw = ImageDraw.Draw(image)
        for k, at in enumerate(range(12, TEXTURE, 38)):
            draw.rectangle((at, 0, at + 2 + k % 3 * 2, TEXTURE), fill=dark)
            draw.rectangle((0, at, TEXTURE, at + 2 + k % 4 * 2), fill=light)
        for x, number in zip((400, 624), numbers):
            draw.text((x, 380), number, font=ImageFont.load_default(110), fill=light, anchor="mm")
        sides.append(np.asarray(image, np.float64) / 255)
    return sides
