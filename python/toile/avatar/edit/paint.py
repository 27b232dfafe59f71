"""What an edit puts on a garment: maps over its UV square, and pictures laid onto its cloth upright, as a printer would.

A laid picture is projected along the cloth's normal at its middle onto the rest pose, so neither the charts' turns nor
their seams show in it. U,V and sizes are those of the UV square, v up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ... import kernels
from ...errors import UserError
from ...surface.uv import UvMap
from ..model.edits import Edit

FINE = 512  # texels along a side of a painted map, at least
TONES = (235, 30)  # of a checkerboard
INKS = (20, 240)  # of text on bright cloth and on dark
WIDTH = 0.2  # of a laid picture, a share of the UV square's side
CHEST = 0.65  # of a garment's height, where a picture is laid that is told no place
AIM = 5  # steps to the cloth in front of a point
FACING = 0.2  # cosine to the picture's normal, beyond which the cloth turns away from it
FONT = 96  # height of the letters as they are drawn [px]
LETTERS = 200


@dataclass(frozen=True)
class Place:
    """Where a picture lies on a garment in its rest pose [m]: right, up and normal are unit vectors."""

    centre: np.ndarray
    right: np.ndarray
    up: np.ndarray
    normal: np.ndarray
    width: float


def whole(size):
    """A cover (S,S) of everything."""
    return np.full((size, size), 255, np.uint8)


def scaled(layer, scale, size):
    """An Edit that multiplies the texture's red, green and blue."""
    words = f"scale {','.join(f'{s:g}' for s in scale)}"
    return Edit(layer.name, layer.name, words, whole(size), scale=np.array(scale, np.float64))


def checkered(layer, count, size):
    """An Edit of `count` squares along a side of the UV square."""
    if not 1 <= count <= size // 2:
        raise UserError(f"--checker {count}: expected 1 to {size // 2} squares")
    square = ((np.arange(size) + 0.5) * count / size).astype(np.int64)
    colour = np.where((square[:, None] + square) % 2 == 0, *TONES)
    colour = np.repeat(colour[..., None], 3, 2).astype(np.uint8)
    return Edit(layer.name, layer.name, f"checker {count}", whole(size), colour=colour)


def covering(layer, picture, name, size):
    """An Edit by a picture (h,w,4) over the whole UV square."""
    maps = shrunk(picture, size, size)
    return Edit(layer.name, layer.name, f"image {name}", maps[..., 3], colour=maps[..., :3])


