"""What the handlers of all phases have in common: a step, asking, giving up, faults."""

import math
from dataclasses import dataclass, replace
from typing import final

from companion.mission.events import Command, Event, Landed, LinkLost, Mode, Position
from companion.mission.health import distrust
from companion.mission.mission import Mission
from companion.mission.state import Reason, State, Trigger

Step = tuple[State, list[Command], Trigger | None]
"""The new state, what to do, and what moves the mission to another phase."""

ASK_AGAIN_S = 1.0
GONE_S = 10.0
STOPPED_M_S = 0.5
AT_M = 5.0


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Context:
    """What stays the same during a mission."""

    mission: Mission
    seed: int


def ask(state: State, command: Command) -> Step:
    """Ask for something, once a second."""
    if state.now_s - state.asked_at_s < ASK_AGAIN_S:
        return state, [], None
    return replace(state, asked_at_s=state.now_s), [command], None


def give_up(state: State, reason: Reason) -> Step:
    """End the mission; a vehicle in the air is left in its hold mode."""
    return replace(state, reason=reason), [], Trigger.GIVE_UP


def fault(state: State, reason: Reason) -> Step:
    """Stop and hold for a reason."""
    return replace(state, reason=reason), [], Trigger.FAULT


def in_phase_s(state: State) -> float:
    """How long this phase has lasted."""
    return state.now_s - state.since_s


def is_gone(event: Event) -> bool:
    """Whether the vehicle has been silent for too long to hope for it."""
    return isinstance(event, LinkLost) and event.silent_s >= GONE_S


def lost_command(state: State, event: Event) -> Reason | None:
    """Why the vehicle does not take setpoints now; None: it does."""
    vehicle = state.vehicle
    if isinstance(event, LinkLost):
        return Reason.LINK_LOST
    if not vehicle.armed:
        return Reason.DISARMED
    return None if vehicle.mode is Mode.GUIDED else Reason.MODE_TAKEN


def cannot_fly(state: State, event: Event) -> Reason | None:
    """Why the flight cannot go on as it is; None: it can."""
    lost = lost_command(state, event)
    if lost is not None:
        return lost
    if state.vehicle.landed is Landed.ON_GROUND:
        return Reason.GROUNDED
    return distrust(state.vehicle, state.now_s)


def speed_m_s(event: Position) -> float:
    """Speed over all axes."""
    return math.hypot(*event.velocity_nea_m_s)
