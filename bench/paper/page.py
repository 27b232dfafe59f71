"""One self-contained page of a study's tables and pictures beside the paper's, its JSON, and its tables as Markdown."""

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
from .sections import SECTIONS, tables
from .tables import collected

TITLE = "The paper's figures and tables, and ours"
INTRODUCTION = (
    "Xiang et al., Modeling Clothing as a Separate Layer for an Animatable Human Avatar, ACM Transactions on Graphics 2021. Each section "
    "names what stands in the paper, says what it shows there, and has the same of the avatars that were trained here. Figures 2 to 6 "
    "are diagrams of the method."
)


def write(out):
    """OUT/index.html, OUT/paper.json and OUT/tables.md of what is there; returns the page's path."""
    with locked(Path(out)):  # other processes may work on other subjects
        return _write(Path(out))


def _write(out):
    found = collected(out)
    made = tables(found)
    write_json(out / "paper.json", {"subjects": found, "tables": [vars(table) for table in made]})
    write_text(out / "tables.md", "\n".join(table.markdown() for table in made))
    sections = "".join(_section(section, found, out) for section in SECTIONS)
    write_text(out / "index.html", document(TITLE, _paragraph(INTRODUCTION) + sections))
    return out / "index.html"


def _section(section, found, out):
    """HTML; without anything to show it says so."""
    shown = [_table(table) for table in (make(found) for make in section.tables) if table.rows]
    for name in found:
        for pattern, words in section.pictures:
            shown += _pictures(out / name, pattern, f"{name}: {words}")
    head = f"<h2>{html.escape(section.title)}</h2>"
    head += _paragraph(section.paper, "In the paper.") + _paragraph(section.here, "Here.")
    return head + ("".join(shown) or _paragraph("Nothing of it has been made yet."))


def _table(table):
    rows = [[None if value is None else text(value) for value in row] for row in table.rows]
    note = _paragraph(table.note) if table.note else ""
    return f"<h3>{html.escape(table.title)}</h3><div class='sheet'>{html_table(table.head, rows)}</div>{note}"


def _pictures(folder, pattern, title):
    from PIL import Image

    paths = sorted(folder.glob(pattern))
    if paths:
        yield f"<h3>{html.escape(title)}</h3>"
    for path in paths:
        caption = str(path.relative_to(folder).with_suffix("")).replace("_", " ")
        yield f"<div class='sheet'>{figure(np.asarray(Image.open(path).convert('RGB')), caption)}</div>"


def _paragraph(words, lead=""):
    lead = f"<b>{html.escape(lead)}</b> " if lead else ""
    return f"<p class='soft'>{lead}{html.escape(words)}</p>"
