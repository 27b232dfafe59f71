"""Picture sheets: captured, baseline, layered and their errors, whole and close up at a garment's loops."""

from __future__ import annotations

import numpy as np

from ...io.image import write_image
from ...measure.page import heat
from .metrics import border_band, squared_error

ERROR_TOP = 64.0  # root mean square over the channels (0..255) at the upper end of the colours
TILE = 256  # width of a tile [px]
LINE = 18  # height of a line of text [px]
GAP = 4  # between tiles [px]
MARGIN = 0.35  # about a loop, as a share of its size
LEAST = 12  # a loop whose box is smaller is left out [px]
PAPER, INK = 248, (40, 44, 52)


def write_sheets(folder, frames, garments, unseen=None):
    """One PNG a frame: of its pictures the one that shows most of the garments' border. Returns the paths.

    frames: lists of pictures of one frame (`heldout.HeldOutPicture`); garments: label ids; unseen: (frame, views (H,W,3)).
    """
    paths = []
    for pictures in frames:
        picture = max(pictures, key=lambda p: int(border_band(np.where(p.mask, p.labels, 0), garments).sum()))
        paths.append(folder / f"{picture.frame:06d}_{picture.camera}.png")
        image = sheet(picture)
        write_image(paths[-1], image)
    if unseen is not None:
        frame, views = unseen
        paths.append(folder / f"{frame:06d}_unseen.png")
        write_image(paths[-1], strip(views, f"frame {frame} from places where no camera stands"))
    for old in set(folder.glob("*.png")) - set(paths):
        old.unlink()
    return paths


def sheet(picture, names=("baseline", "layered")):
    """(H,W,3) uint8: a row with the whole crop and one for each loop in it; columns captured, avatars, their errors."""
    mask = picture.mask[..., None]
    images = {"captured": picture.captured}
    images |= {name: np.clip(picture.rendered[name], 0, 1) for name in names if name in picture.rendered}
    columns = {name: np.where(mask, (image * 255).round(), PAPER).astype(np.uint8) for name, image in images.items()}
    for name in list(images)[1:]:
        squared = squared_error(images[name], picture.captured)
        title = f"error of {name}: {squared[picture.mask].mean():.0f}" if picture.mask.any() else f"error of {name}"
        columns[title] = np.where(mask, heat(np.sqrt(squared) / ERROR_TOP), PAPER).astype(np.uint8)
    height, width = picture.mask.shape
    rows = [np.concatenate([text_line(title, TILE + GAP) for title in columns], axis=1)]
    rows.append(tiles(columns.values(), (0, 0, width, height), TILE * height // width))
    for name, points in sorted(picture.loops.items()):
        box = loop_box(points, (height, width))
        if box is not None:
            rows += [text_line(name, rows[0].shape[1]), tiles(columns.values(), box, TILE * 3 // 4)]
    legend = f"frame {picture.frame}, {picture.camera}; errors: blue 0, dark red {ERROR_TOP:g} of 255 and more, mean square in the title"
    rows.append(text_line(legend, rows[0].shape[1]))
    return np.concatenate(rows)


def strip(views, words):
    """Pictures (H,W,3) with values 0..1 side by side under a line of text."""
    pictures = [(np.clip(view, 0, 1) * 255).round().astype(np.uint8) for view in views]
    height, width = pictures[0].shape[:2]
    row = tiles(pictures, (0, 0, width, height), TILE * height // width)
    return np.concatenate([text_line(words, row.shape[1]), row])


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


def tiles(images, box, height):
    """One box of several pictures (H,W,3) uint8 side by side, each as large as TILE x `height` allows."""
    from PIL import Image

    left, top, right, bottom = box
    row = np.full((height + GAP, len(images) * (TILE + GAP), 3), PAPER, np.uint8)
    scale = min(TILE / (right - left), height / (bottom - top))
    size = (max(1, round((right - left) * scale)), max(1, round((bottom - top) * scale)))
    for i, image in enumerate(images):
        tile = Image.fromarray(image[top:bottom, left:right]).resize(size, Image.Resampling.BICUBIC)
        row[: size[1], i * (TILE + GAP) :][:, : size[0]] = np.asarray(tile)
    return row


def text_line(words, width):
    from PIL import Image, ImageDraw, ImageFont

    image = Image.new("RGB", (width, LINE), (PAPER,) * 3)
    ImageDraw.Draw(image).text((3, 0), words, fill=INK, font=ImageFont.load_default(13))
    return np.asarray(image)
