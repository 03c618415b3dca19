"""Encodes answers to plan requests as plain values and decodes them, exact to the last bit.

A decoded subpath has the same control points, so all results based on it are the same.
"""

from dataclasses import fields
from functools import cache
from typing import Any, Final, get_type_hints

import msgspec
import numpy as np

from companion.geodesy import FloatArray
from companion.path.subpath import Subpath
from companion.planner.request import Backtrack, NotPlanned, Planned, PlanOutcome, Refusal

Values = dict[str, Any]

_KINDS: Final = {"planned": Planned, "not planned": NotPlanned, "way back": Backtrack}
_hints = cache(get_type_hints)


def values_of(outcome: PlanOutcome) -> Values:
    """An answer as numbers, texts, lists and dictionaries."""
    kind = next(name for name, each in _KINDS.items() if each is type(outcome))
    values = {each.name: getattr(outcome, each.name) for each in fields(outcome)}
    match outcome:
        case Planned():
            values["control_nea_m"] = values.pop("subpath").control_nea_m
        case NotPlanned():
            values["refusal"] = outcome.refusal.name
        case Backtrack():
            values["control_nea_m"] = [each.control_nea_m for each in values.pop("subpaths")]
    plain: Values = msgspec.to_builtins(
        {"kind": kind, **values}, enc_hook=lambda each: each.tolist()
    )
    return plain


def outcome_of(values: Values) -> PlanOutcome:
    """Decode an answer.  KeyError, TypeError, ValueError: invalid values."""
    if (kind := _KINDS.get(values["kind"])) is None:
        raise ValueError(f"no kind of answer: {values['kind']!r}")
    made: Values = {
        name: msgspec.convert(values[name], hint, strict=False)
        for name, hint in _hints(kind).items()
        if name in values and hint is not Refusal
    }
    if kind is NotPlanned:
        return NotPlanned(refusal=Refusal[values["refusal"]], **made)
    rows = values["control_nea_m"]
    if kind is Planned:
        return Planned(subpath=_subpath(rows), **made)
    return Backtrack(subpaths=tuple(map(_subpath, rows)), **made)


def control_points(rows: list[list[float]]) -> FloatArray:
    """The control points of a subpath.  ValueError: invalid values."""
    control = np.array(rows, dtype=np.float64)
    if control.ndim != 2 or control.shape[1] != 3 or len(control) < 4:
        raise ValueError("control points are rows of north, east, altitude")
    if not np.isfinite(control).all():
        raise ValueError("control points are finite")
    return control


def _subpath(rows: list[list[float]]) -> Subpath:
    return Subpath(control_nea_m=control_points(rows))
