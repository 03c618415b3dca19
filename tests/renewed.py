"""`replace` for both kinds of values that the companion is made of."""

import dataclasses
from copy import copy
from typing import TypeVar

import msgspec

from companion.mission.machine import PHASES
from companion.mission.phases import Holding, Led, Preparing, Reason
from companion.mission.state import State

Value = TypeVar("Value")


def deep(state: State) -> State:
    """A copy of a state, all of which that a step changes may be changed."""
    state = copy(state)
    state.vehicle, state.flight = copy(state.vehicle), copy(state.flight)
    state.stage = copy(state.stage)
    if isinstance(state.stage, Led | Preparing):
        state.stage.path = copy(state.stage.path)
    return state


def replace(value: Value, /, **changes: object) -> Value:
    """A copy of a state (msgspec's) or of any other value (a dataclass) with some other fields.

    Of a mission's state those of its phase, too; phase: another one.
    """
    if isinstance(value, State):
        phase, stage = changes.pop("phase", value.phase), value.stage
        if phase is not stage.phase:
            kind = PHASES[phase][0]
            held = {"why": Reason.ESTIMATOR} if kind is Holding else {}
            stage = kind(phase=phase, since_s=stage.since_s, **held)
        of_stage = {name: changes.pop(name) for name in [*changes] if hasattr(stage, name)}
        changes["stage"] = msgspec.structs.replace(changes.get("stage", stage), **of_stage)
    if isinstance(value, msgspec.Struct):
        return msgspec.structs.replace(value, **changes)
    return dataclasses.replace(value, **changes)  # type: ignore[type-var]
