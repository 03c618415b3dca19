"""Who takes the vehicle has it: a person, the autopilot's failsafe, or its own fence, by name.

It is not fought for, and not taken back unasked.
"""

import pytest
from made_up import AWAY, EACH, HOLDS_FOR_SETPOINTS, Craft, flying, moving, position, status, texts
from renewed import deep, replace

from companion.mavlink.autopilots import ARDUCOPTER
from companion.mission.events import FenceBreach, FenceChanged, Mode, OrderKind, Outcome
from companion.mission.phases import Phase, Reason
from companion.mission.stopped import FAILSAFE_OVER
from companion.mission.tables import takeover_reason
from companion.mission.vehicle_traits import VehicleTraits
from companion.world.zones import CircleZone

BY_ITSELF = (Mode.HOLD, Mode.RETURN, Mode.LAND)
"""Modes that a failsafe selects, and a person may."""


def under_way(traits: VehicleTraits = ARDUCOPTER.traits) -> Craft:
    """A copter at speed; a plane about to set out (made-up ones only fly where they are told)."""
    if traits.hovers:
        return flying(AWAY, traits=traits)
    return Craft(AWAY, traits=traits).fly_to(Phase.FLYING)


def taken(traits: VehicleTraits = ARDUCOPTER.traits, mode: Mode = Mode.RETURN) -> Craft:
    """Its failsafe has begun, in the air, and changed the mode."""
    craft = under_way(traits).is_taken(mode, failsafe=True)
    return craft.run_until(lambda craft: craft.state.reason is not None).run_for(0.5)


@EACH
@pytest.mark.parametrize("failsafe", [False, True])
@pytest.mark.parametrize("mode", [Mode.OTHER, *BY_ITSELF], ids=lambda m: m.value)
def test_a_mode_is_a_persons_unless_a_failsafe_may_have_selected_it(
    traits: VehicleTraits, mode: Mode, failsafe: bool
) -> None:
    """PX4's hold in a failsafe may be for want of setpoints: that goes first."""
    craft = under_way(traits).is_taken(mode, failsafe=failsafe).fly_to(Phase.HOLDING)
    by_itself = failsafe and mode is not Mode.OTHER
    if by_itself and traits.needs_setpoints_before_offboard and mode is Mode.HOLD:
        assert craft.state.reason is Reason.STREAM_LOST
        craft.run_for(40.0)
    reason = Reason.FAILSAFE if by_itself else Reason.MODE_TAKEN
    assert craft.state.reason is reason
    assert craft.state.taken
    held = [text for text in texts(craft.commands) if text.startswith("hold: ")]
    assert held[-1] == f"hold: {reason.text}"
    assert len(held) == 1 + (Reason.STREAM_LOST in {after.reason for *_, after, _ in craft.steps})


# --- by a failsafe


@EACH
@pytest.mark.parametrize("restarts", [False, True])
def test_when_it_is_over_it_says_once_how_to_go_on_and_goes_on_only_then(
    traits: VehicleTraits, restarts: bool
) -> None:
    """That its autopilot holds again does not mean that nobody else flies it; after a restart, too.

    It is said once the position is trusted again.
    """
    craft = taken(traits)
    if restarts:
        assert craft.restart().run_for(20.0).state.reason is Reason.FAILSAFE
    craft.fix = False
    craft.run_for(5.0)
    craft.failsafe, craft.mode = False, Mode.HOLD
    count = len(craft.commands)
    craft.run_for(5.0)
    assert FAILSAFE_OVER not in texts(craft.commands)
    craft.fix = True
    later = craft.run_for(100.0).commands[count:]
    assert texts(later) == [FAILSAFE_OVER]
    assert not moving(later)
    assert (craft.phase, craft.state.reason) == (Phase.HOLDING, Reason.FAILSAFE)
    craft.obeys_modes = True
    craft.order(OrderKind.START).fly_to(Phase.FLYING)
    assert not traits.hovers or craft.fly_to(Phase.DONE).end().outcome is Outcome.ARRIVED


