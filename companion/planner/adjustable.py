"""The settings of the planner that may be changed while a mission lasts.

One table for the parameter server (`mavlink.parameter_server`) and for checkpoints
(`mission.checkpoint`).  The range of a single value is declared with its field; rules between the
values of a task are in `planner.rules`.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import NoneType
from typing import Any, Final, final, get_args, get_type_hints

from annotated_types import Gt

from companion.objective.scene import Weights
from companion.path.limits import Limits
from companion.planner.settings import PlannerSettings, Task

_TABLES: Final[dict[type, str]] = {
    PlannerSettings: "planner",
    Weights: "planner.weights",
    Limits: "vehicle",
}
"""The parts of a task that have settings, and the tables of mission.toml with the same keys."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """One row of the table."""

    name: str
    """At most 16 characters."""
    part: type
    """Of a task: one of `_TABLES`."""
    field: str
    low: float
    high: float
    above_low: bool
    """Whether low itself is not allowed."""
    whole: bool
    unset: bool
    """Whether 0 means "computed by the rules"."""
    on_ground: bool
    """Whether it can be set only before take-off."""

    @property
    def key(self) -> str:
        """Where it stands in mission.toml."""
        return f"{_TABLES[self.part]}.{self.field}"

    def value(self, task: Task) -> float:
        """As it is."""
        value = getattr(_parts(task)[self.part], self.field)
        return 0.0 if value is None else float(value)

    def changed(self, task: Task, value: float) -> Task:
        """The task with another value."""
        number = None if self.unset and value == 0.0 else round(value) if self.whole else value
        part: Any = replace(_parts(task)[self.part], **{self.field: number})
        if self.part is Weights:
            part = replace(task.settings, weights=part)
        return replace(task, **{"limits" if self.part is Limits else "settings": part})

    def refusal(self, value: float) -> str:
        """Why a value is out of range; empty if it is not."""
        if self.unset and value == 0.0:
            return ""
        if not math.isfinite(value):
            return "it must be a finite number"
        if not self.low <= value <= self.high or (self.above_low and value == self.low):
            least = f"more than {self.low:g}" if self.above_low else f"{self.low:g} or more"
            return f"it must be {least}, at most {self.high:g}"
        return "it must be a whole number" if self.whole and value != round(value) else ""


def _parts(task: Task) -> dict[type, Any]:
    settings = task.settings
    return {PlannerSettings: settings, Weights: settings.weights, Limits: task.limits}


def loosest(task: Task, other: Task) -> Task:
    """A task with the smaller distances and the lower speed of two: the looser in each."""
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


def _parameter(name: str, part: type, field: str, *, on_ground: bool = False) -> Parameter:
    """A row: its range is that of the field."""
    kinds = get_args(hint := get_type_hints(part, include_extras=True)[field])
    unset = NoneType in kinds
    number, least, most = get_args(kinds[0] if unset else hint)
    above_low = isinstance(least, Gt)
    return Parameter(
        name=name,
        part=part,
        field=field,
        low=least.gt if above_low else least.ge,
        high=most.le,
        above_low=above_low,
        whole=number is int,
        unset=unset,
        on_ground=on_ground,
    )


PARAMETERS: Final = (
    _parameter("PLN_W_LENGTH", Weights, "length"),
    _parameter("PLN_W_HEIGHT", Weights, "height"),
    _parameter("PLN_W_GUIDE", Weights, "guide"),
    _parameter("PLN_W_CRASH", Weights, "crash"),
    _parameter("PLN_W_RADAR", Weights, "radar"),
    _parameter("PLN_W_CONSTR", Weights, "constraints"),
    _parameter("PLN_SCAN_RANGE", PlannerSettings, "scan_range_m", on_ground=True),
    _parameter("PLN_SCAN_DIST", PlannerSettings, "scan_distance_m"),
    _parameter("PLN_SCAN_TIME", PlannerSettings, "scan_time_s"),
    _parameter("PLN_SAFE_DIST", PlannerSettings, "safety_distance_m"),
    _parameter("PLN_PLAN_TIME", PlannerSettings, "planning_time_s"),
    _parameter("PLN_OVERLAP", PlannerSettings, "overlap_m"),
    _parameter("PLN_EVALS", PlannerSettings, "evaluations"),
    _parameter("PLN_SPEED", Limits, "speed_m_s"),
    _parameter("PLN_ERR_TRACK", Limits, "tracking_error_m"),
    _parameter("PLN_ERR_NAV", Limits, "navigation_error_m"),
)
"""The order is that of param_index, and part of the protocol: add at the end.  What they mean
stands in docs/reference/parameters.md."""

BY_NAME: Final = {parameter.name: parameter for parameter in PARAMETERS}
_MARGINS: Final = [
    BY_NAME[name] for name in ("PLN_SAFE_DIST", "PLN_ERR_TRACK", "PLN_ERR_NAV", "PLN_SPEED")
]
