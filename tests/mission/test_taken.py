"""Who takes the vehicle has it: a person, the autopilot's failsafe, or its own fence, by name.

It is not fought for, and not taken back unasked; and a fence that changes is kept to from then on.
"""

import json
import math

import pytest
from made_up import (
    AWAY,
    EACH,
    HOLDS_FOR_SETPOINTS,
    MISSION,
    Craft,
    flying,
    moving,
    now,
    status,
    texts,
    told,
)
from renewed import deep, replace

from companion.mission import checkpoint
from companion.mission.events import (
    FenceBreach,
    FenceChanged,
    Mode,
    OrderKind,
    Outcome,
    Plan,
    Setpoint,
    StatusText,
)
from companion.mission.phases import Phase, Reason
from companion.mission.state import Way
from companion.mission.stopped import FAILSAFE_OVER
from companion.mission.tables import takeover_reason
from companion.mission.vehicle_traits import VehicleTraits
from companion.world.zones import CircleZone

BY_ITSELF = (Mode.HOLD, Mode.RETURN, Mode.LAND)
"""Modes that a failsafe selects, and a person may."""


def taken(traits: VehicleTraits, mode: Mode, *, failsafe: bool) -> Craft:
    """A copter at speed; a plane about to set out (made-up ones only fly where they are told)."""
    craft = flying(AWAY, traits=traits) if traits.hovers else Craft(AWAY, traits=traits)
    return craft.fly_to(Phase.FLYING).is_taken(mode, failsafe=failsafe).fly_to(Phase.HOLDING)


@EACH
@pytest.mark.parametrize("failsafe", [False, True])
@pytest.mark.parametrize("mode", [Mode.OTHER, *BY_ITSELF], ids=lambda m: m.value)
def test_a_mode_is_a_persons_unless_a_failsafe_may_have_selected_it(
    traits: VehicleTraits, mode: Mode, failsafe: bool
) -> None:
    """PX4's hold in a failsafe may be for want of setpoints: that goes first."""
    craft = taken(traits, mode, failsafe=failsafe)
    by_itself = failsafe and mode is not Mode.OTHER
    reasons = [Reason.FAILSAFE if by_itself else Reason.MODE_TAKEN]
    if by_itself and traits.needs_setpoints_before_offboard and mode is Mode.HOLD:
        reasons = [Reason.STREAM_LOST, *reasons]
    craft.run_for(40.0 * (len(reasons) - 1))
    assert craft.state.taken
    held = [text for text in texts(craft.commands) if text.startswith("hold: ")]
    assert held == [f"hold: {reason.text}" for reason in reasons]


@EACH
@pytest.mark.parametrize("restarts", [False, True])
def test_when_a_failsafe_is_over_it_says_once_how_to_go_on_and_goes_on_only_then(
    traits: VehicleTraits, restarts: bool
) -> None:
    """That its autopilot holds again does not mean that nobody else flies it; after a restart, too.

    It is said once the position is trusted again.
    """
    craft = taken(traits, Mode.RETURN, failsafe=True)
    if restarts:
        told(craft, Craft.restart, 20.0, Reason.FAILSAFE)
    told(craft, now(fix=False), 5.0, now(failsafe=False, mode=Mode.HOLD))
    assert FAILSAFE_OVER not in texts(craft.during(5.0))
    craft.fix = True
    later = craft.during(100.0)
    assert texts(later) == [FAILSAFE_OVER]
    assert not moving(later)
    assert (craft.phase, craft.state.reason) == (Phase.HOLDING, Reason.FAILSAFE)
    told(craft, now(obeys_modes=True), OrderKind.START, Phase.FLYING)
    assert not traits.hovers or craft.fly_to(Phase.DONE).end().outcome is Outcome.ARRIVED


# --- by its own fence


def aloft(traits: VehicleTraits) -> Craft:
    """On its path; the driving of another autopilot is put under it in flight."""
    craft = flying()
    craft.state = replace(craft.state, vehicle=replace(craft.state.vehicle, traits=traits))
    return craft


