"""Changes of settings: from a file, from `--set NAME=VALUE`, from keywords. Unknown names are refused with the nearest."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from ..errors import UserError
from .settings import Settings, listed

Group = TypeVar("Group", bound=Settings)
Changes = Mapping[str, Any]  # nested, as TOML's tables are; names may be dotted
NONE = "none"  # how a value of None is written, for which TOML has no word


def changed(settings: Group, *changes: Changes, source: str = "", also: Iterable[str] = ()) -> Group:
    """`settings` with changes applied in their order; a later one wins. `source` begins every message; `also` are names
    that the message of an unknown one may suggest. UserError: no such setting, or a value that it cannot have."""
    values = settings.model_dump()
    for change in changes:
        _merge(values, nested(change), settings, source, tuple(also))
    try:
        return type(settings).model_validate(_tuples(values), strict=True)
    except ValidationError as error:
        first = error.errors()[0]
        what = first["msg"].replace("Input should be", "should be").replace("Value error, ", "")
        at = ".".join(str(part) for part in first["loc"])
        together = first["type"] == "value_error" and isinstance(
            first["input"], dict
        )  # of settings, none of them by itself
        given = "" if together else f" = {first['input']!r}"
        raise UserError(f"{source}{at}{given}: {what}" if at else f"{source}{what}") from None


def read_config(path: Path | None, table: str = "") -> dict[str, Any]:
    """The changes that a TOML file asks for; nothing for None. Of a run's config.toml the settings that it was made with, or
    those of its `table` ("align"). UserError names the file."""
    if path is None:
        return {}
    try:
        found: dict[str, Any] = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise UserError(f"--config {path}: cannot be read as TOML: {reason}") from None
    if "frames" not in found or not isinstance(found.get("settings"), dict):
        return found  # written by hand
    saved = found.get(table) if table else found
    if not isinstance(saved, dict) or not isinstance(saved.get("settings"), dict):
        raise UserError(f"--config {path}: this run has no settings of {table}")
    return saved["settings"]


def from_options(
    base: Callable[[str], Group], quality: str | None, path: Path | None, words: Iterable[str] | None, table: str = ""
) -> Group:
    """The settings that a command was asked for: `base` of a quality, changed by --config and then by --set. Without
    --quality that of --set counts, then that of the file, then "standard"; of settings that have no quality none does."""
    file, given = read_config(path, table), read_set(words)
    asked: list[Any] = [quality]
    if "quality" in type(base("standard")).model_fields:
        asked += [change.pop("quality", None) for change in (given, file)]
    chosen = next(filter(None, asked), "standard")
    return changed(changed(base(str(chosen)), file, source=f"--config {path}: "), given, source="--set ")


def read_set(words: Iterable[str] | None) -> dict[str, Any]:
    """["dress.contact=0.01", ...] -> nested changes. Values are TOML's; what is no such value is text, the word none is None."""
    found: dict[str, Any] = {}
    for word in words or ():
        name, equals, text = word.partition("=")
        if not equals or not name.strip():
            raise UserError(f"--set {word}: expected NAME=VALUE, as in dress.contact=0.01")
        try:
            value = tomllib.loads(f"value = {text}")["value"]
        except (tomllib.TOMLDecodeError, RecursionError):
            value = None if text.strip() == NONE else text.strip()
        _put(found, name.strip(), value)
    return found


def nested(changes: Changes) -> dict[str, Any]:
    """Dotted names as tables in tables."""
    found: dict[str, Any] = {}
    for name, value in changes.items():
        _put(found, name, nested(value) if isinstance(value, Mapping) else value)
    return found


def nearest(name: str, names: Iterable[str]) -> str:
    """The name that is most like one; "" where none is like it at all. The last part of a dotted name counts alone too."""
    names = list(names)
    close = difflib.get_close_matches(name, names, 1, 0.6)
    last = {n.rpartition(".")[2]: n for n in reversed(names)}
    own = difflib.get_close_matches(name.rpartition(".")[2], last, 1, 0.75)
    return close[0] if close else last[own[0]] if own else ""


def _put(table: dict[str, Any], name: str, value: Any) -> None:
    *groups, last = name.split(".")
    for group in groups:
        inner = table.setdefault(group, {})
        if not isinstance(inner, dict):
            raise UserError(f"{name}: {group} is given as a value too")
        table = inner
    if isinstance(value, dict) and isinstance(table.get(last), dict):
        for inner_name, inner_value in value.items():
            _put(table[last], inner_name, inner_value)
    else:
        table[last] = value


def _merge(
    values: dict[str, Any], change: Changes, group: Settings, source: str, also: tuple[str, ...], prefix: str = ""
) -> None:
    """Writes a change into the values of a group, table by table."""
    for name, value in change.items():
        at = f"{prefix}{name}"
        if name not in type(group).model_fields:
            raise UserError(f"{source}{at}: no such setting{_suggestion(name, group, also, prefix)}")
        inner = getattr(group, name)
        if isinstance(inner, Settings):
            if not isinstance(value, Mapping):
                raise UserError(f"{source}{at} = {value!r}: expected a table, its settings are {at}.NAME")
            _merge(values[name], value, inner, source, (), f"{at}.")
        elif isinstance(inner, dict) and isinstance(value, Mapping):
            values[name] = {**values[name], **value}
        else:
            values[name] = value


def _suggestion(name: str, group: Settings, also: tuple[str, ...], prefix: str) -> str:
    own = [*type(group).model_fields, *(one.name for one in listed(group)), *also]
    best = nearest(name, own)
    return f"; nearest: {prefix}{best}" if best else f"; there are {', '.join(list(type(group).model_fields))}"


def _tuples(value: Any) -> Any:
    """TOML's arrays as the tuples that settings hold."""
    if isinstance(value, dict):
        return {name: _tuples(inner) for name, inner in value.items()}
    return tuple(_tuples(inner) for inner in value) if isinstance(value, list | tuple) else value
