"""The four tables of the mission machine: read this first, then `machine.step`.

OURS    whose modes are ours: in any other somebody else flies, and nothing is sent
FAULTS  what breaks a phase off: the first that is true, and why it holds or ends then
LADDER  what the vehicle is told, in turn, once the mission is given up
LEAVE   when the vehicle is told to hold as the companion goes
"""

from collections.abc import Callable
from typing import Final

from companion.mission import phases
from companion.mission.decisions import Context, Turn, in_words
from companion.mission.events import Disarm, Event, Landed, LinkLost, Mode, Position, SetMode
from companion.mission.mission import EndAction, Fallback
from companion.mission.phases import GOING_UP, IN_AIR, LED, TAKES_OVER, By, Phase, Reason, Trigger
from companion.mission.state import Goal, State, Way
from companion.mission.vehicle_traits import UNKNOWN, TakeoffSequence
from companion.mission.way_back import is_above_home
from companion.world.zones import nearest

_COMES_BACK_S = 3.0  # PX4 takes a stream up again within a second (px4.md 6)
_LEADS_BACK_S = 30.0  # a link that comes back later finds a vehicle that holds
_FENCE_S = 5.0  # between a breach of the fence, and what the autopilot does about it
_BREACH_S = 5.0  # from what the autopilot does to what it says

# --- 1. whose modes are ours

OURS: Final[dict[Phase | By, tuple[Mode, ...]]] = {
    Phase.TAKING_OFF: (Mode.GUIDED, Mode.TAKE_OFF, Mode.HOLD),
    **dict.fromkeys((*LED, By.SETPOINTS), (Mode.GUIDED,)),
    Phase.LANDING: (Mode.LAND,),
    Phase.HANDING_OVER: (Mode.GUIDED, Mode.HOLD, Mode.TAKE_OFF, Mode.RETURN),
    By.MODE: (Mode.GUIDED, Mode.HOLD),
}
"""Modes in which the vehicle does what we ask, by phase, and by who holds it; what is not named has
let go of it, or has not got it yet."""
_ANY = (*Mode, None)


def is_ours(state: State) -> bool:
    """Whether the vehicle's mode is one of ours."""
    phase, mode, stage = state.phase, state.vehicle.mode, state.stage
    traits = state.vehicle.traits
    if isinstance(stage, phases.Holding):
        if mode is Mode.TAKE_OFF and stage.why.by is By.MODE:
            early = not stage.obeyed and stage.why is not Reason.STREAM_LOST  # has not heard us yet
            return stage.why in TAKES_OVER or (early and still_goes_up(state))
        return mode in OURS.get(stage.why.by, _ANY)
    if phase is Phase.TAKING_OFF and traits.take_off is TakeoffSequence.GUIDED_THEN_CLIMB:
        return mode is Mode.GUIDED
    early = phase is Phase.LANDING and not stage.obeyed
    return mode in OURS.get(phase, _ANY) or (early and mode in (Mode.GUIDED, Mode.HOLD))


def takeover_reason(state: State) -> Reason:
    """Who has changed the mode: the pilot, or the autopilot for its fence or another failsafe.

    A fence breach is reported, or inferred from a failsafe outside of the fence (PX4).  A pilot who
    selects hold, return or land during a failsafe cannot be told from the failsafe.
    """
    vehicle = state.vehicle
    if vehicle.mode not in (Mode.HOLD, Mode.RETURN, Mode.LAND):
        return Reason.MODE_TAKEN
    breach_said = 0.0 <= state.now_s - vehicle.fence_breached_at_s < _FENCE_S
    acts = (
        vehicle.traits.needs_setpoints_before_offboard
        and vehicle.failsafe
        and (_is_out_of_its_fence(state) or _is_held_by_what_it_misreads(state))
    )
    if breach_said or acts:
        return Reason.FENCE_BREACHED
    return Reason.FAILSAFE if vehicle.failsafe else Reason.MODE_TAKEN


def _is_held_by_what_it_misreads(state: State) -> bool:
    """Whether PX4 goes on holding although setpoints come, with a fence that it misreads.

    Where it keeps out then nobody else knows (px4.md 7); a lost stream it would have taken up.
    """
    fence, lost = state.fence, state.held_for is Reason.STREAM_LOST
    return fence is not None and fence.misread and lost and state.in_phase_s > _COMES_BACK_S


def _is_out_of_its_fence(state: State) -> bool:
    """Whether the vehicle's position violates its own fence."""
    fence, position = state.fence, state.vehicle.position_nea_m
    if fence is None or position is None:
        return False
    error_m = state.task.error_m
    if fence.ceiling_amsl_m is not None and position[2] > fence.ceiling_amsl_m - error_m:
        return True
    return nearest(fence.zones, position[0], position[1])[1] < error_m


def still_goes_up(state: State) -> bool:
    """Whether it may still be in the take-off that we asked for, after a fault or a silence."""
    begun = state.armed_by_us and state.flight.plan_id == 0 and not state.taken
    return begun and state.phase in (Phase.PREPARING, Phase.HOLDING)


# --- 2. what breaks a phase off