def drawn(craft: Craft, place_ne_m: tuple[float, ...], radius_m: float) -> FenceChanged:
    north, east = place_ne_m
    zone = CircleZone(name="drawn", north_m=north, east_m=east, radius_m=radius_m)
    return FenceChanged(time_s=craft.now_s, zones=(zone,))


def knowing(craft: Craft, known: FenceChanged) -> Craft:
    craft.state = deep(craft.state)
    craft.state.take_fence(craft.context.mission.task, known)
    return craft


@EACH
@pytest.mark.parametrize("mode", BY_ITSELF, ids=lambda m: m.value)
def test_what_the_autopilot_does_after_it_has_said_that_its_fence_is_breached(
    traits: VehicleTraits, mode: Mode
) -> None:
    """It is given back by a word, as the remedy says."""
    craft = aloft(traits)
    craft.take(FenceBreach(time_s=craft.now_s))
    assert craft.phase is Phase.FLYING  # GF_ACTION may be a warning only
    commands = craft.take(status(craft.now_s, mode))
    assert craft.state.taken
    assert not moving(commands)
    assert texts(commands) == [f"hold: {Reason.FENCE_BREACHED.text}"]
    assert "MISSION_START" in Reason.FENCE_BREACHED.remedy
    craft.order(OrderKind.START)
    assert craft.state.stage.released_at_s == craft.now_s


@EACH
def test_it_may_say_so_after_it_has_acted_and_a_person_who_takes_over_is_a_person(
    traits: VehicleTraits,
) -> None:
    """Inside a fence, by stick and rudder after a breach, and long after the last that was said."""
    late, inside, by_stick = (aloft(traits) for _ in range(3))
    late.take(status(late.now_s, Mode.RETURN))
    knowing(inside, drawn(inside, inside.here[:2], 200.0)).take(status(inside.now_s, Mode.HOLD))
    by_stick.take(FenceBreach(time_s=by_stick.now_s), status(by_stick.now_s, Mode.OTHER))
    assert [it.state.reason for it in (late, inside, by_stick)] == [Reason.MODE_TAKEN] * 3
    late.take(FenceBreach(time_s=late.now_s))
    assert late.state.reason is Reason.FENCE_BREACHED
    for ago_s, why in ((2.0, Reason.FENCE_BREACHED), (6.0, Reason.MODE_TAKEN)):
        breached_at_s = late.now_s - ago_s
        vehicle = replace(late.state.vehicle, fence_breached_at_s=breached_at_s)
        assert takeover_reason(replace(late.state, vehicle=vehicle)) is why


@HOLDS_FOR_SETPOINTS
@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize(
    ("around", "misread", "why"),
    [
        (True, False, Reason.FENCE_BREACHED),
        (False, False, Reason.STREAM_LOST),
        (False, True, Reason.FENCE_BREACHED),
    ],
)
def test_px4_tells_a_companion_of_no_fence_but_is_in_it_or_misreads_it_and_in_a_failsafe(
    traits: VehicleTraits, known: bool, around: bool, misread: bool, why: Reason
) -> None:
    """The fence may be read only after the autopilot holds for it; elsewhere it lost the stream.

    Nobody knows where PX4 keeps out what it misreads.
    """
    craft = aloft(traits)
    place_ne_m = craft.here[:2] if around else (5_000.0, -5_000.0)
    fence = replace(drawn(craft, place_ne_m, 200.0), misread=misread)
    if known:
        knowing(craft, fence)
    craft.mode, craft.failsafe = Mode.HOLD, True
    craft.fly_to(Phase.HOLDING)
    assert craft.state.reason is (why if known and around else Reason.STREAM_LOST)
    craft.take(fence)
    assert craft.run_for(10.0).state.reason is why
    assert craft.state.taken is (why is Reason.FENCE_BREACHED)


