"""One self-contained page of a study's tables and pictures, its JSON, and its tables as Markdown."""

from __future__ import annotations

import html
from pathlib import Path

import numpy as np

from toile.io.files import write_text
from toile.io.locks import locked
from toile.measure.page import document, figure
from toile.measure.page import table as html_table

from .cells import text
from .results import write_json
from .tables import collected, tables

SHEETS = {"driven": "driven by pose and face alone", "sheets": "reconstructed"}


def write(out):
    """OUT/index.html, OUT/paper.json and OUT/tables.md of what is there; returns the page's path."""
    with locked(Path(out)):  # other processes may work on other subjects
        return _write(Path(out))


def _write(out):
    found = collected(out)
    made = tables(found)
    write_json(out / "paper.json", {"subjects": found, "tables": [vars(table) for table in made]})
    write_text(out / "tables.md", "\n".join(table.markdown() for table in made))
    body = "".join(_section(table) for table in made) + "".join(_pictures(out / name) for name in found)
    write_text(out / "index.html", document("The paper's comparisons", body))
    return out / "index.html"


def _section(table):
    rows = [[None if value is None else text(value) for value in row] for row in table.rows]
    note = f"<p class='soft'>{html.escape(table.note)}</p>" if table.note else ""
    return f"<h2>{html.escape(table.title)}</h2><div class='sheet'>{html_table(table.head, rows)}</div>{note}"


def _pictures(folder):
    """The sheets of a subject's first seed, and the close-ups of its ablations."""
    parts = []
    for seed in sorted(folder.glob("seed*"))[:1]:
        for kind, words in SHEETS.items():
            parts += _sheets(seed / kind, f"{folder.name}, {words}")
    parts += _sheets(folder / "ablations" / "zooms", f"{folder.name}: ablations, driven")
    return "".join(parts)


def _sheets(folder, title):
    from PIL import Image

    paths = sorted(folder.glob("*.png"))
    if paths:
        yield f"<h2>{html.escape(title)}</h2>"
    for path in paths:
        yield f"<div class='sheet'>{figure(np.asarray(Image.open(path).convert('RGB')), path.stem.replace('_', ' '))}</div>"