def placed(layer, picture, words, place, size):
    """An Edit by a picture (h,w,4) that lies at a Place."""
    import cv2

    height, width = picture.shape[:2]
    texels, tall = UvMap(layer, size), place.width * height / width
    across = max(round(place.width / metres_per_uv(layer) * size), 1)  # texels
    if across < width:
        picture = shrunk(picture, max(round(across * height / width), 1), across)
    offset = texels.texels(layer.rest) - place.centre
    x, y = offset @ place.right / place.width + 0.5, 0.5 - offset @ place.up / tall
    normals = texels.texels(kernels.vertex_normals(layer.rest, layer.faces))
    near = np.abs(offset @ place.normal) < place.width
    shows = texels.valid & near & (normals @ place.normal > FACING) & (x >= 0) & (x <= 1) & (y >= 0) & (y <= 1)
    at = x * picture.shape[1] - 0.5, y * picture.shape[0] - 0.5
    maps = cv2.remap(picture, *(a.astype(np.float32) for a in at), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    cover = np.where(shows, maps[..., 3], 0).astype(np.uint8)
    if not cover.any():
        raise UserError(f"edit {words}: no texel of {layer.name} shows it: make it larger by --size")
    return Edit(layer.name, layer.name, words, cover, colour=maps[..., :3])


def place_at(layer, at, width, up):
    """The Place of a picture about the cloth at UV `at`, `width` of the UV square wide; `up` (3,) is the scene's."""
    texels = UvMap(layer, FINE)
    row, column = (min(int(share * FINE), FINE - 1) for share in (1 - at[1], at[0]))
    if not texels.inside[row, column]:
        inside = np.argwhere(texels.inside)
        r, c = inside[np.square(inside - [row, column]).sum(1).argmin()]
        nearest = f"{(c + 0.5) / FINE:.3f},{1 - (r + 0.5) / FINE:.3f}"
        raise UserError(f"--at {at[0]:g},{at[1]:g}: {layer.name} has no cloth there, the nearest is at {nearest}")
    return place_about(layer, texels.texels(layer.rest)[row, column], width, up)


def place_in_front(layer, front, width, up):
    """The Place on a garment's front, at the height of a chest; `front` (3,) is where the person looks in the rest pose."""
    axes = np.stack([up, front, np.cross(up, front)])
    low, high = (layer.rest @ axes.T).min(0), (layer.rest @ axes.T).max(0)
    at = np.array([low[0] + CHEST * (high[0] - low[0]), high[1], (low[2] + high[2]) / 2])
    index = kernels.SurfaceIndex(layer.rest, layer.faces)
    for _ in range(AIM):  # towards the cloth, each time from as far in front as it was found
        _, point, _, _ = index.closest((at @ axes)[None])
        at[1] = point[0] @ front
    return place_about(layer, point[0], width, up)


def place_about(layer, centre, width, up):
    """The Place about a point of the cloth; it faces as the cloth under it does on average."""
    metres = width * metres_per_uv(layer)
    normals = kernels.vertex_normals(layer.rest, layer.faces)
    distance = np.linalg.norm(layer.rest - centre, axis=1)
    here = normals[distance.argmin()]
    normal = normals[(distance <= max(metres / 2, distance.min())) & (normals @ here > 0)].sum(0)
    normal /= np.linalg.norm(normal)
    right = np.cross(up, normal)
    if np.linalg.norm(right) < 0.1:  # flat on a shoulder: no side of it is the upper one
        right = np.cross(np.eye(3)[np.abs(normal).argmin()], normal)
    right /= np.linalg.norm(right)
    return Place(centre, right, np.cross(normal, right), normal, metres)


def metres_per_uv(layer):
    """Length on the cloth of the UV square's side [m], the mean over the garment."""
    a, b, c = (layer.uv[layer.face_uv[:, k]].astype(np.float64) for k in range(3))
    flat = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).sum() / 2
    return float(np.sqrt(kernels.face_areas(layer.rest, layer.faces).sum() / max(flat, 1e-12)))


def front_of(J, roles, up):
    """Where the person looks in the rest pose (3,), from joints (K,3) of roles on the left and on the right."""
    left, right = ([k for k, name in enumerate(roles) if name.endswith(end)] for end in (".L", ".R"))
    if not (left and right):
        raise UserError(
            "edit: the body model's joints do not say where the front is (left_..., right_...): give --at U,V"
        )
    across = np.mean(J[left], 0) - np.mean(J[right], 0)
    across -= (across @ up) * up
    return np.cross(across / np.linalg.norm(across), up)


def written(text, bright):
    """A picture (h,w,4) of a text, dark for bright cloth, in the font that Pillow carries."""
    from PIL import Image, ImageDraw, ImageFont

    font = ImageFont.load_default(FONT)
    unknown = [c for c in text if c != "\n" and (not c.isprintable() or _same(font, c, "\uffff"))]
    if unknown:
        raise UserError(f"--text: the font has no letter {unknown[0]!r}")
    if not text.strip() or len(text) > LETTERS:
        raise UserError(f"--text: {len(text)} letters, expected 1 to {LETTERS} that show something")
    left, top, right, bottom = ImageDraw.Draw(Image.new("L", (1, 1))).multiline_textbbox(
        (0, 0), text, font, align="center"
    )
    cover = Image.new("L", (int(right - left) + 2, int(bottom - top) + 2))
    ImageDraw.Draw(cover).multiline_text((1 - left, 1 - top), text, 255, font, align="center")
    picture = np.full((cover.height, cover.width, 4), INKS[0] if bright else INKS[1], np.uint8)
    picture[..., 3] = np.asarray(cover)
    return picture


def _same(font, letter, other):
    a, b = font.getmask(letter), font.getmask(other)
    return a.size == b.size and bytes(a) == bytes(b)


def shrunk(picture, height, width):
    """A picture (h,w,4) at another size; what is transparent lends no colour."""
    from PIL import Image

    return np.array(Image.fromarray(picture).resize((width, height), Image.Resampling.BILINEAR))
