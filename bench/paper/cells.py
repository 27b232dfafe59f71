"""What tables are made of: cells, and rows of them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Table:
    """Rows of texts and numbers; None is a dash."""

    title: str
    head: tuple[str, ...]
    rows: list[list]
    note: str = ""

    def markdown(self):
        lines = [f"## {self.title}", "", f"| {' | '.join(self.head)} |", "|---" * len(self.head) + "|"]
        lines += [f"| {' | '.join(text(value) for value in row)} |" for row in self.rows]
        return "\n".join([*lines, "", self.note]).rstrip() + "\n"


def text(value):
    """A cell: four digits of a similarity, one of an error, as many as it takes."""
    if value is None:
        return "-"
    if not isinstance(value, float):
        return str(value)
    return f"{value:.4f}" if abs(value) < 1 else f"{value:.2f}" if abs(value) < 20 else f"{value:.1f}"


def percent(change):
    return None if change is None else f"{100 * change:+.1f} %"


def relative(value, reference):
    return None if value is None or not reference else value / reference - 1


def interval(change):
    """A change with its 95 % interval."""
    if not change:
        return None
    low, high = (f"{100 * change[end]:+.1f}" for end in ("low", "high"))
    return f"{percent(change['change'])} [{low}, {high}]"
