"""Picture sheets: captured, baseline, layered and their errors, whole and close up at a garment's loops."""

from __future__ import annotations

import numpy as np

from ..page import heat
from ..store import replace_file
from .metrics import border_band, squared_error

ERROR_TOP = 64.0  # root mean square over the channels (0..255) at the upper end of the colours
TILE = 256  # width of a tile [px]
LINE = 18  # height of a line of text [px]
GAP = 4  # between tiles [px]
MARGIN = 0.35  # about a loop, as a share of its size
LEAST = 12  # a loop whose box is smaller is left out [px]
PAPER, INK = 248, (40, 44, 52)


def write_sheets(folder, frames, garments):
    """One PNG a frame: of its pictures the one that shows most of the garments' border. Returns the paths.

    frames: lists of pictures of one frame (`evaluation.Picture`); garments: label ids.
    """
    paths = []
    for pictures in frames:
        picture = max(pictures, key=lambda p: int(border_band(np.where(p.mask, p.labels, 0), garments).sum()))
        paths.append(folder / f"{picture.frame:06d}_{picture.camera}.png")
        image = sheet(picture)
        replace_file(paths[-1], lambda part: _save(part, image))
    for old in set(folder.glob("*.png")) - set(paths):
        old.unlink()
    return paths


def _save(path, image):
    from PIL import Image

    Image.fromarray(image).save(path, "PNG")


def sheet(picture):
    """(H,W,3) uint8: a row with the whole window and one for each loop in it; columns captured, avatars, their errors."""
    mask = picture.mask[..., None]
    images = {"captured": picture.captured}
    images |= {name: np.clip(picture.rendered[name], 0, 1) for name in ("baseline", "layered") if name in picture.rendered}
    columns = {name: np.where(mask, (image * 255).round(), PAPER).astype(np.uint8) for name, image in images.items()}
    for name in list(images)[1:]:
        squared = squared_error(images[name], picture.captured)
        title = f"error of {name}: {squared[picture.mask].mean():.0f}" if picture.mask.any() else f"error of {name}"
        columns[title] = np.where(mask, heat(np.sqrt(squared) / ERROR_TOP), PAPER).astype(np.uint8)
    height, width = picture.mask.shape
    whole = (0, 0, width, height)
    rows = [_row(columns, whole, title=True)]
    for name, points in sorted(picture.loops.items()):
        box = loop_box(points, (height, width))
        if box is not None:
            rows.append(_row(columns, box, name))
    legend = f"frame {picture.frame}, {picture.camera}; errors: blue 0, dark red {ERROR_TOP:g} of 255 and more, mean square in the title"
    rows.append(_text(legend, rows[0].shape[1]))
    return np.concatenate(rows)


def loop_box(points, size):
    """(left, top, right, bottom) [px] of 4:3 about a loop's pixels (k,2) within a picture (height, width); None where
    less than half of them are in it or they are too close together."""
    height, width = size
    points = points[np.isfinite(points).all(1)]
    inside = (points >= 0).all(1) & (points < [width, height]).all(1)
    if not len(points) or inside.mean() < 0.5:
        return None
    low, high = points[inside].min(0), points[inside].max(0)
    if max(high - low) < LEAST:
        return None
    half_w = max((high[0] - low[0]) / 2, (high[1] - low[1]) / 2 * 4 / 3) * (1 + MARGIN)
    half_w = max(half_w, 2.0 * LEAST)
    centre = (low + high) / 2
    left, right = centre[0] - half_w, centre[0] + half_w
    top, bottom = centre[1] - half_w * 3 / 4, centre[1] + half_w * 3 / 4
    box = (max(0, left), max(0, top), min(width, right), min(height, bottom))
    return tuple(int(round(v)) for v in box)


def _row(columns, box, name="", title=False):
    """Tiles of one box side by side, under their titles or over the row's name."""
    from PIL import Image

    left, top, right, bottom = box
    height = TILE * (bottom - top) // (right - left) if title else TILE * 3 // 4
    tiles = []
    for caption, image in columns.items():
        tile = Image.fromarray(image[top:bottom, left:right])
        scale = min(TILE / tile.width, height / tile.height)
        tile = tile.resize((max(1, round(tile.width * scale)), max(1, round(tile.height * scale))), Image.Resampling.BICUBIC)
        canvas = np.full((height, TILE + GAP, 3), PAPER, np.uint8)
        canvas[: tile.height, : tile.width] = np.asarray(tile)
        tiles.append(np.concatenate([_text(caption, TILE + GAP), canvas]) if title else canvas)
    row = np.concatenate(tiles, axis=1)
    return row if title else np.concatenate([_text(name, row.shape[1]), row])


def _text(words, width):
    from PIL import Image, ImageDraw, ImageFont

    image = Image.new("RGB", (width, LINE + GAP), (PAPER,) * 3)
    ImageDraw.Draw(image).text((3, GAP), words, fill=INK, font=ImageFont.load_default(13))
    return np.asarray(image)
