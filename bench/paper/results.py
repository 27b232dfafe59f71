"""The rows of a study, and the files of its results."""

from __future__ import annotations

import json

from toile.io.files import write_text

REGRESSED, UNALIGNED, ALIGNED = "direct regression", "no texture alignment", "texture alignment"
FULL, DAMPED = "full", "damped"
SWITCHES = {  # row: what of the settings differs
    REGRESSED: lambda s, window: changed(s, data={"window": window}),
    "no view conditioning": lambda s, _: changed(s, network={"view": False}),
    "no shadow network": lambda s, _: changed(s, network={"shadow": False}),
    "no light told apart": lambda s, _: changed(s, data={"light": False}),
    "no soft visibility": lambda s, _: changed(s, weights={"visibility": 0.0}),
}


def read(path):
    return json.loads(path.read_text(encoding="utf-8"))


def write_json(path, values):
    write_text(path, json.dumps(values, indent=1, allow_nan=False) + "\n")


def slug(row):
    return row.replace(" ", "_")


def changed(settings, **updates):
    """Settings with fields replaced; a dictionary replaces fields of the settings there."""
    nested = {
        name: getattr(settings, name).model_copy(update=value) if isinstance(value, dict) else value
        for name, value in updates.items()
    }
    return settings.model_copy(update=nested)


def driven_of(found):
    """(subject, seed, what `toile evaluate --driven` says of all frames) of every study that has it."""
    for name, subject in found.items():
        for seed, one in subject["seeds"].items():
            if "driven" in one:
                yield name, seed, one["driven"]["all"]
