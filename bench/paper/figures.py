"""The paper's figures of one subject, drawn from its trained avatar: cloth out of the body, edits, an edit of one surface."""

from __future__ import annotations

import shutil

import numpy as np

from toile.avatar.edit.editing import Change, edit
from toile.avatar.measure.driven import Driven
from toile.avatar.measure.sheet import GAP, PAPER, TILE, text_line, tiles
from toile.avatar.model.checkpoint import load_avatar, read_facts
from toile.frame_numbers import evenly
from toile.io.image import write_image

SHOWN = 3  # held-out frames of a figure
SEARCHED = 8  # held-out frames of which the one is shown whose cloth goes most visibly through what lies under it
DIFFERS = 0.15  # of a channel (0..1), by which a pixel shows that cloth was moved
NEAR = 0.18  # side of a close-up, a share of the picture's
STRIPES = 12  # of the drawn pattern, along the UV square
BLUE = "0.5,0.7,1.8"  # factors of the colours, for the edit that both avatars get


class Layers(Driven):
    """Of a driven avatar the layers alone."""

    def shown_in(self, i):
        return {"layered": self.shown["layered"]}


class AsDecoded(Layers):
    """Garments as the networks place them, through one another and the body."""

    def cleared(self, frame, decoded, pose):
        return decoded, 0, 0


def draw(folder, out):
    """OUT/{collision,edits,single}.png of AVATAR `folder`; what they show. Of several garments the outermost is edited."""
    garment = next(layer.name for layer in load_avatar(folder).layers[::-1] if layer.kind == "garment")
    found = {"garment": garment, "collision": collision(folder, out / "collision.png")}
    return found | {"edits": edits(folder, garment, out)}


def collision(folder, path):
    """The driven view in which cloth that goes through the body or other cloth shows most, and the same moved out; whole and close up."""
    frames = evenly(read_facts(folder)["holdout"], SEARCHED)
    through, moved = (kind(folder, frames, physics=False) for kind in (AsDecoded, Layers))
    most, best = -1, None
    for i in range(moved.count):
        pair = through.picture(i), moved.picture(i)
        differs = np.abs(pair[0].rendered["layered"] - pair[1].rendered["layered"]).max(-1) > DIFFERS
        if differs.sum() > most:
            most, best = int(differs.sum()), (pair, differs)
    (as_decoded, out), differs = best
    pictures = {"captured": _on_paper(out, out.captured), "as decoded": _drawn(as_decoded), "moved out": _drawn(out)}
    height, width = differs.shape
    rows = [_titles(pictures), tiles(pictures.values(), (0, 0, width, height), TILE * height // width)]
    if most:
        rows.append(tiles(pictures.values(), _about(differs), TILE))
    write_image(path, np.concatenate(rows))
    before, left = moved.intersections[out.frame]
    return {"frame": out.frame, "camera": out.camera, "pixels": most, "pairs": int(before), "left": int(left)}


def _about(differs):
    """Box (left, top, right, bottom) of a close-up where most pixels (H,W) differ."""
    height, width = differs.shape
    half = min(max(int(NEAR * width / 2), 8), height // 2, width // 2)
    sums = np.pad(differs.astype(np.int64).cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    side = 2 * half
    inside = sums[side:, side:] - sums[:-side, side:] - sums[side:, :-side] + sums[:-side, :-side]
    top, left = np.unravel_index(int(inside.argmax()), inside.shape)
    return int(left), int(top), int(left) + side, int(top) + side


def edits(folder, garment, out):
    """OUT/edits.png: driven frames as captured, unedited and by four edits; OUT/single.png: one edit by both avatars, encoded."""
    pattern, made = out / "pattern.png", out / "edited"
    write_image(pattern, stripes())
    changes = {
        "colour": Change(garment, scale=BLUE), "checkerboard": Change(garment, checker=16),
        "pattern": Change(garment, image=pattern), "text": Change(garment, text="TOILE", size=0.3),
    }  # fmt: skip
    facts = read_facts(folder)
    frames, marked = (
        evenly(facts["holdout"], SHOWN),
        facts["frames"][0],
    )  # the single layer is marked in its first frame
    shown = Layers(folder, frames, physics=None)
    views = [_widest(shown, frame) for frame in frames]
    plain = [shown.picture(i) for i in views]
    columns = {"captured": [_on_paper(one, one.captured) for one in plain], "driven": [_drawn(one) for one in plain]}
    for name, change in changes.items():
        shutil.rmtree(made, ignore_errors=True)
        both = edit(folder, made, change, [marked, *frames], sheet=name == "colour")
        if both.measured:
            borders = {avatar: both.measured[avatar] for avatar in ("layered", "baseline")}
            (made / "edit.png").replace(out / "single.png")
        shutil.rmtree(made / "baseline", ignore_errors=True)  # it is not shown
        changed = Layers(made, frames, physics=None)
        columns[name] = [_drawn(changed.picture(i)) for i in views]
    shutil.rmtree(made)
    pattern.unlink()
    rows = [_titles(columns)]
    for pictures in zip(*columns.values(), strict=True):
        height, width = pictures[0].shape[:2]
        rows.append(tiles(pictures, (0, 0, width, height), TILE * height // width))
    write_image(out / "edits.png", np.concatenate(rows))
    return {"frames": frames, "cameras": [one.camera for one in plain], "colours": BLUE, "borders": borders}


def stripes(size=512):
    """A picture (S,S,3) uint8 of slanted waves, each of its own colour: the pattern of an artist's stead."""
    v, u = np.mgrid[:size, :size] / size
    band = (u + 0.5 * v + 0.04 * np.sin(8 * np.pi * v)) * STRIPES
    hue = np.floor(band)[..., None] * np.array([1.9, 2.7, 4.1]) + np.array([0.0, 2.0, 4.0])
    edge = (np.abs(band % 1 - 0.5) < 0.42)[..., None]
    return np.where(edge, 140 + 100 * np.sin(hue), 30).astype(np.uint8)


def _widest(held, frame):
    """The picture of a frame, by number, that shows most of the garments."""
    labels, data = list(held.garment_labels.values()), held.data["layered"]
    return max(map(int, data.rows_of(frame)), key=lambda i: int(np.isin(data[i]["labels"].numpy(), labels).sum()))


def _drawn(picture):
    return _on_paper(picture, picture.rendered["layered"])


def _on_paper(picture, image):
    """The person in an image (H,W,3) of values 0..1, as uint8."""
    pixels = (np.clip(image, 0, 1) * 255).round()
    return np.where(picture.mask[..., None], pixels, PAPER).astype(np.uint8)


def _titles(columns):
    return np.concatenate([text_line(title, TILE + GAP) for title in columns], axis=1)
