"""The autopilot's own fence stops the vehicle: the true reason for a person, and what to do."""

import math

import pytest
from made_up import (
    EACH,
    Craft,
    each_of,
    flying,
    mission,
    moving,
    position,
    status,
    texts,
    two_legs_away,
)
from renewed import deep, replace
from wild import Wild

from companion.mavlink.autopilots import ALL, PX4_FIXED_WING, PX4_MULTICOPTER
from companion.mission import events
from companion.mission.events import End, FenceBreach, FenceChanged, FenceReading, Mode
from companion.mission.state import Phase, Reason
from companion.mission.tables import takeover_reason
from companion.mission.vehicle_traits import VehicleTraits
from companion.path.envelope import flown_on_m
from companion.world.zones import CircleZone

PX4S = each_of(PX4_MULTICOPTER.traits, PX4_FIXED_WING.traits)
RETURN, HOLD = Mode.RETURN, Mode.HOLD


def aloft(traits: VehicleTraits) -> Craft:
    """On its path; the driving of another autopilot is put under it in flight."""
    craft = flying()
    vehicle = replace(craft.state.vehicle, traits=traits)
    craft.state = replace(craft.state, vehicle=vehicle)
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


def reason(craft: Craft) -> Reason | None:
    assert craft.state.phase is Phase.HOLDING
    return craft.state.reason


@EACH
@pytest.mark.parametrize("mode", [HOLD, RETURN, Mode.LAND], ids=lambda m: m.value)
def test_what_the_autopilot_does_after_it_has_said_that_its_fence_is_breached(
    traits: VehicleTraits, mode: Mode
) -> None:
    """It is given back by a word, as the remedy says."""
    craft = aloft(traits)
    craft.take(FenceBreach(time_s=craft.now_s))
    assert craft.state.phase is Phase.FLYING  # GF_ACTION may be a warning only
    commands = craft.take(status(craft.now_s, mode))
    assert reason(craft) is Reason.FENCE_BREACHED
    assert craft.state.taken
    assert not moving(commands)
    assert texts(commands) == [f"hold: {Reason.FENCE_BREACHED.text}"]
    assert "MISSION_START" in Reason.FENCE_BREACHED.remedy
    craft.take(events.Order(time_s=craft.now_s, kind=events.OrderKind.START))
    assert craft.state.stage.released_at_s == craft.now_s


@pytest.mark.parametrize(("ago_s", "is_why"), [(2.0, True), (6.0, False), (-1.0, False)])
def test_only_what_it_has_just_said_of_its_fence_is_why(ago_s: float, is_why: bool) -> None:
    state = aloft(ALL[0].traits).state
    vehicle = replace(state.vehicle, mode=RETURN, fence_breached_at_s=1_000.0 - ago_s)
    found = takeover_reason(replace(state, now_s=1_000.0, vehicle=vehicle))
    assert found is (Reason.FENCE_BREACHED if is_why else Reason.MODE_TAKEN)


@EACH
def test_it_may_say_so_after_it_has_acted(traits: VehicleTraits) -> None:
    craft = aloft(traits)
    craft.take(status(craft.now_s, RETURN))
    assert reason(craft) is Reason.MODE_TAKEN
    craft.take(FenceBreach(time_s=craft.now_s))
    assert reason(craft) is Reason.FENCE_BREACHED


@EACH
def test_a_person_who_takes_over_is_a_person(traits: VehicleTraits) -> None:
    """Inside a fence, and by stick and rudder after a breach."""
    craft = aloft(traits)
    knowing(craft, fence(craft, around=True)).take(status(craft.now_s, HOLD))
    assert reason(craft) is Reason.MODE_TAKEN
    craft = aloft(traits)
    craft.take(FenceBreach(time_s=craft.now_s), status(craft.now_s, Mode.OTHER))
    assert reason(craft) is Reason.MODE_TAKEN


@PX4S
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
    craft.take(replace(status(craft.now_s, HOLD), failsafe=True))
    assert reason(craft) is (Reason.FENCE_BREACHED if known and around else Reason.STREAM_LOST)
    if not known:
        craft.take(drawn)
    craft.take(position(craft.now_s + 0.1, craft.here))
    assert reason(craft) is (Reason.FENCE_BREACHED if around else Reason.STREAM_LOST)
    assert craft.state.taken is around


