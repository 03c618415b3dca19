"""The planner's settings as MAVLink parameters of our component (mavlink.md 2.5).

All of them are REAL32 in C-cast encoding, and the table never changes.  A PARAM_SET is checked by
the rules of mission files; the resulting value is always broadcast, and a refusal is also answered
with PARAM_ERROR. Changes apply from the next plan on.
"""

import math
from collections.abc import Iterable
from typing import final

from companion.mavlink.addressing import (
    Address,
    Ids,
    Reply,
    address_of,
    ids_text,
    may_command,
    sender_of,
)
from companion.mavlink.commands import from_float32, speed_bounds_m_s
from companion.mavlink.dialect import Message, wire
from companion.mission.events import FenceChanged
from companion.mission.state import within
from companion.planner.adjustable import PARAMETERS, Parameter, differences
from companion.planner.rules import newly_broken
from companion.planner.settings import Task
from companion.world.threats import CircleZone

_PACE_S = 0.04  # between two values of a list: 25 a second are a sixth of 57,600 baud


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
        """As it is now: `follow` what something else changes."""
        self.targets_ne_m = targets_ne_m
        """Must remain valid after every change."""
        self.fence: FenceChanged | None = None
        self.keep_outs: tuple[CircleZone, ...] = ()
        """The vehicle's own: the rules hold within it as well."""
        self.charted = False
        """Whether terrain is known in advance: it lies in cells of the mission's own size."""
        self.airborne = False
        """Whether the vehicle flies: the cells of its map cannot change then."""
        self.ours = ours
        self._commanders = tuple(commanders)
        self._slowest_m_s, self._fastest_m_s = speed_bounds_m_s(task.limits)
        self._next = len(PARAMETERS)
        """Of a list that is being sent, the index of what comes next."""
        self._sent_at_s = -math.inf

    def on_message(self, message: Message, now_s: float) -> Reply:
        """Answer a message of the parameter protocol that is for us; any other gives nothing."""
        kind = message.get_type()
        if kind not in ("PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET"):
            return Reply()
        address = address_of(message, self.ours)
        if kind == "PARAM_SET":
            return self._on_set(message) if address is Address.US else Reply()
        if address is Address.OTHERS:
            return Reply()
        if kind == "PARAM_REQUEST_READ":
            return Reply(replies=self._on_read(message))
        self._next, self._sent_at_s = 0, -math.inf
        return Reply(replies=self.on_time(now_s))

    def on_time(self, now_s: float) -> list[Message]:
        """The next value of a list that was asked for, if it is time for one."""
        if self._next >= len(PARAMETERS) or 0.0 <= now_s - self._sent_at_s < _PACE_S:
            return []
        self._next, self._sent_at_s = self._next + 1, now_s
        return [self._value(self._next - 1)]

    @property
    def due_s(self) -> float:
        """When the next value of a list is to be sent, at the latest."""
        return self._sent_at_s + _PACE_S if self._next < len(PARAMETERS) else math.inf

    def follow(self, task: Task) -> list[Message]:
        """Take a changed task; broadcasts the values that were changed elsewhere."""
        changed = [] if task is self.task else differences(task, self.task)
        self.task = task
        return [self._value(_BY_NAME[name]) for name in changed]

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

    def _on_set(self, message: Message) -> Reply:
        """Set if allowed; the resulting value is broadcast in any case."""
        index = _BY_NAME.get(message.param_id)
        if index is None:
            unknown = _error(message, -1, wire.MAV_PARAM_ERROR_DOES_NOT_EXIST)
            text = f"{message.param_id!r}: there is no such parameter"
            return Reply(replies=[unknown], text=text)
        parameter, value = PARAMETERS[index], from_float32(message.param_value)
        sender, error = sender_of(message), wire.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE
        refused = changed = ""
        if not may_command(sender, self._commanders):
            refused = f"{parameter.name}: {ids_text(sender)} may not set it: link.commanders"
            error = wire.MAV_PARAM_ERROR_PERMISSION_DENIED
        elif message.param_type != wire.MAV_PARAM_TYPE_REAL32:
            refused = f"{parameter.name}: its type is REAL32 (9), not {message.param_type}"
        elif value != parameter.value(self.task):
            changed = f"{parameter.name} = {value:g}"
            if refusal := parameter.refusal(value) or self._refusal(parameter, value):
                refused, changed = f"{changed}: {refusal}", ""
            else:
                self.task = parameter.changed(self.task, value)
        return Reply(
            replies=[self._value(index), *([_error(message, index, error)] if refused else [])],
            text=refused,
            changed=changed,
            task=self.task if changed else None,
        )

    def _refusal(self, parameter: Parameter, value: float) -> str:
        """Why flight or mission do not allow a value; empty if they do."""
        if parameter.on_ground and self.airborne:
            return "it can be set on the ground only"
        too_slow, too_fast = value < self._slowest_m_s, value > self._fastest_m_s
        if parameter.field == "speed_m_s" and (too_slow or too_fast):
            return f"it must be {self._slowest_m_s:.3g} to {self._fastest_m_s:g}, the mission's"
        before, after = self.task, parameter.changed(self.task, value)
        if self.charted and after.cell_m != before.cell_m:
            return f"the terrain known in advance lies in its cells: set {parameter.key} instead"
        broken = newly_broken(before, after)
        before, after = (within(task, self.fence, self.keep_outs) for task in (before, after))
        broken = broken or newly_broken(before, after, self.targets_ne_m)
        if broken is None:
            return ""
        _, _, rule = str(broken).partition(": ")
        return rule if broken.field == parameter.key else str(broken)


def _error(message: Message, index: int, error: int) -> Message:
    """PARAM_ERROR to the sender of a PARAM_SET."""
    name = message.param_id.encode("ascii", errors="replace")
    return wire.MAVLink_param_error_message(*sender_of(message), name, index, error)
