"""The planner's settings as MAVLink parameters of our component (mavlink.md 2.5).

All of them are REAL32 in C-cast encoding, and the table never changes.  A PARAM_SET is held to the
rules that hold for a mission file; whatever becomes of it, the value as it is then is broadcast.
What is set counts from the next plan on.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import final

from companion.errors import InputError
from companion.mavlink.addressing import Address, Ids, address_of, may_command, sender_of, written
from companion.mavlink.commands import meant, speed_bounds_m_s
from companion.mavlink.dialect import Message, wire
from companion.planner.rules import check_target, check_task
from companion.planner.settings import Task

_MOST = 1e6
_PACE_S = 0.04  # between two values of a list: 25 a second are a sixth of 57,600 baud


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

_BY_NAME = {parameter.name: index for index, parameter in enumerate(PARAMETERS)}


@final
class ParameterServer:
    """Serves and takes the planner's settings.  Pure: time is an argument.

    task: the mission's own; ours: our ids; commanders: who may set (0: any id).
    """

    def __init__(
        self,
        task: Task,
        *,
        ours: Ids,
        commanders: Iterable[Ids],
        targets_ne_m: tuple[tuple[float, float], ...] = (),
    ) -> None:
        self.task = task
        """As it is now: keep it up to date when something else changes it."""
        self.targets_ne_m = targets_ne_m
        """Must stay allowed, whatever is set."""
        self.airborne = False
        """Whether the vehicle flies: the cells of its map cannot change then."""
        self.ours = ours
        self.changed: str | None = None
        """What the last message has changed: name = value."""
        self.refused: str | None = None
        """Why the last message has changed nothing, although it should have."""
        self._commanders = tuple(commanders)
        self._slowest_m_s, self._fastest_m_s = speed_bounds_m_s(task.limits)
        self._next = len(PARAMETERS)
        """Of a list that is being sent, the index of what comes next."""
        self._sent_at_s = -math.inf

    def on_message(self, message: Message, now_s: float) -> list[Message]:
        """Answer a message of the parameter protocol that is for us; any other gives nothing."""
        self.changed = self.refused = None
        kind = message.get_type()
        if kind not in ("PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET"):
            return []
        address = address_of(message, self.ours)
        if kind == "PARAM_SET":
            return self._on_set(message) if address is Address.US else []
        if address is Address.OTHERS:
            return []
        if kind == "PARAM_REQUEST_READ":
            return self._on_read(message)
        self._next, self._sent_at_s = 0, -math.inf
        return self.on_time(now_s)

    def on_time(self, now_s: float) -> list[Message]:
        """The next value of a list that was asked for, if it is time for one."""
        if self._next >= len(PARAMETERS) or 0.0 <= now_s - self._sent_at_s < _PACE_S:
            return []
        self._next, self._sent_at_s = self._next + 1, now_s
        return [self._value(self._next - 1)]

    def _value(self, index: int) -> Message:
        parameter = PARAMETERS[index]
        return wire.MAVLink_param_value_message(
            param_id=parameter.name.encode("ascii"),
            param_value=parameter.value(self.task),
            param_type=wire.MAV_PARAM_TYPE_REAL32,
            param_count=len(PARAMETERS),
            param_index=index,
        )

    def _on_read(self, message: Message) -> list[Message]:
        """By index, or by name if that is -1; what is not there is not answered."""
        index = message.param_index
        if index < 0:
            index = _BY_NAME.get(message.param_id, -1)
        return [self._value(index)] if 0 <= index < len(PARAMETERS) else []

    def _on_set(self, message: Message) -> list[Message]:
        index = _BY_NAME.get(message.param_id)
        if index is None:
            self.refused = f"{message.param_id!r}: there is no such parameter"
            return []
        parameter, value = PARAMETERS[index], meant(message.param_value)
        sender = sender_of(message)
        if not may_command(sender, self._commanders):
            self.refused = f"{parameter.name}: {written(sender)} may not set it: link.commanders"
        elif message.param_type != wire.MAV_PARAM_TYPE_REAL32:
            self.refused = f"{parameter.name}: its type is REAL32 (9), not {message.param_type}"
        elif value != parameter.value(self.task):
            self._set(parameter, value)
        return [self._value(index)]

    def _set(self, parameter: Parameter, value: float) -> None:
        refusal = parameter.refusal(value) or self._refusal(parameter, value)
        if not refusal:
            after = parameter.changed(self.task, value)
            try:
                check_task(after)
                for number, target in enumerate(self.targets_ne_m):
                    check_target(after, target, f"targets[{number}]")
            except InputError as error:
                _, _, rule = str(error).partition(": ")
                refusal = rule if error.field == parameter.key else str(error)
        if refusal:
            self.refused = f"{parameter.name} = {value:g}: {refusal}"
        else:
            self.task = after
            self.changed = f"{parameter.name} = {value:g}"

    def _refusal(self, parameter: Parameter, value: float) -> str:
        """What the flight and the mission have against a value."""
        if parameter.on_ground and self.airborne:
            return "it can be set on the ground only"
        too_slow, too_fast = value < self._slowest_m_s, value > self._fastest_m_s
        if parameter.field == "speed_m_s" and (too_slow or too_fast):
            return f"it must be {self._slowest_m_s:.3g} to {self._fastest_m_s:g}, the mission's"
        return ""
