"""The autopilot's own fence stops the vehicle: the true reason for a person, and what to do."""

import math

import pytest
from made_up import Craft, flying, mission, position, status, two_legs_away
from renewed import replace
from wild import Wild

from companion.mavlink.autopilots import ALL, ARDUCOPTER, PX4_FIXED_WING, PX4_MULTICOPTER
from companion.mission import events
from companion.mission.decisions import takeover_reason
from companion.mission.events import End, FenceBreach, FenceChanged, FenceReading, Mode, StatusText
from companion.mission.state import Phase, Reason
from companion.mission.vehicle_traits import VehicleTraits
from companion.path.envelope import flown_on_m
from companion.world.zones import CircleZone

PX4S = pytest.mark.parametrize(
    "traits", [PX4_MULTICOPTER.traits, PX4_FIXED_WING.traits], ids=lambda d: d.name
)
ALL_FOUR = pytest.mark.parametrize("traits", [each.traits for each in ALL], ids=lambda d: d.name)


def aloft(traits: VehicleTraits) -> Craft:
    """On its path; the driving of another autopilot is put under it in flight."""
    craft = flying()
    vehicle = replace(craft.state.vehicle, traits=traits)
    craft.state = replace(craft.state, vehicle=vehicle)
    return craft


def failsafe(craft: Craft, mode: Mode = Mode.HOLD) -> events.VehicleStatus:
    return events.VehicleStatus(time_s=craft.now_s, mode=mode, armed=True, failsafe=True)


def around(craft: Craft, radius_m: float = 200.0) -> FenceChanged:
    north, east, _ = craft.here
    zone = CircleZone(name="new", north_m=north, east_m=east, radius_m=radius_m)
    return FenceChanged(time_s=craft.now_s, zones=(zone,))


def reason(craft: Craft) -> Reason | None:
    assert craft.state.phase is Phase.HOLDING
    return craft.state.reason


@ALL_FOUR
@pytest.mark.parametrize("mode", [Mode.HOLD, Mode.RETURN, Mode.LAND], ids=lambda m: m.value)
def test_what_the_autopilot_does_after_it_has_said_that_its_fence_is_breached(
    traits: VehicleTraits, mode: Mode
) -> None:
    craft = aloft(traits)
    craft.take(FenceBreach(time_s=craft.now_s))
    assert craft.state.phase is Phase.FLYING  # GF_ACTION may be a warning only
    commands = craft.take(status(craft.now_s, mode))
    assert reason(craft) is Reason.FENCE_BREACHED
    assert craft.state.taken
    assert not [c for c in commands if isinstance(c, events.SetMode | events.Setpoint)]
    assert [c.text for c in commands if isinstance(c, StatusText)] == [
        f"hold: {Reason.FENCE_BREACHED.text}"
    ]


@pytest.mark.parametrize(("ago_s", "is_why"), [(2.0, True), (6.0, False), (-1.0, False)])
def test_only_what_it_has_just_said_of_its_fence_is_why(ago_s: float, is_why: bool) -> None:
    state = aloft(ALL[0].traits).state
    vehicle = replace(state.vehicle, mode=Mode.RETURN, fence_breached_at_s=1_000.0 - ago_s)
    found = takeover_reason(replace(state, now_s=1_000.0, vehicle=vehicle))
    assert found is (Reason.FENCE_BREACHED if is_why else Reason.MODE_TAKEN)


@ALL_FOUR
def test_it_may_say_so_after_it_has_acted(traits: VehicleTraits) -> None:
    craft = aloft(traits)
    craft.take(status(craft.now_s, Mode.RETURN))
    assert reason(craft) is Reason.MODE_TAKEN
    craft.take(FenceBreach(time_s=craft.now_s))
    assert reason(craft) is Reason.FENCE_BREACHED


@PX4S
def test_px4_tells_a_companion_of_no_fence_but_is_in_it_and_in_a_failsafe(
    traits: VehicleTraits,
) -> None:
    """The fence is drawn, the autopilot holds, and only then has the companion read it."""
    craft = aloft(traits)
    craft.take(failsafe(craft))
    assert reason(craft) is Reason.STREAM_LOST
    craft.take(around(craft))
    craft.take(position(craft.now_s + 0.1, craft.here))
    assert reason(craft) is Reason.FENCE_BREACHED
    assert craft.state.taken


