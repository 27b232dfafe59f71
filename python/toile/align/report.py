"""What an alignment did to the unwrapped textures, and to the cloth: alignment.json, pictures and a page in the aligned run's folder."""

from __future__ import annotations

import html
import json

import numpy as np

from .. import kernels
from ..frame_numbers import evenly
from ..io.bounded import read_json
from ..io.files import write_text
from ..io.image import write_image
from ..measure.page import cards, document, figure, heat, table
from ..pipeline.blocks import blocks
from ..prints.colours import logarithms
from ..prints.views import PrintViews
from ..surface.layers import read_layers
from ..surface.uv import UvMap
from ..vision.unwrapping import mean_texture
from .surfaces import layers_at, pictures

SIZE = 512  # texels
FRAMES = 24  # read, spread evenly over the aligned ones
SHOWN = 4  # of them in the pictures
HOT = 60.0  # deviation or error at the upper end of the colours (0..255)
LONG = 3.0  # times as long as it was registered, or as edges are on average: an edge that is drawn out
TORN = 1e-3  # share of a garment's edges, beyond which it is torn: its vertices lie on several parts of the cloth
SIDES = ("before", "after")


def write_report(run, aligned, frames, progress):
    """Compares the textures of `frames` of a Run and of the one aligned from it, which have pictures in both; writes
    pages and pictures into the latter's folder. Returns {garment: measures}."""
    out = aligned.path
    frames = evenly(frames, FRAMES)
    anchors = [n in blocks(frames)[0] for n in frames]
    textures = {}
    layers = {layer.name: layer for layer in read_layers(run, frames[:1])}
    for side, source in zip(SIDES, (run, aligned)):
        maps = {name: UvMap(layer, SIZE) for name, layer in layers.items() if layer.kind == "garment"}
        unwrapped = PrintViews(list(layers.values()), maps, source.capture.cameras)
        for k, number in enumerate(frames):
            seen = unwrapped.of(pictures(source, number), *layers_at(source, layers.values(), number))
            for name, views in seen.items():
                colours, weights = mean_texture(views, SIZE).maps(SIZE)
                textures.setdefault(name, {}).setdefault(side, []).append((colours, (weights > 0) & maps[name].inside))
            progress("report", SIDES.index(side) * len(frames) + k + 1, 2 * len(frames))
    measures, parts = {}, []
    for name, sides in textures.items():
        compared = {side: _Textures(sides[side], anchors) for side in SIDES}
        both = compared["before"].often & compared["after"].often
        measures[name] = {side: compared[side].measures(both) for side in SIDES} | {
            "frames": len(frames),
            "texels": int(both.sum()),
            "drawn_out": drawn_out(run.garments[name], aligned.garments[name], frames),
        }
        parts.append(_section(name, measures[name], compared, frames, out))
    write_text(out / "alignment.html", document(f"{out.name}: textures before and after alignment", "".join(parts)))
    write_text(out / "alignment.json", json.dumps(measures, indent=1))
    return measures


def drawn_out(registered, aligned, frames):
    """Share of a garment's edges that sliding has made LONG times as long, the mean over frames."""
    i, j = kernels.unique_edges(registered.faces).T
    long = []
    for number in frames:
        before, after = (np.linalg.norm(V[i] - V[j], axis=1) for V in (registered.at(number), aligned.at(number)))
        long.append(float((after > LONG * np.maximum(before, before.mean())).mean()))
    return float(np.mean(long))


def torn(out):
    """What a user should know of the garments of an aligned run's folder."""
    path = out / "alignment.json"
    shares = {name: of.get("drawn_out", 0.0) for name, of in read_json(path, dict).items()} if path.exists() else {}
    return tuple(
        f"{name} is torn: sliding has made {100 * share:.1f} % of its edges {LONG:g} times as long (at most {100 * TORN:g} % is usual)"
        for name, share in shares.items()
        if share > TORN
    )