_UP = (Phase.TAKING_OFF, *LED)
_HELD = (Phase.HOLDING,)
_LEAVES = (Phase.HANDING_OVER,)


def _lost_or_taken(state: State) -> Reason:
    """Who has the vehicle; it may hold by itself for lack of setpoints on the link (PX4)."""
    vehicle, taken = state.vehicle, takeover_reason(state)
    needs_them = vehicle.traits.needs_setpoints_before_offboard
    lost = needs_them and vehicle.failsafe and vehicle.mode is Mode.HOLD
    lost = lost and state.held_by in (None, By.SETPOINTS)
    return Reason.STREAM_LOST if lost and taken is not Reason.FENCE_BREACHED else taken


def is_breach_of_fence(state: State) -> bool:
    """Whether it was the vehicle's fence that took it.

    On PX4 it looks like a loss of setpoints first; and the autopilot knows a fence changed in
    flight before the companion has downloaded it.
    """
    if state.held_for not in (Reason.MODE_TAKEN, Reason.FAILSAFE, Reason.STREAM_LOST):
        return False
    by_itself = state.vehicle.failsafe or state.in_phase_s < _BREACH_S
    return by_itself and takeover_reason(state) is Reason.FENCE_BREACHED


def stays_down(state: State) -> bool:
    """Whether its take-off was broken off on the ground, where it is to stay."""
    return state.reason is Reason.BROKEN_OFF and state.vehicle.landed is Landed.ON_GROUND


def _falls_silent(state: State) -> bool:
    """Without heartbeats for 5 s, whatever else comes; `LinkLost`: 3 s without anything."""
    return state.is_silent and state.held_for is not Reason.LINK_LOST


def _is_led(state: State) -> bool:
    lost_s = state.in_phase_s if state.held_for is Reason.STREAM_LOST else 0.0
    return is_ours(state) and lost_s <= _LEADS_BACK_S


def _holds_as_asked(state: State) -> bool:
    """Whether it does what was asked of it last, at the target."""
    return state.vehicle.mode is Mode.HOLD and state.stage.asked_at_s > state.stage.since_s


_Cause = Reason | Callable[[State], Reason | None] | None
_Sign = Callable[[State, Event], bool]

FAULTS: Final[tuple[tuple[_Cause, tuple[Phase, ...], _Sign], ...]] = (
    (None, (Phase.ARRIVED,), lambda s, _: _holds_as_asked(s)),
    (None, _LEAVES, lambda s, _: s.is_silent or s.vehicle.mode is Mode.RETURN),
    (Reason.FENCE_BREACHED, _HELD, lambda s, e: isinstance(e, Position) and is_breach_of_fence(s)),
    (Reason.LINK_LOST, (*_UP, *_HELD), lambda s, e: isinstance(e, LinkLost) or _falls_silent(s)),
    (None, _HELD, lambda s, _: stays_down(s)),
    (Reason.DISARMED, (*_UP, *_HELD, *_LEAVES), lambda s, _: not s.vehicle.armed),
    (Reason.GROUNDED, (*_HELD, *_LEAVES), lambda s, _: s.is_grounded),
    (_lost_or_taken, (*_UP, *_HELD, *_LEAVES), lambda s, _: not _is_led(s)),
    (Reason.GROUNDED, LED, lambda s, _: s.is_grounded),
    (lambda s: s.vehicle.distrust, _UP, lambda *_: True),
    (lambda s: s.vehicle.distrust, _HELD, lambda s, _: s.held_by is By.SETPOINTS),
)
"""Why a phase is broken off, in which of them that counts, and when it is so; the first that is.
None: it is as it should be, and what comes below does not count.
That the vehicle does not obey comes before a position that is not to be believed."""


def fault_of(state: State, event: Event) -> Reason | None:
    """Why this phase cannot go on; None: it can."""
    for cause, counts_in, is_so in FAULTS:
        if state.phase in counts_in and is_so(state, event):
            return cause(state) if callable(cause) else cause
    return None


# --- 3. what is tried once the mission is given up

LADDER: Final = {
    Fallback.RETURN: (Mode.RETURN, Mode.LAND),
    Fallback.LAND: (Mode.LAND, Mode.RETURN),
    Fallback.HOLD: (),
}
"""What a vehicle is told whose mission is given up: the first that it can do and has not refused;
if there is none it holds, and the operator is asked to take over."""
_BRINGS_DOWN: Final = {
    Mode.LAND: ("landing here", Trigger.END_LAND),
    Mode.RETURN: ("its autopilot is told to return", Trigger.HAND_OVER),
}
"""What is said then, and what requests the mode; given up in the phase after, it was refused."""


def wanted_fallback(state: State, context: Context) -> Fallback:
    """The mission's fallback, or what was ordered or is in progress."""
    if state.goal is Goal.LAND:
        return Fallback.LAND
    ends_there = state.phase is Phase.ARRIVED and context.mission.end_action is EndAction.RETURN
    home = state.goal is Goal.HOME or ends_there or state.flight.way is not Way.OUT
    return Fallback.RETURN if home else context.mission.fallback


