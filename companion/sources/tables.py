"""Tables of TOML files as pydantic models, and what is said of one that breaks a rule.

Keys carry their SI unit, altitudes their datum; unknown keys are refused with the nearest known one
named.  A broken rule is one line: field, value, rule, remedy.
"""

import difflib
import typing
from collections.abc import Iterator
from dataclasses import MISSING, fields
from typing import Annotated, Any, Final, Self, TypeVar

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    create_model,
    model_validator,
)
from pydantic_core import PydanticCustomError

from companion.errors import InputError
from companion.planner.rules import Broken
from companion.ranges import Horizontal, Longitude

FileName = Annotated[str, Field(min_length=1, max_length=1000)]
_RULE: Final = "rule"
"""Of an error: a rule of ours is broken, its context says which."""
_MOST_SHOWN: Final = 4  # of the items of a value


class Table(BaseModel):
    """A table of a file: its keys and no others, each of its own type."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    def of(self, kind: type) -> dict[str, Any]:
        """The values of the fields that a dataclass has too, but for what was left out."""
        names = {field.name for field in fields(kind)} & type(self).model_fields.keys()
        values = {name: getattr(self, name) for name in names}
        return {name: value for name, value in values.items() if value is not None}

    def broken(self) -> Iterator[Broken]:
        """The rules between its keys that it breaks; field "": all of it."""
        yield from ()

    @model_validator(mode="before")
    @classmethod
    def _has_no_other_key(cls, table: Any) -> Any:
        known = sorted(info.alias or name for name, info in cls.model_fields.items())
        if cls.model_config["extra"] != "forbid" or not isinstance(table, dict):
            return table
        for key in [key for key in table if key not in known][:1]:
            nearest = difflib.get_close_matches(key, known, n=1, cutoff=0.0)
            first = f"Did you mean {nearest[0]}?" if nearest else "Remove it."
            rule, remedy = "no such key (units are part of keys)", f"{first} Known here: "
            raise _refusal(key, table[key], rule, f"{remedy}{', '.join(known)}.")
        return table

    @model_validator(mode="after")
    def _breaks_no_rule(self) -> Self:
        for broken in self.broken():
            raise _refusal(*broken)
        return self


def _refusal(field: str, value: object, rule: str, remedy: str) -> PydanticCustomError:
    context = {"field": field, "value": value, "rule": rule, "remedy": remedy}
    return PydanticCustomError(_RULE, "{rule}", context)


def broken_of(*rules: tuple[bool, str, object, str, str]) -> Iterator[Broken]:
    """Those that are broken, of rules that each begin with whether they are."""
    return (
        (field, value, rule, remedy) for is_broken, field, value, rule, remedy in rules if is_broken
    )


def keys_of(kind: type, *names: str, **keys_by_name: str) -> Any:
    """A table with these fields of a dataclass: type, range and default are said there.

    keys_by_name: fields whose key in the file is another: field="key".
    """
    types_of = typing.get_type_hints(kind, include_extras=True)
    defaults = {field.name: field.default for field in fields(kind)}
    keys: Any = {
        name: (
            types_of[name],
            Field(... if defaults[name] is MISSING else defaults[name], alias=key),
        )
        for name, key in (dict.fromkeys(names) | keys_by_name).items()
    }
    return create_model(f"Keys of {kind.__name__}", __base__=Table, **keys)


Model = TypeVar("Model", bound=BaseModel)
_LIMITS = {"gt": "above", "ge": "of at least", "lt": "below", "le": "of at most"}
"""Of numbers, by pydantic's names."""


def validated(model: type[Model], table: dict[str, Any], where: str = "") -> Model:
    """The checked table, or the first broken rule as an InputError; where: the file."""
    try:
        return model.model_validate(table)
    except ValidationError as error:
        first = error.errors()[0]
    kind, value, context = first["type"], first["input"], first.get("ctx", {})
    place = [step for step in first["loc"] if not str(step).startswith("(")]  # not a tag
    rule, remedy = first["msg"], "Give a valid value; see docs/files.md."
    limits = [f"{word} {context[limit]:g}" for limit, word in _LIMITS.items() if limit in context]
    if kind == _RULE:
        value, remedy, place = context["value"], context["remedy"], [*place, context["field"]]
    elif kind == "missing":
        value, rule, remedy = None, "it is missing", f"Add {place[-1]}; see docs/files.md."
    elif kind == "model_type":
        rule = "it must be a table"
    elif kind == "too_short":
        rule, remedy = "it has no item", "Add one; see docs/files.md."
    elif limits:
        remedy = f"Write a number {' and '.join(limits)}."
    elif kind.startswith(("float", "int")):
        remedy = f"Write a {'whole ' * kind.startswith('int')}number, without quotes."
    field = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in place)
    if isinstance(value, dict | list) and len(value) > _MOST_SHOWN:
        value = f"{len(value)} items"
    rule = rule.replace("Input should be", "it must be")
    raise InputError(": ".join(filter(None, (where, field.strip(".")))), value, rule, remedy)


# --- what worlds and missions have in common


class OriginTable(Table):
    """Where the local frame has its origin."""

    latitude_deg: Annotated[float, Field(ge=-85.0, le=85.0)]
    longitude_deg: Longitude


class AreaTable(Table):
    """The map: no path leaves it."""

    north_min_m: Horizontal
    north_max_m: Horizontal
    east_min_m: Horizontal
    east_max_m: Horizontal

    @property
    def sides_m(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Lowest and highest north, and east."""
        return (self.north_min_m, self.north_max_m), (self.east_min_m, self.east_max_m)