@PX4S
@pytest.mark.parametrize("misread", [True, False])
def test_what_px4_misreads_of_its_fence_is_the_reason_where_no_zone_is(
    traits: VehicleTraits, misread: bool
) -> None:
    """A lost stream it would have taken up again; and nobody knows where it keeps out."""
    craft = aloft(traits)
    knowing(craft, fence(craft, around=False, misread=misread))
    craft.mode, craft.failsafe = HOLD, True
    craft.run_for(10.0)
    assert reason(craft) is (Reason.FENCE_BREACHED if misread else Reason.STREAM_LOST)
    assert craft.state.taken is misread


# --- a fence that is being read


def changed(craft: Craft, items: int = 5010) -> list[str]:
    return texts(craft.take(FenceReading(time_s=craft.now_s, items=items)))


def read(craft: Craft) -> None:
    craft.take(FenceChanged(time_s=craft.now_s, zones=()))
    craft.take(FenceReading(time_s=craft.now_s, items=0))


def test_a_changed_fence_is_told_at_once_and_held_for_until_it_is_read() -> None:
    craft = flying(two_legs_away())
    assert changed(craft) == ["the fence has changed: reading 5,010 items"]
    began_s, here = craft.now_s, craft.here
    craft.run_until(lambda craft: craft.phase is Phase.HOLDING, 60.0)
    limits = craft.state.task.limits
    went_m = math.dist(here, craft.here)
    assert went_m <= flown_on_m(craft.state.task.envelope, limits.speed_m_s)
    assert reason(craft) is Reason.FENCE_UNREAD
    craft.run_for(153.0)
    assert reason(craft) is Reason.FENCE_UNREAD
    assert craft.state.flight.failures == 0
    read(craft)
    craft.run_until(lambda craft: craft.phase is Phase.FLYING, 30.0)
    assert craft.now_s > began_s + 153.0


def test_a_fence_that_cannot_be_read_to_its_end_ends_the_mission_and_not_the_way_back() -> None:
    """Who does not answer is asked for ever: the hold would never end."""
    craft = flying(two_legs_away())
    changed(craft)
    craft.run_until(lambda craft: craft.phase is Phase.HOLDING, 60.0)
    craft.run_until(lambda craft: craft.phase is not Phase.HOLDING, 320.0)
    craft.fly_to(Phase.DONE)
    assert Reason.FENCE_UNREAD.text in craft.end().reason


def test_a_few_items_are_read_in_flight_and_who_says_so_flies_on_meanwhile() -> None:
    craft = flying(two_legs_away())
    changed(craft, 9)
    read(craft.run_for(2.0))
    assert craft.run_for(20.0).phase is Phase.FLYING
    craft = flying(two_legs_away(mission(goes_on_while_reading=True)))
    assert changed(craft)
    assert craft.run_for(20.0).phase is Phase.FLYING


@EACH
def test_copters_hold_and_planes_circle_while_it_is_read(traits: VehicleTraits) -> None:
    it = Wild.calmly(traits).run_until(lambda it: it.state.leg is not None)
    it.run_for(2.0)
    it.take(FenceReading(time_s=it.now_s, items=400))
    it.run_for(60.0)
    assert (it.state.phase, it.state.reason) == (Phase.HOLDING, Reason.FENCE_UNREAD)
    it.take(FenceReading(time_s=it.now_s, items=0))
    it.fly_to(Phase.DONE)
    assert it.sent(End)[0].outcome is events.Outcome.ARRIVED


def test_a_return_that_waits_for_an_unread_fence_says_so_and_is_flown_in_the_end() -> None:
    craft = flying(two_legs_away())
    changed(craft)
    craft.run_until(lambda craft: craft.phase is Phase.HOLDING, 60.0)
    told = craft.take(events.Order(time_s=craft.now_s, kind=events.OrderKind.RETURN))
    assert "it returns once the changed fence is read" in " ".join(texts(told))
    craft.run_for(100.0)
    assert craft.phase is Phase.HOLDING
    craft.run_until(lambda craft: craft.phase is not Phase.HOLDING, 320.0)


def test_the_way_back_waits_too_but_not_with_an_empty_battery() -> None:
    craft = flying(two_legs_away())
    low = replace(craft.state.orders, active=Reason.BATTERY_LOW)
    craft.state = replace(craft.state, orders=low)
    changed(craft)
    craft.run_for(10.0)
    assert craft.phase is Phase.FLYING
