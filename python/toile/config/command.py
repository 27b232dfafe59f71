"""The command `toile settings`."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from typing import Annotated, Any

import typer

from ..errors import UserError
from .changes import NONE, nearest
from .settings import Listed, Settings, listed


def settings(
    stage: Annotated[
        str | None, typer.Argument(help="a command, a stage or a group: align, dress, dress.loop; default all")
    ] = None,
    markdown: Annotated[bool, typer.Option("--markdown", help="as the page of the documentation")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="only the JSON on stdout")] = False,
) -> None:
    """List the settings with defaults, units and meanings: what --set NAME=VALUE and --config change."""
    tables = chosen(stage)
    if as_json:
        typer.echo(
            json.dumps({command: [row(one, others) for one, others in rows] for command, rows in tables.items()})
        )
    elif markdown:
        typer.echo(page(tables))
    else:
        for command, rows in tables.items():
            typer.echo(f"toile {command} --set NAME=VALUE")
            for line in lines(rows):
                typer.echo(line)


Row = tuple[Listed, dict[str, Any]]  # a setting, and the presets in which it has another value


def commands() -> dict[str, tuple[Callable[[str], Settings], tuple[str, ...]]]:
    """The settings of a quality by command, and the command's qualities."""
    from ..align.settings import AlignSettings
    from ..avatar.settings import PRESETS, AnimateSettings, train_preset
    from ..studio.options import StudioOptions
    from .presets import QUALITIES, preset
    from .stereo import SCAN_PRESETS, scan_preset

    return {
        "register": (preset, QUALITIES),
        "reconstruct": (scan_preset, tuple(SCAN_PRESETS)),
        "align": (lambda _: AlignSettings(), ("standard",)),
        "train": (train_preset, tuple(PRESETS)),
        "animate": (lambda _: AnimateSettings(), ("standard",)),
        "studio": (lambda _: StudioOptions(), ("standard",)),
    }


def every() -> Iterator[tuple[str, list[Row]]]:
    """All settings by command."""
    for command, (preset, qualities) in commands().items():
        values = {quality: {one.name: one.default for one in listed(preset(quality))} for quality in qualities}
        rows: list[Row] = []
        for one in listed(preset("standard")):
            others = {q: v[one.name] for q, v in values.items() if v[one.name] != one.default and one.name != "quality"}
            rows.append((one, others))
        yield command, rows


def chosen(stage: str | None) -> dict[str, list[Row]]:
    """Those of a command, or those whose name begins with a group; UserError where there is none such."""
    tables = dict(every())
    if stage is None:
        return tables
    if stage in tables:
        return {stage: tables[stage]}
    found = {command: [r for r in rows if f"{r[0].name}.".startswith(f"{stage}.")] for command, rows in tables.items()}
    if not any(found.values()):
        names = {".".join(r[0].name.split(".")[:k]) for rows in tables.values() for r in rows for k in (1, 2, 3)}
        best = nearest(stage, sorted(names | set(tables)))
        raise UserError(f"{stage}: no such stage or setting" + (f"; nearest: {best}" if best else ""))
    return {command: rows for command, rows in found.items() if rows}


def row(one: Listed, others: dict[str, Any]) -> dict[str, Any]:
    return {"name": one.name, "default": one.default, "presets": others, "unit": one.unit, "meaning": one.meaning}


def written(value: Any) -> str:
    """A value as --set reads it."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{name} = {written(inner)}" for name, inner in value.items()) + "}"
    if isinstance(value, tuple):
        return f"[{', '.join(written(inner) for inner in value)}]"
    return str(value).lower() if isinstance(value, bool) else NONE if value is None else str(value)


def default(one: Listed, others: dict[str, Any]) -> str:
    """The default, and in brackets the presets' others."""
    text = written(one.default)
    return (
        f"{text} ({', '.join(f'{quality} {written(value)}' for quality, value in others.items())})" if others else text
    )


def lines(rows: list[Row]) -> Iterator[str]:
    """Aligned columns; a long default pushes its own line only."""
    wide = max(len(one.name) for one, _ in rows)
    for one, others in rows:
        yield f"  {one.name:<{wide}}  {default(one, others):<12}  [{one.unit}] {one.meaning}"


def page(tables: dict[str, list[Row]]) -> str:
    """The page of the documentation, a table a group."""
    out = [PAGE]
    for command, rows in tables.items():
        out.append(f"## toile {command}\n")
        group = None
        for one, others in rows:
            own = one.name.rpartition(".")[0]
            if own != group:
                group = own
                out.append(f"\n### {own}\n" if own else "")
                out.append("| setting | default | unit | meaning |\n|---|---|---|---|")
            meaning = re.sub(r"\|", r"\\|", one.meaning)
            out.append(f"| `{one.name}` | {default(one, others)} | {one.unit} | {meaning} |")
        out.append("")
    return re.sub(r"\n{3,}", "\n\n", "\n".join(out)).rstrip()


PAGE = """# Settings

Every number that decides a result is a setting. `toile settings` lists them, `toile settings dress` those of a stage.
`--set dress.contact=0.01` changes one of them, as often as it is given; `--config FILE.toml` changes those that a file
names, in tables as below; the `config.toml` of a run is such a file too. What `--set` says stands above the file, and
the file above the preset that `--quality` names. In brackets stands what another preset has. An unknown name, and a
value of another kind, are refused.

```toml
quality = "draft"
[dress]
contact = 0.01
[dress.loop]
reach = 0.08
```

Units: `1` is a share, a weight or a ratio, `count` a number of things, `switch` true or false, `name` one of the words.
A default of `none` is no value, which `--set NAME=none` gives back. This page is made by `toile settings --markdown`.
"""
