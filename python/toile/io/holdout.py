"""Frames held out, "A-B": an avatar is measured on them, so nothing that other frames are made from may read them. A span of
frame numbers, with pictures or without: the setting `holdout` of `toile register` and an attribute of the run's store."""

from __future__ import annotations

import re
from collections.abc import Iterable

from ..errors import UserError

Span = tuple[int, int] | tuple[()]  # first and last number; none are held out


def span_of(text: str) -> Span:
    """ "400-459" -> (400, 459), "400" -> (400, 400), "none" -> (). UserError: none of these."""
    match = re.fullmatch(r"([0-9]{1,6})(?:-([0-9]{1,6}))?", text)
    if text == "none":
        return ()
    if not match or int(match[2] or match[1]) < int(match[1]):
        raise UserError(f"--holdout {text[:40]}: expected A-B, frame numbers, or none")
    return int(match[1]), int(match[2] or match[1])


def words_of(span: Span) -> str:
    """The text of a span."""
    return f"{span[0]}-{span[1]}" if span else "none"


def held(span: Span) -> range:
    """The numbers of a span."""
    return range(span[0], span[1] + 1) if span else range(0)


def apart(frames: Iterable[int], span: Span) -> list[int]:
    """Those of the frames that are not held out, in their order."""
    numbers = held(span)
    return [number for number in frames if number not in numbers]


def kept_apart(span: Span, pictured: Iterable[int]) -> list[int]:
    """All numbers that nothing else may read: a run's span, and those from the first to the last of the pictured frames that a
    training holds out, which are neighbours among the pictured ones."""
    own = sorted(pictured)
    return sorted({*held(span), *(range(own[0], own[-1] + 1) if own else ())})


def agreed(asked: str | None, own: Span, of: object) -> Span:
    """The span that a command asks for, of a run `of` that was made with its `own`: that one, where there is one. UserError:
    they differ."""
    if asked is None or (own and span_of(asked) == own):
        return own
    if own:
        raise UserError(
            f"--holdout {asked}: {of} was registered with --holdout {words_of(own)}, which stays: leave it out"
        )
    return span_of(asked)
