"""The picture of the trade: time against error on logarithmic axes, a panel a level or kernel, the front drawn."""

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import NullFormatter
from PIL import Image

OURS, PEER, FRONT = "#c0392b", "#34495e", "#d5d5d5"
COLUMNS, LINE = 4, 11  # panels a row, pixels a line of text
TITLES = {  # the panels shown, in order
    "L1": "level 1: neighbouring frames", "L2": "level 2: small", "L3": "level 3: medium",
    "L4": "level 4: an arm raised", "L5": "level 5: large, with a start",
    "14k template, 100k target": "14k template, 100k target",
    "53k template, 100k target": "53k template, 100k target", "shirt": "T-shirt to scan",
    "seq_L1": "a frame of level 1 motion", "seq_L3": "a frame of level 3 motion",
    "biharmonic 12k": "biharmonic, 12k vertices", "biharmonic 50k": "biharmonic, 50k vertices",
    "mrf 13k": "mrf, 13k nodes, 5 labels", "mrf 99k": "mrf, 99k nodes, 5 labels",
    "untangle 5k": "untangle, 5k cloth vertices", "untangle push1cm": "untangle, shirt pushed in by 1 cm",
}  # fmt: skip
SMALLEST_SPAN = 30  # an axis shows at least this ratio


def draw(panels, path):
    """Writes the picture of the panels (see `summary.summarise`) that TITLES names; of all where it names none."""
    known = [name for name in TITLES if name in panels]
    shown = [name for name in known or panels if drawable(panels[name])]
    rows = -(-len(shown) // COLUMNS) or 1
    figure, axes = plt.subplots(rows, COLUMNS, figsize=(3.6 * COLUMNS, 2.9 * rows), dpi=90, squeeze=False)
    for ax in axes.flat[len(shown) :]:
        ax.set_visible(False)
    for ax, name in zip(axes.flat, shown):
        draw_panel(ax, TITLES.get(name, name), panels[name])
    figure.tight_layout()
    for ax, name in zip(axes.flat, shown):
        label(ax, [p for p in drawable(panels[name]) if not p["oracle"]])
    figure.canvas.draw()
    Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[..., :3]).quantize(32).save(path, optimize=True)
    plt.close(figure)


def drawable(panel):
    return [p for p in panel["points"] if p["seconds"] and p["error"] is not None]


def draw_panel(ax, title, panel):
    points = drawable(panel)
    ax.set(xscale="log", yscale="log", xlabel="seconds, two threads", ylabel=panel["error"])
    ax.set_title(title, fontsize=10)
    ax.grid(True, color="#eeeeee", zorder=0)
    ax.set_xlim(span([p["seconds"] for p in points], 3))
    ax.set_ylim(span([p["error"] for p in points], 2))
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_minor_formatter(NullFormatter())
    ax.xaxis.set_major_formatter("{x:g}")
    if "[mm]" in panel["error"]:
        ax.yaxis.set_major_formatter("{x:g}")
    front = sorted((p["seconds"], p["error"]) for p in points if p["on_front"])
    if front:
        front.append((ax.get_xlim()[1], front[-1][1]))
        ax.step(*zip(*front), where="post", color=FRONT, lw=4, zorder=1)
    for p in points:
        colour = OURS if p["ours"] else PEER
        if p["oracle"]:
            ax.axhline(p["error"], color=colour, ls=":", lw=1)
        else:
            marker, fill = "o" if p["ours"] else "s", "none" if p["failed"] else None
            ax.plot(p["seconds"], p["error"], marker=marker, color=colour, mfc=fill, ms=6, zorder=3)
    lost = [p["method"] for p in panel["points"] if p["seconds"] is None]
    if lost:
        ax.text(0.02, 0.03, "failed: " + ", ".join(lost), transform=ax.transAxes, fontsize=7, color=PEER)


def span(values, margin):
    """Limits of a logarithmic axis with room about the values."""
    low, high = min(values) / margin, max(values) * margin
    widen = max(1.0, np.sqrt(SMALLEST_SPAN / (high / low)))
    return low / widen, high * widen


def label(ax, points):
    """Names beside their points, to the side where the panel has room, moved apart where they would overlap."""
    low, high = np.log(ax.get_xlim())
    for left in (False, True):
        side = [p for p in points if (np.log(p["seconds"]) > 0.4 * low + 0.6 * high) == left]
        free = np.inf  # the text above is at this height [pixel]
        for p in sorted(side, key=lambda p: -p["error"]):
            y = ax.transData.transform((p["seconds"], p["error"]))[1]
            free = min(y, free - LINE)
            style = dict(fontsize=7, va="center", ha="right" if left else "left", color=OURS if p["ours"] else PEER)
            ax.annotate(p["method"].removeprefix("toile "), (p["seconds"], p["error"]), textcoords="offset pixels",
                        xytext=(-6 if left else 6, free - y), zorder=4, **style)  # fmt: skip