@PX4S
def test_a_fence_that_it_knew_is_the_reason_from_the_beginning(traits: VehicleTraits) -> None:
    craft = aloft(traits)
    fence = around(craft)
    craft.state = craft.state.with_fence(craft.context.mission.task, fence)
    craft.take(failsafe(craft))
    assert reason(craft) is Reason.FENCE_BREACHED


@PX4S
def test_a_lost_stream_away_from_any_fence_is_a_lost_stream(traits: VehicleTraits) -> None:
    craft = aloft(traits)
    far = CircleZone(name="far", north_m=5_000.0, east_m=-5_000.0, radius_m=50.0)
    fence = FenceChanged(time_s=craft.now_s, zones=(far,))
    craft.state = craft.state.with_fence(craft.context.mission.task, fence)
    craft.take(failsafe(craft))
    craft.take(position(craft.now_s + 0.1, craft.here))
    assert reason(craft) is Reason.STREAM_LOST


@ALL_FOUR
def test_a_person_who_takes_over_inside_a_fence_is_a_person(traits: VehicleTraits) -> None:
    craft = aloft(traits)
    craft.state = craft.state.with_fence(craft.context.mission.task, around(craft))
    craft.take(status(craft.now_s, Mode.HOLD))
    assert reason(craft) is Reason.MODE_TAKEN
    craft = aloft(traits)
    craft.take(FenceBreach(time_s=craft.now_s))
    craft.take(status(craft.now_s, Mode.OTHER))  # stick and rudder
    assert reason(craft) is Reason.MODE_TAKEN


def test_a_breach_of_long_ago_explains_nothing() -> None:
    craft = aloft(ARDUCOPTER.traits)
    craft.take(FenceBreach(time_s=craft.now_s))
    craft.run_for(10.0)
    craft.take(status(craft.now_s, Mode.RETURN))
    assert reason(craft) is Reason.MODE_TAKEN


def test_it_is_given_back_by_a_word_as_the_remedy_says() -> None:
    assert "MISSION_START" in Reason.FENCE_BREACHED.remedy
    craft = aloft(ARDUCOPTER.traits)
    craft.take(FenceBreach(time_s=craft.now_s))
    craft.take(status(craft.now_s, Mode.RETURN))
    craft.take(events.Order(time_s=craft.now_s, kind=events.OrderKind.START))
    assert craft.state.taken_over.released_at_s == craft.now_s


@PX4S
@pytest.mark.parametrize("misread", [True, False])
def test_what_px4_misreads_of_its_fence_is_the_reason_where_no_zone_is(
    traits: VehicleTraits, misread: bool
) -> None:
    """A lost stream it would have taken up again; and nobody knows where it keeps out."""
    craft = aloft(traits)
    far = CircleZone(name="far", north_m=5_000.0, east_m=-5_000.0, radius_m=50.0)
    fence = FenceChanged(time_s=craft.now_s, zones=(far,), misread=misread)
    craft.state = craft.state.with_fence(craft.context.mission.task, fence)
    craft.mode, craft.failsafe = Mode.HOLD, True
    craft.run_for(10.0)
    assert reason(craft) is (Reason.FENCE_BREACHED if misread else Reason.STREAM_LOST)
    assert craft.state.taken is misread


# --- a fence that is being read


def changed(craft: Craft, items: int = 5010) -> list[str]:
    told = craft.take(FenceReading(time_s=craft.now_s, items=items))
    return [command.text for command in told if isinstance(command, StatusText)]


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


def test_a_few_items_are_read_in_flight() -> None:
    craft = flying(two_legs_away())
    changed(craft, 9)
    craft.run_for(2.0)
    read(craft)
    craft.run_for(20.0)
    assert craft.phase is Phase.FLYING


def test_who_says_so_flies_on_while_it_is_read() -> None:
    craft = flying(two_legs_away(mission(goes_on_while_reading=True)))
    assert changed(craft)
    craft.run_for(20.0)
    assert craft.phase is Phase.FLYING


@ALL_FOUR
def test_copters_hold_and_planes_circle_while_it_is_read(traits: VehicleTraits) -> None:
    it = Wild.calmly(traits).run_until(lambda it: it.state.flight.leg is not None)
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
    assert "it returns once the changed fence is read" in " ".join(
        command.text for command in told if isinstance(command, StatusText)
    )
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