# --- by its own fence


def aloft(traits: VehicleTraits) -> Craft:
    """On its path; the driving of another autopilot is put under it in flight."""
    craft = flying()
    craft.state = replace(craft.state, vehicle=replace(craft.state.vehicle, traits=traits))
    return craft


def fence(craft: Craft, *, around: bool, misread: bool = False) -> FenceChanged:
    """About the vehicle, or 7 km away."""
    north, east = craft.here[:2] if around else (5_000.0, -5_000.0)
    zone = CircleZone(name="new", north_m=north, east_m=east, radius_m=200.0 if around else 50.0)
    return FenceChanged(time_s=craft.now_s, zones=(zone,), misread=misread)


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


@pytest.mark.parametrize(("ago_s", "is_why"), [(2.0, True), (6.0, False), (-1.0, False)])
def test_only_what_it_has_just_said_of_its_fence_is_why(ago_s: float, is_why: bool) -> None:
    state = aloft(ARDUCOPTER.traits).state
    vehicle = replace(state.vehicle, mode=Mode.RETURN, fence_breached_at_s=1_000.0 - ago_s)
    found = takeover_reason(replace(state, now_s=1_000.0, vehicle=vehicle))
    assert found is (Reason.FENCE_BREACHED if is_why else Reason.MODE_TAKEN)


@EACH
def test_it_may_say_so_after_it_has_acted_and_a_person_who_takes_over_is_a_person(
    traits: VehicleTraits,
) -> None:
    """Inside a fence, and by stick and rudder after a breach."""
    late, inside, by_stick = (aloft(traits) for _ in range(3))
    late.take(status(late.now_s, Mode.RETURN))
    knowing(inside, fence(inside, around=True)).take(status(inside.now_s, Mode.HOLD))
    by_stick.take(FenceBreach(time_s=by_stick.now_s), status(by_stick.now_s, Mode.OTHER))
    assert [it.state.reason for it in (late, inside, by_stick)] == [Reason.MODE_TAKEN] * 3
    late.take(FenceBreach(time_s=late.now_s))
    assert late.state.reason is Reason.FENCE_BREACHED


@HOLDS_FOR_SETPOINTS
@pytest.mark.parametrize("around", [True, False])
@pytest.mark.parametrize("known", [True, False])
def test_px4_tells_a_companion_of_no_fence_but_is_in_it_and_in_a_failsafe(
    traits: VehicleTraits, known: bool, around: bool
) -> None:
    """The fence may be read only after the autopilot holds for it; elsewhere it lost the stream."""
    craft = aloft(traits)
    drawn = fence(craft, around=around)
    if known:
        knowing(craft, drawn)
    craft.take(replace(status(craft.now_s, Mode.HOLD), failsafe=True))
    at_once = Reason.FENCE_BREACHED if known and around else Reason.STREAM_LOST
    assert craft.state.reason is at_once
    if not known:
        craft.take(drawn)
    craft.take(position(craft.now_s + 0.1, craft.here))
    assert craft.state.reason is (Reason.FENCE_BREACHED if around else Reason.STREAM_LOST)
    assert craft.state.taken is around


@HOLDS_FOR_SETPOINTS
@pytest.mark.parametrize("misread", [True, False])
def test_what_px4_misreads_of_its_fence_is_the_reason_where_no_zone_is(
    traits: VehicleTraits, misread: bool
) -> None:
    """A lost stream it would have taken up again; and nobody knows where it keeps out."""
    craft = aloft(traits)
    knowing(craft, fence(craft, around=False, misread=misread))
    craft.mode, craft.failsafe = Mode.HOLD, True
    craft.run_for(10.0)
    assert craft.state.reason is (Reason.FENCE_BREACHED if misread else Reason.STREAM_LOST)
    assert craft.state.taken is misread
