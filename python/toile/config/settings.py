"""What a setting is: a field of a model with a default, a unit and a meaning."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

UNITS = (
    "m",
    "m^2",
    "cm^-2",
    "mm",
    "px",
    "rad",
    "s",
    "nat^-1",
    "N m",
    "N/m",
    "kg/m^2",
    "sigma",
    "count",
    "1",
    "name",
    "switch",
)


class Settings(BaseModel):
    """A group of settings. An unknown name is an error, a value is kept as it was given."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def setting(default: Any, unit: str, meaning: str, **limits: Any) -> Any:
    """A field of Settings. unit: one of UNITS, "1" for shares and weights. limits: those of pydantic (ge, gt, le, lt)."""
    return Field(default, description=meaning, json_schema_extra={"unit": unit}, **limits)


def _rising(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[0] > pair[1]:
        raise ValueError("expected two numbers of which the second is not the smaller one")
    return pair


def _falling(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[0] < pair[1]:
        raise ValueError("expected two numbers of which the second is not the larger one")
    return pair


def _power_of_two(value: int) -> int:
    if value < 1 or value & (value - 1):
        raise ValueError("expected a power of two")
    return value


PowerOfTwo = Annotated[int, AfterValidator(_power_of_two)]
Rising = Annotated[tuple[float, float], AfterValidator(_rising)]
Falling = Annotated[tuple[float, float], AfterValidator(_falling)]


@dataclass(frozen=True)
class Listed:
    """One setting: its dotted name, default, unit and meaning."""

    name: str
    default: Any
    unit: str
    meaning: str


def listed(settings: Settings, prefix: str = "") -> Iterator[Listed]:
    """Every setting of a model and of the models in it, with the values that `settings` has; a model's own first."""
    groups = {}
    for name, field in type(settings).model_fields.items():
        value = getattr(settings, name)
        if isinstance(value, Settings):
            groups[name] = value
        else:
            extra = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
            yield Listed(f"{prefix}{name}", value, str(extra.get("unit", "")), field.description or "")
    for name, group in groups.items():
        yield from listed(group, f"{prefix}{name}.")