class _Textures:
    """One garment's textures over frames [(colours (T,T,3) uint8, seen (T,T))]; anchors: which frames are in the first block."""

    def __init__(self, textures, anchors):
        self.colours, self.seen = (np.stack(x) for x in zip(*textures))
        self.anchors = np.array(anchors)
        self.often = self.seen.mean(0) >= 0.5
        self.mean, self.deviation = _moments(self.colours.astype(np.float32), self.seen)
        first = self.seen & self.anchors[:, None, None]
        self.anchor, _ = _moments(self.colours.astype(np.float32), first)
        self.anchored = first.any(0)

    def error(self, k):
        """Mean absolute difference (T,T) of frame k to the anchors' mean, NaN where one of them saw nothing."""
        apart = np.abs(self.colours[k] - self.anchor).mean(-1)
        return np.where(self.seen[k] & self.anchored, apart, np.nan)

    def measures(self, texels):
        """texture_std: standard deviation over frames, 0..255, mean over texels; chroma_std: of two differences of
        logarithms of colours, which light hardly changes; anchor_error: to the anchors' mean, over the other frames, or over the
        anchors where there are no others. None where no texel is seen often enough."""
        logs = logarithms(self.colours.astype(np.float32))
        chroma = np.stack([logs[..., 0] - logs[..., 1], logs[..., 2] - logs[..., :2].mean(-1)], -1)
        others = np.flatnonzero(~self.anchors) if not self.anchors.all() else np.arange(len(self.anchors))
        errors = [np.nanmean(e) for e in (self.error(k)[texels] for k in others) if np.isfinite(e).any()]
        spread = lambda deviation: float(np.sqrt((deviation[texels] ** 2).mean(-1)).mean()) if texels.any() else None
        return {
            "texture_std": spread(self.deviation),
            "chroma_std": spread(_moments(chroma, self.seen)[1]),
            "anchor_error": float(np.mean(errors)) if errors else None,
        }


def _moments(values, seen):
    """Mean and standard deviation (T,T,C) over the frames (F,T,T,C) that saw a texel; 0 where none did."""
    count = np.maximum(seen.sum(0), 1)[..., None]
    mean = (values * seen[..., None]).sum(0) / count
    return mean, np.sqrt((((values - mean) * seen[..., None]) ** 2).sum(0) / count)


def _section(name, measures, compared, frames, out):
    """HTML of a garment; its pictures also as PNG beside it."""
    pictures = {}
    for side, textures in compared.items():
        pictures[f"mean {side}"] = textures.mean.astype(np.uint8) * textures.seen.any(0)[..., None]
        spread = heat(np.sqrt((textures.deviation**2).mean(-1)) / HOT)
        pictures[f"deviation {side}"] = np.where(textures.often[..., None], spread, 0).astype(np.uint8)
    for label, picture in pictures.items():
        write_image(out / "alignment" / f"{name} {label}.png".replace(" ", "_"), picture)
    chosen = evenly(range(len(frames)), SHOWN)
    sheets = {k: _sheet(compared, k) for k in chosen}
    strips = [np.concatenate([picture[::2, ::2] for picture in sheet.values()], 1) for sheet in sheets.values()]
    write_image(out / "alignment" / f"{name}_frames.png", np.concatenate(strips))
    rows = "".join(_row(frames[k], sheet) for k, sheet in sheets.items())
    change = {key: [measures[side][key] for side in SIDES] for key in measures["before"]}
    lines = [
        (key, a, b, f"{100 * (b / a - 1):+.0f} %" if a and b is not None else None) for key, (a, b) in change.items()
    ]
    figures = "".join(figure(p, label) for label, p in pictures.items())
    facts = {"frames": measures["frames"], "texels": measures["texels"]}
    facts |= {"% of edges drawn out": 100 * measures["drawn_out"]}
    return (
        f"<h2>{html.escape(name)}</h2>{cards(facts)}"
        f"{table(('', 'before', 'after', 'change'), lines)}<section class='frame'><div class='row'>{figures}</div></section>"
        f"<h2>Frames, and their errors to the anchors' mean</h2>{rows}"
    )


def _sheet(compared, k):
    """{title: picture} of a frame: its texture, and that one's error to the anchors' mean, before and after."""
    pictures = {}
    for side, textures in compared.items():
        error = textures.error(k)
        coloured = np.where(np.isfinite(error)[..., None], heat(np.nan_to_num(error) / HOT), 0)
        pictures[side] = textures.colours[k] * textures.seen[k][..., None]
        pictures[f"error {side}"] = coloured.astype(np.uint8)
    return pictures


def _row(number, sheet):
    figures = "".join(figure(picture, title) for title, picture in sheet.items())
    return f"<section class='frame'><h3>frame {number}</h3><div class='row'>{figures}</div></section>"
