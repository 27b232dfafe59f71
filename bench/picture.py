"""The picture of the trade: time against error on logarithmic axes, a panel a level or kernel, the front drawn."""

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402

OURS, PEER, FRONT = "#c0392b", "#34495e", "#c8c8c8"
COLUMNS, LINE = 4, 11  # panels a row, pixels a line of text
TITLES = {"seq_L1": "a frame, level 1 motion", "seq_L3": "a frame, level 3 motion", "shirt": "T-shirt to scan", "L1": "1 neighbouring frames",
          "L2": "2 small", "L3": "3 medium", "L4": "4 an arm raised", "L5": "5 large, with a start"}  # fmt: skip


def draw(panels, path):
    shown = {name: p for name, p in panels.items() if any(q["seconds"] and q["error"] is not None for q in p["points"])}
    rows = -(-len(shown) // COLUMNS)
    figure, axes = plt.subplots(rows, COLUMNS, figsize=(3.6 * COLUMNS, 3.0 * rows), dpi=90, squeeze=False)
    for ax in axes.flat[len(shown) :]:
        ax.set_visible(False)
    for ax, (name, panel) in zip(axes.flat, shown.items()):
        draw_panel(ax, TITLES.get(name, name), panel)
    figure.tight_layout()
    figure.savefig(path, dpi=figure.dpi)
    plt.close(figure)


def draw_panel(ax, title, panel):
    points = [p for p in panel["points"] if p["seconds"] and p["error"] is not None]
    ax.set(xscale="log", yscale="log", title=title, xlabel="seconds, two threads", ylabel=panel["error"])
    ax.grid(True, which="major", color="#eeeeee", zorder=0)
    front = sorted((p["seconds"], p["error"]) for p in points if p["on_front"])
    if front:
        ax.step(*zip(*front), where="post", color=FRONT, lw=5, zorder=1, solid_capstyle="round")
    for p in points:
        if p["oracle"]:
            ax.axhline(p["error"], color=OURS, ls=":", lw=1)
            continue
        ax.plot(p["seconds"], p["error"], marker="o" if p["ours"] else "s", color=OURS if p["ours"] else PEER,
                mfc="none" if p["failed"] else None, ms=6, zorder=3)  # fmt: skip
    ax.margins(0.15)
    label(ax, [p for p in points if not p["oracle"]])


def label(ax, points):
    """Names beside their points, to the side where the panel has room, moved apart where they would overlap."""
    low, high = np.log(ax.get_xlim())
    for right in (False, True):
        side = [p for p in points if (np.log(p["seconds"]) > 0.35 * low + 0.65 * high) == right]
        free = np.inf  # height above which text would overlap [pixel]
        for p in sorted(side, key=lambda p: -p["error"]):
            y = ax.transData.transform((p["seconds"], p["error"]))[1]
            shift = min(0.0, free - LINE - y)
            free = y + shift
            ax.annotate(p["method"].removeprefix("toile "), (p["seconds"], p["error"]), fontsize=7, textcoords="offset pixels",
                        xytext=(-6 if right else 6, shift), ha="right" if right else "left", va="center",
                        color=OURS if p["ours"] else PEER, zorder=4)  # fmt: skip
