"""How a flight ends that cannot go on: on the ground, unless the mission or somebody else says so.

| the vehicle | `fallback` return | land | hold |
|---|---|---|---|
| may still be led, and a way back is proven | flies it, and lands | lands where it is | holds |
| does not do as it is told, or there is no way back | its autopilot's own return | lands | holds |
| is above where it took off, or does not know where it is | lands | lands | holds |
| cannot be told to land (ArduPlane) | its autopilot's own return | the same | holds |

The first line is `stopped`'s; all that gives up besides comes through here (`instead`).  What does
not take one of the two modes is asked for the other; what takes neither is told to hold, and a
person to take over.  It is left where it is if somebody else has it, or is not heard any more, and
where a person, or a part of the companion that has died, has ended the mission.
"""

import math

from msgspec.structs import replace

from companion.mission.decisions import (
    AT_M,
    Context,
    Step,
    ask,
    came_second,
    give_up,
    has_led,
    is_gone,
    is_grounded,
    is_silent,
    rises,
    taken_by,
    words,
)
from companion.mission.driving import UNKNOWN
from companion.mission.events import Event, Mode, Say, SetMode
from companion.mission.mission import EndAction, Fallback
from companion.mission.state import Phase, Reason, State, Trigger

_ASKS = 5  # in vain, once a second


def wanted(state: State, context: Context) -> Fallback:
    """The mission's fallback; what is called home, or is on its way there, is brought home."""
    flight = state.flight
    orders, asked_for = state.orders, Reason.RETURN_ASKED
    asked = asked_for in (state.reason, orders.active, orders.suspended, flight.fallen_back)
    ends_there = state.phase is Phase.ARRIVED and context.mission.end_action is EndAction.RETURN
    home = asked or ends_there or flight.returning or flight.homeward
    return Fallback.RETURN if home else context.mission.fallback


def instead(state: State, context: Context) -> Step:
    """What becomes of a vehicle whose mission is given up: it comes down, if it is left to us."""
    fallback, flight, driving = wanted(state, context), state.flight, state.vehicle.driving
    if fallback is Fallback.HOLD or driving is UNKNOWN or not _is_left_to_us(state):
        return state, [], Trigger.GIVE_UP
    in_vain = flight.in_vain
    if (mode := _MODES.get(state.phase)) is not None:
        in_vain |= {mode}
    lost = state.vehicle.distrust is not None
    lands = fallback is Fallback.LAND or lost or _is_above_home(state)
    order = (Mode.LAND, Mode.RETURN) if lands else (Mode.RETURN, Mode.LAND)
    ways = [
        mode for mode in order if mode not in in_vain and (mode is Mode.RETURN or driving.lands)
    ]
    reason = state.reason or Reason.NO_PLAN
    if reason is Reason.NOT_OBEYING and flight.fallen_back is not None:
        reason = flight.fallen_back  # that is why it was asked
    state = replace(state, flight=replace(flight, fallen_back=reason, in_vain=in_vain))
    if not ways:
        return state, [], Trigger.GIVE_UP
    how = "landing here" if ways[0] is Mode.LAND else "its autopilot is told to return"
    says = Say(text=f"{reason.text}{words(state, reason)[0]}: {how}", warning=True, about="end")
    return state, [says], Trigger.END_LAND if ways[0] is Mode.LAND else Trigger.HAND_OVER


_MODES = {Phase.LANDING: Mode.LAND, Phase.HANDING_OVER: Mode.RETURN}
"""What a phase asks for."""


def _is_left_to_us(state: State) -> bool:
    """Whether nobody else sees to the vehicle: it flies, or holds, because we have said so."""
    vehicle = state.vehicle
    led = has_led(state) or state.flight.plan_id > 0
    if not led or state.taken or came_second(state) or state.reason is Reason.LINK_LOST:
        return False
    if not vehicle.armed or is_grounded(state) or is_silent(state):
        return False
    if vehicle.mode is Mode.HOLD:
        return state.phase is not Phase.PREPARING or state.asks > 0
    return vehicle.mode is Mode.GUIDED or (vehicle.mode is Mode.TAKE_OFF and rises(state))


def _is_above_home(state: State) -> bool:
    home, here = state.vehicle.home_nea_m, state.vehicle.position_nea_m
    if home is None or here is None or not state.vehicle.driving.hovers:
        return False
    return math.dist(home[:2], here[:2]) < max(AT_M, state.task.limits.tracking_error_m)


def handing_over(state: State, event: Event, context: Context) -> Step:
    """Ask for the autopilot's own return until it is taken: from then on the autopilot has it."""
    vehicle = state.vehicle
    if is_gone(state, event, context):
        return give_up(state, Reason.LINK_LOST)
    if is_silent(state):
        return state, [], None
    if vehicle.mode is Mode.RETURN:
        return state, [], Trigger.HANDED_ON
    if not vehicle.armed or is_grounded(state):
        return give_up(state, Reason.GROUNDED if vehicle.armed else Reason.DISARMED)
    if vehicle.mode not in (Mode.GUIDED, Mode.HOLD, Mode.TAKE_OFF):
        return give_up(state, taken_by(state))
    state, asking, _ = ask(state, SetMode(mode=Mode.RETURN))
    return give_up(state, Reason.NOT_OBEYING) if state.asks > _ASKS else (state, asking, None)
