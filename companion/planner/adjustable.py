"""The settings of the planner that may be changed while a mission lasts.

One table for all who change them or keep them: a ground station (`mavlink.parameter_server`), and a
companion that goes on with the flight of another (`mission.checkpoint`).  What a value on its own
may be stands here, and agrees with `sources.mission_schema`; what the values of a task may be
together stands in `planner.rules`.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import final

from companion.planner.settings import Task

_MOST = 1e6


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """One row of the table."""

    name: str
    """At most 16 characters."""
    meaning: str
    part: str
    """Of a task: "settings", "weights" or "limits"."""
    field: str
    """The key in mission.toml is the same, in [planner], [planner.weights] or [vehicle]."""
    low: float = 0.0
    high: float = _MOST
    positive: bool = True
    """Whether low itself is not allowed."""
    whole: bool = False
    unset: bool = False
    """Whether 0 stands for "as the rules have it"."""
    on_ground: bool = False
    """Whether it can be set only before take-off."""

    @property
    def key(self) -> str:
        """Where it stands in mission.toml."""
        table = {"settings": "planner", "weights": "planner.weights", "limits": "vehicle"}
        return f"{table[self.part]}.{self.field}"

    def value(self, task: Task) -> float:
        """As it is."""
        holder = {"settings": task.settings, "weights": task.settings.weights}
        value = getattr(holder.get(self.part, task.limits), self.field)
        return 0.0 if value is None else float(value)

    def changed(self, task: Task, value: float) -> Task:
        """The task with another value."""
        number = None if self.unset and value == 0.0 else round(value) if self.whole else value
        change = {self.field: number}
        if self.part == "limits":
            return replace(task, limits=replace(task.limits, **change))  # type: ignore[arg-type]
        if self.part == "weights":
            weights = replace(task.settings.weights, **change)  # type: ignore[arg-type]
            return replace(task, settings=replace(task.settings, weights=weights))
        return replace(task, settings=replace(task.settings, **change))  # type: ignore[arg-type]

    def refusal(self, value: float) -> str:
        """The rule of its own that a value breaks; empty if it breaks none."""
        if self.unset and value == 0.0:
            return ""
        if not math.isfinite(value):
            return "it must be a finite number"
        if not self.low <= value <= self.high or (self.positive and value == self.low):
            least = f"more than {self.low:g}" if self.positive else f"{self.low:g} or more"
            return f"it must be {least}, at most {self.high:g}"
        return "it must be a whole number" if self.whole and value != round(value) else ""


def loosest(task: Task, other: Task) -> Task:
    """A task with the smaller distances and the lower speed of two: what either lets be flown."""
    for parameter in _MARGINS:
        value = parameter.value(other)
        if value < parameter.value(task):
            task = parameter.changed(task, value)
    return task


def values_of(task: Task) -> dict[str, float]:
    """All values, by name."""
    return {parameter.name: parameter.value(task) for parameter in PARAMETERS}


def differences(task: Task, other: Task) -> dict[str, float]:
    """The values, by name, in which a task differs from another."""
    before = values_of(other)
    return {name: value for name, value in values_of(task).items() if value != before[name]}


def with_values(task: Task, values: Mapping[str, float]) -> Task:
    """A task with these values, by name.  KeyError or ValueError for what can be none."""
    for name, value in values.items():
        parameter = BY_NAME[name]
        if value == parameter.value(task):
            continue
        if refusal := parameter.refusal(value):
            raise ValueError(f"{name} = {value}: {refusal}")
        task = parameter.changed(task, value)
    return task


def _weight(name: str, field: str, meaning: str) -> Parameter:
    return Parameter(
        name=name, field=field, part="weights", meaning=f"weight of {meaning}", positive=False
    )


PARAMETERS: tuple[Parameter, ...] = (
    _weight("PLN_W_LENGTH", "length", "the path's length (f1)"),
    _weight("PLN_W_HEIGHT", "height", "its height (f2)"),
    _weight("PLN_W_GUIDE", "guide", "the guide direction (f3)"),
    _weight("PLN_W_CRASH", "crash", "nearness to terrain (f4)"),
    _weight("PLN_W_RADAR", "radar", "exposure to radars (f5)"),
    _weight("PLN_W_CONSTR", "constraints", "broken constraints (f6)"),
    Parameter(
        name="PLN_SCAN_RANGE",
        part="settings",
        field="scan_range_m",
        meaning="R, how far the terrain radar sees [m]",
        on_ground=True,
    ),
    Parameter(
        name="PLN_SCAN_DIST",
        part="settings",
        field="scan_distance_m",
        meaning="L, the scan's distance before a subpath's end [m]; 0: as short as eq. 4 allows",
        unset=True,
    ),
    Parameter(
        name="PLN_SCAN_TIME",
        part="settings",
        field="scan_time_s",
        meaning="longest time that a scan may take [s]",
    ),
    Parameter(
        name="PLN_SAFE_DIST",
        part="settings",
        field="safety_distance_m",
        meaning="d_s, the distance kept from terrain and zones [m]",
    ),
    Parameter(
        name="PLN_PLAN_TIME",
        part="settings",
        field="planning_time_s",
        meaning="T, the time that a plan is given [s]",
    ),
    Parameter(
        name="PLN_OVERLAP",
        part="settings",
        field="overlap_m",
        meaning="d_overlap of the guide function [m]",
        positive=False,
    ),
    Parameter(
        name="PLN_EVALS",
        part="settings",
        field="evaluations",
        meaning="candidates evaluated for a subpath",
        low=60.0,
        high=200_000.0,
        positive=False,
        whole=True,
    ),
    Parameter(
        name="PLN_SPEED",
        part="limits",
        field="speed_m_s",
        meaning="V, the cruising speed [m/s]; never above the mission's own",
    ),
    Parameter(
        name="PLN_ERR_TRACK",
        part="limits",
        field="tracking_error_m",
        meaning="how far the vehicle may be from its point on the path [m]",
    ),
    Parameter(
        name="PLN_ERR_NAV",
        part="limits",
        field="navigation_error_m",
        meaning="how wrong its position may be [m]",
        positive=False,
    ),
)
"""The order is that of param_index, and part of the protocol: add at the end."""

BY_NAME = {parameter.name: parameter for parameter in PARAMETERS}
_MARGINS = [
    BY_NAME[name] for name in ("PLN_SAFE_DIST", "PLN_ERR_TRACK", "PLN_ERR_NAV", "PLN_SPEED")
]
