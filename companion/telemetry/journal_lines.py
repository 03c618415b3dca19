"""What all lines of journal.jsonl have in common, and the headers among them (docs/journal.md).

Names carry units; `_nea_m` is north, east (of the mission's local frame) and altitude AMSL, metres;
times are the vehicle's clock.  JSON has no infinite numbers: where one may come up, it is null.
"""

from typing import Literal, final

from pydantic import BaseModel, ConfigDict, Field

SCHEMA = "companion-journal"
VERSION = 3
"""The newest.  What has changed: `journal._TO_NEXT`."""

NorthEast = tuple[float, float]
NorthEastAltitude = tuple[float, float, float]


class Line(BaseModel):
    """An object of JSON.  Attribute docstrings are the descriptions that docs/journal.md shows."""

    model_config = ConfigDict(
        extra="allow",  # and counted by the reader: a field that is not documented
        frozen=True,
        allow_inf_nan=False,
        use_attribute_docstrings=True,
    )


@final
class Header(Line):
    """The first line; one more each time that the companion was started again in the flight."""

    schema_name: Literal["companion-journal"] = Field(alias="schema")
    """Says that this is a journal of the companion."""
    version: int
    """Of this schema."""
    mission: str
    """The mission's name."""
    seed: int
    """Of the search."""
    profile: Literal["flight", "paper"]
    """How the planner takes the paper."""
    lockstep: bool
    """Whether vehicle and companion waited for each other."""
    resumed: int | None = None
    """How often it had been started again; left out of the first header."""


class TimedLine(Line):
    """An entry: what happened, or was decided."""

    t_s: float
    """Vehicle time: seconds since its boot (until its clock is known, since the start)."""
