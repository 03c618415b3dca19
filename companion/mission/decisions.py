"""What the handlers of all phases have in common: a step, asking, giving up, faults."""

import math
from dataclasses import dataclass
from typing import final

from msgspec.structs import replace

from companion.mission.events import Command, Event, Landed, LinkLost, Mode, Position
from companion.mission.health import astray_m
from companion.mission.mission import Mission
from companion.mission.state import IN_AIR, Phase, Reason, State, TakeOver, Trigger, Vehicle
from companion.planner.request import Refusal
from companion.world.zone_index import index_of

Step = tuple[State, list[Command], Trigger | None]
"""The new state, what to do, and what moves the mission to another phase."""

ASK_AGAIN_S = 1.0
GONE_S = 30.0
GONE_IN_AIR_S = 600.0
STOPPED_M_S = 0.5
AT_M = 5.0
BROKEN_OFF = "landing broken off: MISSION_START to the companion lands it"
_HEARTBEAT_S = 5.0  # four or five of them missed (mavlink.md 2.1)
_GROUNDED_S = 1.5
_FENCE_S = 5.0  # between a breach of the fence, and what the autopilot does about it
_SUSPECT_S = 2.5  # somebody with our ids who has said so much may have died meanwhile
_THERE_S = 5.0
_SECOND_S = 5.0  # who hears another so soon after it took over has not been there first


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Context:
    """What stays the same during a mission."""

    mission: Mission
    seed: int
    lockstep: bool = False
    """A simulator waits for each answer: what is silent for long has ended."""
    shadow: bool = False
    """Only watch: plan and say, never command."""


def ask(state: State, *commands: Command) -> Step:
    """Ask for something, once a second."""
    if state.now_s - state.asked_at_s < ASK_AGAIN_S:
        return state, [], None
    return replace(state, asked_at_s=state.now_s, asks=state.asks + 1), list(commands), None


def words(state: State, reason: Reason) -> tuple[str, str]:
    """What there is to say of a reason beyond its own text, and the remedy: the planner's own."""
    if reason is Reason.POSITION_ELSEWHERE:
        return f": {astray_m(state.vehicle):.0f} m away", reason.remedy
    refusal = state.flight.refusal
    if reason is not Reason.NO_PLAN or refusal is None:
        return "", reason.remedy
    why, _, remedy = refusal.value.partition("; ")
    detail = "" if refusal is Refusal.NOTHING_SAFE else f": {why}"  # else it is said twice
    return detail, f"{remedy[:1].upper()}{remedy[1:]}."


def give_up(state: State, reason: Reason, detail: str = "", remedy: str = "") -> Step:
    """End the mission; a vehicle in the air is left in its hold mode, or on its own way home."""
    if not detail:
        detail, remedy = words(state, reason)
    return replace(state, reason=reason, detail=detail, remedy=remedy), [], Trigger.GIVE_UP


def fault(state: State, reason: Reason) -> Step:
    """Stop and hold for a reason."""
    return replace(state, reason=reason), [], Trigger.FAULT


def in_phase_s(state: State) -> float:
    """How long this phase has lasted."""
    return state.now_s - state.since_s


def is_gone(state: State, event: Event, context: Context) -> bool:
    """Whether the vehicle has been silent for too long to hope for it."""
    return isinstance(event, LinkLost) and event.silent_s >= longest_silence_s(state, context)


def longest_silence_s(state: State, context: Context) -> float:
    """How long a silent vehicle is waited for.

    One in the air for long: it may come back with nobody else to look after it.
    """
    return GONE_IN_AIR_S if state.airborne and not context.lockstep else GONE_S


def taken_by(state: State) -> Reason:
    """Who has changed the mode: a person, or the autopilot for its own fence or another failsafe.

    Of the fence it says so, or it acts on a failsafe outside of it (PX4, which tells a companion
    little).  A person who selects hold, return or land in a failsafe looks like the failsafe.
    """
    vehicle = state.vehicle
    if vehicle.mode not in (Mode.HOLD, Mode.RETURN, Mode.LAND):
        return Reason.MODE_TAKEN
    said = 0.0 <= state.now_s - vehicle.fence_breached_at_s < _FENCE_S
    acts = vehicle.driving.streams_first and vehicle.failsafe and _is_out_of_its_fence(state)
    if said or acts:
        return Reason.FENCE_BREACHED
    return Reason.FAILSAFE if vehicle.failsafe else Reason.MODE_TAKEN