# --- a fence that is changed in flight; while it is read: `test_stories`

AHEAD_NE_M = (10_000.0 * math.sqrt(0.5), 10_000.0 * math.sqrt(0.5))
"""On the first leg."""


@pytest.mark.parametrize("is_ahead", [True, False])
def test_a_fence_across_the_path_or_around_it_stops_the_vehicle_and_plans_anew(
    is_ahead: bool,
) -> None:
    """Clear of the one ahead, and out of the one around it."""
    craft = flying()
    place, radius_m = (AHEAD_NE_M, 500.0) if is_ahead else (craft.here[:2], 200.0)
    craft.obey(craft.take(drawn(craft, place, radius_m)))
    assert craft.fly_to(Phase.HOLDING).state.reason is Reason.NEW_THREAT
    clear_m = radius_m + MISSION.task.zone_clearance_m
    assert not is_ahead or math.dist(craft.here[:2], place) > clear_m
    craft.run_until(lambda craft: len(craft.sent(Plan)) == 2)
    assert craft.sent(Plan)[-1].request.from_rest


def test_a_fence_on_the_way_back_of_a_vehicle_that_is_paused_leaves_it_led() -> None:
    """In guided mode silence is a lost stream, whatever has become of the way back."""
    craft = flying()
    leg = craft.state.leg
    craft.order(OrderKind.PAUSE).fly_to(Phase.HOLDING)
    flight = craft.state.flight
    assert flight.hover_nea_m is not None
    craft.state = replace(craft.state, flight=replace(flight, way=Way.BACK, back=(leg,)))
    craft.take(drawn(craft, AHEAD_NE_M, 500.0))
    assert craft.state.flight.hover_nea_m == flight.hover_nea_m
    assert any(isinstance(command, Setpoint) for command in craft.during(2.0))
    assert craft.state.reason is Reason.PAUSED


def test_a_fence_that_does_not_touch_the_path_changes_the_next_plan_and_the_band_only() -> None:
    craft = flying()
    before = craft.state.flight
    low = replace(drawn(craft, (4_000.0, -4_000.0), 500.0), ceiling_amsl_m=4_000.0)
    commands = craft.take(low)
    assert craft.state.flight == before
    assert [type(command) for command in commands] == [StatusText]
    craft.run_until(lambda craft: len(craft.sent(Plan)) == 2)
    task = craft.sent(Plan)[-1].request.task
    assert "drawn" in {zone.name for zone in task.zones}
    assert task.limits.ceiling_amsl_m == 4_000.0
    craft.take(FenceChanged(time_s=craft.now_s, zones=()))
    assert craft.state.task.limits == MISSION.task.limits


def test_a_fence_that_a_path_leads_out_of_stops_nobody_told_again_or_after_a_restart() -> None:
    """But what was proven for another mission is proven for none."""
    craft = flying()
    around = drawn(craft, craft.here[:2], 200.0)
    state = deep(craft.state)
    state.take_fence(craft.context.mission.task, around)
    leg = replace(state.leg, rules=state.task)
    craft.state = before = replace(state, path=replace(state.path, leg=leg))
    craft.take(replace(around, time_s=craft.now_s + 1.0))
    assert craft.state.task is before.task
    assert (craft.state.stage, craft.state.flight) == (before.stage, before.flight)
    craft.take(FenceChanged(time_s=craft.now_s, zones=(*around.zones, *around.zones)))
    assert craft.state.path.stop is None
    values = json.loads(json.dumps(checkpoint.values_of(before)))
    again = checkpoint.restored(MISSION, before.flight.known, values)
    assert again.leg.rules == again.task == before.task
    stricter = replace(MISSION.task.limits, dead_man_s=9.0)
    other = replace(MISSION, task=replace(MISSION.task, limits=stricter))
    again = checkpoint.restored(other, before.flight.known, values)
    assert again.leg.rules == other.task.unruled()
