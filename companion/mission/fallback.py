"""Fallback of a flight that cannot go on: on the ground, unless mission or pilot decide otherwise.

| the vehicle | `fallback` return | land | hold |
|---|---|---|---|
| may still be led, and a way home is proven | flies it, and lands | lands where it is | holds |
| does not do as it is told, or there is no way back | its autopilot's own return | lands | holds |
| is above where it took off, or does not know where it is | lands | lands | holds |
| cannot be told to land (ArduPlane) | its autopilot's own return | the same | holds |

The first line is handled by `stopped`; all other cases come through here (`fall_back`).  If the
vehicle rejects one of the two modes the other is requested; if it rejects both, hold is requested
and the operator asked to take over.  It is left alone if a pilot has control or it is silent, and
if the operator or a dead part of the companion has ended the mission.
"""

from msgspec.structs import replace

from companion.mission.decisions import (
    Context,
    Step,
    ask,
    give_up,
    has_had_control,
    is_gone,
    is_grounded,
    is_own_takeoff,
    is_second_companion,
    is_silent,
    reason_text,
    takeover_reason,
)
from companion.mission.events import Event, Mode, SetMode, StatusText
from companion.mission.home import is_above_home
from companion.mission.mission import EndAction, Fallback
from companion.mission.state import Phase, Reason, State, Trigger
from companion.mission.vehicle_traits import UNKNOWN

_ASKS = 5  # in vain, once a second


def wanted_fallback(state: State, context: Context) -> Fallback:
    """The mission's fallback, or what was ordered or is in progress."""
    flight, orders = state.flight, state.orders
    ordered = (state.reason, orders.active, orders.suspended)
    asked = Reason.RETURN_ASKED in (*ordered, flight.fallen_back)
    landing = flight.fallen_back is Reason.LAND_ASKED and not asked
    if landing or Reason.LAND_ASKED in ordered:
        return Fallback.LAND
    ends_there = state.phase is Phase.ARRIVED and context.mission.end_action is EndAction.RETURN
    home = asked or ends_there or flight.returning or flight.homeward
    return Fallback.RETURN if home else context.mission.fallback


def fall_back(state: State, context: Context) -> Step:
    """Bring down a vehicle whose mission is given up, if we still control it."""
    fallback, flight, traits = wanted_fallback(state, context), state.flight, state.vehicle.traits
    if fallback is Fallback.HOLD or traits is UNKNOWN or not _is_left_to_us(state):
        return state, [], Trigger.GIVE_UP
    refused_modes = flight.refused_modes
    if (mode := _MODES.get(state.phase)) is not None:
        refused_modes |= {mode}
    lost = state.vehicle.distrust is not None
    lands = fallback is Fallback.LAND or lost or is_above_home(state)
    order = (Mode.LAND, Mode.RETURN) if lands else (Mode.RETURN, Mode.LAND)
    ways = [
        mode
        for mode in order
        if mode not in refused_modes and (mode is Mode.RETURN or traits.lands)
    ]
    reason = state.reason or Reason.NO_PLAN
    follows = reason is Reason.NOT_OBEYING or flight.homeward
    if follows and flight.fallen_back is not None:
        reason = flight.fallen_back  # that is why it was asked
    state = replace(state, flight=replace(flight, fallen_back=reason, refused_modes=refused_modes))
    if not ways:
        return state, [], Trigger.GIVE_UP
    how = "landing here" if ways[0] is Mode.LAND else "its autopilot is told to return"
    says = StatusText(
        text=f"{reason.text}{reason_text(state, reason)[0]}: {how}", warning=True, about="end"
    )
    return state, [says], Trigger.END_LAND if ways[0] is Mode.LAND else Trigger.HAND_OVER


_MODES = {Phase.LANDING: Mode.LAND, Phase.HANDING_OVER: Mode.RETURN}
"""The mode that a phase requests."""


def _is_left_to_us(state: State) -> bool:
    """Whether we are responsible for the vehicle: it flies or holds on our command."""
    vehicle = state.vehicle
    led = has_had_control(state) or state.flight.plan_id > 0
    if not led or state.taken or is_second_companion(state) or state.reason is Reason.LINK_LOST:
        return False
    if not vehicle.armed or is_grounded(state) or is_silent(state):
        return False
    if vehicle.mode is Mode.HOLD:
        return state.phase is not Phase.PREPARING or state.asks > 0
    return vehicle.mode is Mode.GUIDED or (vehicle.mode is Mode.TAKE_OFF and is_own_takeoff(state))


def handing_over(state: State, event: Event, context: Context) -> Step:
    """Request RTL until the autopilot takes it; from then on the autopilot is in control."""
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
        return give_up(state, takeover_reason(state))
    state, asking, _ = ask(state, SetMode(mode=Mode.RETURN))
    return give_up(state, Reason.NOT_OBEYING) if state.asks > _ASKS else (state, asking, None)