def _is_out_of_its_fence(state: State) -> bool:
    """Whether the vehicle is, as far as its position tells, where its own fence forbids it."""
    fence, here = state.fence, state.vehicle.position_nea_m
    if fence is None or here is None:
        return False
    error_m = state.task.error_m
    if fence.ceiling_amsl_m is not None and here[2] > fence.ceiling_amsl_m - error_m:
        return True
    return index_of(fence.zones).nearest(here[0], here[1])[1] < error_m


def is_silent(state: State) -> bool:
    """Whether there are no heartbeats: who flies it is not known then, whatever else it says."""
    return state.now_s - state.vehicle.status_at_s > _HEARTBEAT_S


def _lost_stream(vehicle: Vehicle) -> bool:
    """Whether it holds because setpoints were lost on the way to it (PX4), not for a person."""
    return vehicle.driving.streams_first and vehicle.failsafe and vehicle.mode is Mode.HOLD


def is_grounded(state: State) -> bool:
    """Whether the vehicle has been on the ground for a moment: one such word may be wrong."""
    vehicle = state.vehicle
    on_ground = vehicle.landed is Landed.ON_GROUND
    return on_ground and state.now_s - vehicle.landed_at_s > _GROUNDED_S


def rises(state: State) -> bool:
    """Whether its autopilot's own take-off is ours: nobody else has selected it."""
    return state.phase in (Phase.ARMING, Phase.TAKING_OFF) or isinstance(state.hold, TakeOver)


def is_led(state: State) -> bool:
    """Whether the vehicle flies for us now, so that it has to be put on hold if we end."""
    phase, mode = state.phase, state.vehicle.mode
    flies = state.airborne and phase in (*IN_AIR, Phase.PREPARING, Phase.ARMING)
    ours = mode is Mode.GUIDED or (mode is Mode.TAKE_OFF and rises(state))
    return flies and ours and not came_second(state)


def is_suspected(state: State) -> bool:
    """Whether somebody else with our ids was heard lately, be it what a dead one has left."""
    return 0.0 <= state.now_s - state.namesake_at_s < _SUSPECT_S


def came_second(state: State) -> bool:
    """Whether there certainly is another companion, and this one has not had the vehicle before."""
    is_there = state.namesake and 0.0 <= state.now_s - state.namesake_at_s < _THERE_S
    is_late = not has_led(state) or 0.0 <= state.now_s - state.led_at_s < _SECOND_S
    return is_there and is_late


def has_led(state: State) -> bool:
    """Whether this companion has had the vehicle in the air."""
    return state.led_at_s < math.inf


def because(state: State, reason: Reason) -> State:
    """A hold for another reason, from now on."""
    hold = state.hold if isinstance(state.hold, reason.hold) else reason.hold()
    state = replace(state, reason=reason, hold=hold, since_s=state.now_s)
    return replace(state, asked_at_s=-1e9, asks=0, obeyed=False)


def cannot_fly(
    state: State,
    event: Event,
    modes: tuple[Mode, ...] = (Mode.GUIDED,),
    *,
    stands: bool = False,
) -> Reason | None:
    """Why the flight cannot go on as it is; None: it can.  stands: it may still be on the ground.

    That the vehicle does not do what it is told comes before that its position is not to be
    believed.
    """
    vehicle = state.vehicle
    if isinstance(event, LinkLost) or state.now_s - vehicle.status_at_s > _HEARTBEAT_S:
        return Reason.LINK_LOST
    if not vehicle.armed:
        return Reason.DISARMED
    if vehicle.mode not in modes:
        taken = taken_by(state)
        lost = taken is not Reason.FENCE_BREACHED and _lost_stream(vehicle)
        return Reason.STREAM_LOST if lost else taken
    if not stands and vehicle.landed is Landed.ON_GROUND and is_grounded(state):
        return Reason.GROUNDED
    return vehicle.distrust


def speed_m_s(event: Position) -> float:
    """Speed over all axes."""
    return math.hypot(*event.velocity_nea_m_s)


def is_at_rest(state: State, event: Position) -> bool:
    """Whether the vehicle stands, as far as it can stand."""
    return not state.vehicle.driving.hovers or speed_m_s(event) < STOPPED_M_S
