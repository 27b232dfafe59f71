"""The HTML that reports share: one self-contained page, cards of figures, plots over the frames."""

from __future__ import annotations

import base64
import html
import io

import numpy as np

HEAT = ((44, 75, 130), (120, 170, 190), (240, 225, 150), (225, 120, 60), (140, 20, 40))  # evenly spaced over 0..1
STYLE = """
:root { color-scheme: light dark; --ink: #1d2430; --soft: #66707f; --page: #f7f6f3; --card: #fff; --line: #e2dfd8; --mark: #b4552d }
@media (prefers-color-scheme: dark) { :root { --ink: #e8e6e1; --soft: #9aa3b0; --page: #16191e; --card: #1e2229; --line: #323842; --mark: #e08a5f } }
body { margin: 0 auto; max-width: 1100px; padding: 2.5rem 1.5rem; background: var(--page); color: var(--ink); font: 15px/1.5 system-ui, sans-serif }
h1 { font-size: 1.7rem; margin: 0 } h2 { font-size: 1.15rem; margin: 2.5rem 0 .8rem } p.soft, .soft { color: var(--soft) }
.cards { display: flex; flex-wrap: wrap; gap: .8rem; margin: 1.2rem 0 } .card { background: var(--card); border: 1px solid var(--line); border-radius: 8px; padding: .7rem 1rem; min-width: 8rem }
.card b { display: block; font-size: 1.35rem; font-variant-numeric: tabular-nums } .card span { color: var(--soft); font-size: .85rem }
.frame { background: var(--card); border: 1px solid var(--line); border-radius: 8px; padding: .8rem 1rem; margin: .8rem 0 }
.frame h3 { margin: 0; font-size: 1rem } .frame .row { display: flex; flex-wrap: wrap; gap: .6rem; margin-top: .5rem } figure { margin: 0 } figcaption { color: var(--soft); font-size: .8rem; text-align: center }
.frame img { width: 200px; height: auto } .scale { display: inline-block; width: 12rem; height: .7rem; border-radius: 3px; vertical-align: baseline; margin: 0 .4rem }
img { border-radius: 4px; display: block } .why { color: var(--mark) } .plots { display: grid; grid-template-columns: repeat(auto-fill, minmax(320px, 1fr)); gap: .8rem }
svg { width: 100%; background: var(--card); border: 1px solid var(--line); border-radius: 8px } svg text { fill: var(--soft); font-size: 11px } polyline { fill: none; stroke: var(--mark); stroke-width: 1.6 }
table { border-collapse: collapse; font-variant-numeric: tabular-nums } th, td { padding: .25rem .9rem .25rem 0; text-align: right; border-bottom: 1px solid var(--line) } th:first-child, td:first-child { text-align: left } th { color: var(--soft); font-weight: 500 }
.sheet { margin: .8rem 0; overflow-x: auto } .sheet img { max-width: 100%; height: auto }
pre { background: var(--card); border: 1px solid var(--line); border-radius: 8px; padding: 1rem; overflow: auto; font-size: 12px }
"""


def document(title, body):
    """A whole page; `title` is text, `body` HTML."""
    return (
        "<!doctype html><html lang='en'><head><meta charset='utf-8'><link rel='icon' href='data:,'>"
        f"<meta name='viewport' content='width=device-width'><title>{html.escape(title)}</title><style>{STYLE}</style></head>"
        f"<body><h1>{html.escape(title)}</h1>{body}</body></html>"
    )


def cards(flat):
    """One card a figure that there is; flat {name: number or None}."""
    shown = (
        f"<div class='card'><b>{short_number(value)}</b><span>{html.escape(name)}</span></div>"
        for name, value in flat.items()
        if value is not None
    )
    return f"<div class='cards'>{''.join(shown)}</div>"


def figure(picture, caption):
    """An RGB picture (H,W,3) uint8 with its caption, as a JPEG within the page."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, "JPEG", quality=82)
    return jpeg_figure(buffer.getvalue(), caption)


def jpeg_figure(jpeg, caption):
    """The same of the bytes of a JPEG."""
    data, text = base64.b64encode(jpeg).decode(), html.escape(caption)
    return f"<figure><img alt='{text}' src='data:image/jpeg;base64,{data}'><figcaption>{text}</figcaption></figure>"


def table(head, rows):
    """A table: `head` and `rows` of texts and numbers; None is a dash."""
    cell = lambda v: "\u2013" if v is None else html.escape(v if isinstance(v, str) else short_number(v))
    line = lambda tag, values: f"<tr>{''.join(f'<{tag}>{cell(v)}</{tag}>' for v in values)}</tr>"
    return f"<table>{line('th', head)}{''.join(line('td', row) for row in rows)}</table>"


def flatten(values, prefix=""):
    """Nested measures as {"garment tshirt surface_mm": number}."""
    flat = {}
    for name, value in values.items():
        if isinstance(value, dict):
            flat |= flatten(value, f"{prefix}{name} ")
        elif value is None or isinstance(value, (int, float)):
            flat[f"{prefix}{name}"] = value
    return flat


def heat(share):
    """Colours (...,3) of values 0..1: blue at 0, dark red from 1 on."""
    at = np.clip(np.asarray(share, dtype=np.float64), 0, 1)
    knots = np.linspace(0, 1, len(HEAT))
    return np.stack([np.interp(at, knots, channel) for channel in np.array(HEAT, dtype=np.float64).T], axis=-1)


def short_number(value):
    """Three significant digits without an exponent; what is too small for them is said to be."""
    if isinstance(value, int):
        return str(value)
    if 0 < abs(value) < 0.001:
        return "under 0.001"
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def plot(name, points):
    """An inline SVG of one measure over the frame numbers."""
    x, y = np.array(points, dtype=np.float64).T
    top = y.max() if y.max() > 0 else 1.0
    px = 44 + 262 * (x - x.min()) / max(np.ptp(x), 1)
    py = 128 - 96 * y / top
    line = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(px, py))
    words = name.replace("_mm", "").replace("_", " ")
    title = words if len(words) <= 50 else f"{words[:20]}\u2026{words[-29:]}"  # 50 letters fill the width
    return (
        f"<svg viewBox='0 0 320 150' role='img' aria-label='{html.escape(name)}'><title>{html.escape(name)}</title>"
        f"<text x='6' y='16'>{html.escape(title)}</text><text x='6' y='28'>{short_number(top)}</text><text x='6' y='131'>0</text>"
        f"<text x='44' y='145'>{x.min():.0f}</text>"
        f"<text x='306' y='145' text-anchor='end'>{x.max():.0f}</text><polyline points='{line}'/></svg>"
    )