def fall_back(state: State, turn: Turn) -> None:
    """Bring down a vehicle whose mission is given up, if we still control it."""
    flight, traits = state.flight, state.vehicle.traits
    fallback = wanted_fallback(state, turn.context)
    if fallback is Fallback.HOLD or traits is UNKNOWN or not _is_left_to_us(state):
        return
    asked = (mode for mode, (_, trigger) in _BRINGS_DOWN.items() if trigger.after is state.phase)
    flight.refused_modes |= {*asked}
    if state.vehicle.distrust is not None or is_above_home(state):
        fallback = Fallback.LAND
    able = {Mode.RETURN, Mode.LAND} if traits.lands else {Mode.RETURN}
    reason = state.reason or Reason.NO_PLAN
    follows = reason is Reason.NOT_OBEYING or flight.homeward
    if follows and flight.fallen_back is not None:
        reason = flight.fallen_back  # that is why it was asked
    flight.fallen_back = reason
    for mode in LADDER[fallback]:
        if mode in able - flight.refused_modes:
            how, trigger = _BRINGS_DOWN[mode]
            turn.warn(f"{in_words(state, reason)}: {how}", "end")
            return turn.to(trigger)


def _is_left_to_us(state: State) -> bool:
    """Whether we are responsible for the vehicle: it flies or holds on our command."""
    vehicle = state.vehicle
    led = state.has_had_control or state.flight.plan_id > 0
    if not led or state.taken or state.is_second_companion or state.reason is Reason.LINK_LOST:
        return False
    if not vehicle.armed or state.is_grounded or state.is_silent:
        return False
    if vehicle.mode is Mode.HOLD:
        return state.phase is not Phase.PREPARING or state.stage.asks > 0
    return _does_as_told(state)


# --- 4. what the vehicle is told when the companion goes


def _does_as_told(state: State) -> bool:
    mode, rises = state.vehicle.mode, state.phase in GOING_UP
    rises = rises or state.held_for in TAKES_OVER or still_goes_up(state)
    return mode is Mode.GUIDED or (mode is Mode.TAKE_OFF and rises)


def _is_to_take_off(state: State) -> bool:
    """On the ground, before it was obeyed, no pilot has taken it."""
    asked, down = (
        state.stage.asks > 0 or state.armed_by_us,
        state.vehicle.landed is Landed.ON_GROUND,
    )
    return asked and (_does_as_told(state) or (not state.stage.obeyed and down))


def _takes_off(state: State) -> bool:
    """It may hold by now, which ends a take-off of its own."""
    by_itself = state.vehicle.traits.take_off is not TakeoffSequence.GUIDED_THEN_CLIMB
    return _does_as_told(state) or (state.vehicle.mode is Mode.HOLD and by_itself)


def _flies(state: State) -> bool:
    """Its last heartbeat may be from before what we asked last."""
    vehicle, holds = state.vehicle, state.vehicle.mode is Mode.HOLD
    if state.held_for is not None and state.reason is Reason.BROKEN_OFF:
        return holds or not vehicle.armed or _does_as_told(state)
    if state.is_grounded:
        return still_goes_up(state) and _takes_off(state)
    obeys = _does_as_told(state) or (holds and state.stage.asks > 0)
    return state.airborne and vehicle.armed and obeys


LEAVE: Final[dict[Phase, Callable[[State], bool]]] = {
    Phase.ARMING: _is_to_take_off,  # left in its take-off mode it would climb once armed
    Phase.PREPARING: _flies,  # after a silence, or a restart
    **dict.fromkeys(IN_AIR, _flies),
    Phase.TAKING_OFF: _takes_off,
}
"""By phase, whether the vehicle does what we asked of it, or will: then it is told to hold when
the companion goes, as it would go on else."""


def is_under_control(state: State) -> bool:
    """Whether the vehicle has to be told to hold if the companion goes."""
    known = state.vehicle.traits is not UNKNOWN and not state.is_second_companion
    return known and state.phase in LEAVE and LEAVE[state.phase](state)


def parting(state: State, *, stopped: bool = False) -> list[SetMode | Disarm]:
    """What the vehicle is told when the companion goes: to hold; on the ground, to stay there.

    stopped: a person wants it; then a landing of ours is broken off, too, which goes on otherwise.
    """
    vehicle = state.vehicle
    if not is_under_control(state):
        lands = state.phase is Phase.LANDING and vehicle.mode is Mode.LAND
        lands = lands and vehicle.armed and not state.is_grounded
        return [SetMode(mode=Mode.HOLD)] if stopped and lands else []
    path = state.path  # on a leg it holds where it is: where it hovered last lies behind
    hovers = vehicle.mode is Mode.GUIDED and (path is None or path.circling)
    at = state.flight.hover_nea_m if hovers else None
    hold = SetMode(mode=Mode.HOLD, at_nea_m=at)
    if state.phase is Phase.ARMING:
        down = vehicle.landed is Landed.ON_GROUND
    else:
        goes_up = state.phase is Phase.TAKING_OFF or still_goes_up(state)
        down = goes_up and state.is_grounded
    # in this order: the first counts should it be in the air by now
    return [hold, Disarm()] if down and state.armed_by_us else [hold]
