"""While it is paused the battery goes on; a landing that was broken off is not taken up again."""

import math

import pytest
from made_up import (
    LAND,
    Craft,
    arrived,
    flying,
    home_or_on,
    landing,
    not_planned,
    planned,
    two_legs_away,
    warnings,
)
from renewed import replace

from companion.mission import changes, events
from companion.mission.battery import battery_lasts
from companion.mission.changes import OrderResult
from companion.mission.events import Battery, Landed, Mode, Order, OrderKind, SetMode
from companion.mission.mission import Fallback, Mission
from companion.mission.state import Phase, Reason


def paused(of: Mission) -> Craft:
    craft = flying(of)
    craft.take(Order(time_s=craft.now_s, kind=OrderKind.PAUSE))
    return craft.fly_to(Phase.HOLDING).run_for(5.0)


# --- the battery


@pytest.mark.parametrize("how", Fallback)
def test_a_battery_that_runs_low_in_a_pause_ends_it_by_the_fallback(how: Fallback) -> None:
    craft = paused(replace(two_legs_away(), fallback=how))
    craft.battery = 0.1
    said = craft.during(4.0)
    assert craft.state.reason is Reason.BATTERY_LOW
    assert warnings(said) == [f"hold: {Reason.BATTERY_LOW.text}"]
    if how is Fallback.HOLD:
        craft.fly_to(Phase.DONE)
        assert craft.mode is Mode.HOLD
        assert craft.end().outcome is events.Outcome.FAILED
        assert craft.end().remedy == Reason.BATTERY_LOW.remedy
    elif how is Fallback.LAND:
        craft.fly_to(Phase.LANDING)
    else:
        craft.run_until(lambda craft: craft.phase in (Phase.RETURNING, Phase.DONE))


@pytest.mark.parametrize(
    ("left_1_s", "warned"),
    [(0.0, []), (0.007, [Reason.BATTERY_LOW.text])],
    ids=["lasts", "will not"],
)
def test_a_battery_above_its_reserve_leaves_a_pause_a_pause_and_is_warned_of_if_it_will_not_last(
    left_1_s: float, warned: list[str]
) -> None:
    craft = paused(two_legs_away())
    count = len(craft.commands)
    for second in range(90):
        left = 0.9 - left_1_s * second if left_1_s else 0.21
        craft.take(Battery(time_s=craft.now_s, remaining=left))
        craft.run_for(1.0)
    assert (craft.phase, craft.state.reason) == (Phase.HOLDING, Reason.PAUSED)
    assert warnings(craft.commands[count:]) == warned


@pytest.mark.parametrize("fallback", Fallback)
def test_one_word_of_an_empty_battery_ends_nothing(fallback: Fallback) -> None:
    """A smart battery may say 0 % once; what two sources say in turns is no more than that."""
    craft = flying(replace(two_legs_away(), fallback=fallback))
    craft.battery = 0.8
    for _ in range(10):
        craft.take(Battery(time_s=craft.now_s, remaining=0.0))
        craft.run_for(1.0)
    assert craft.phase is Phase.FLYING
    assert craft.state.flight.fallen_back is None
    assert craft.state.path.stop is None


@pytest.mark.parametrize(("goes_on", "after_s"), [(True, (3.0, 5.0)), (False, (9.5, 10.5))])
def test_a_battery_below_its_reserve_is_believed_after_three_seconds_or_when_it_falls_silent(
    goes_on: bool, after_s: tuple[float, float]
) -> None:
    craft = flying(two_legs_away())
    since_s = craft.now_s
    craft.take(Battery(time_s=since_s, remaining=0.19))
    craft.battery = 0.19 if goes_on else None
    craft.run_until(lambda craft: craft.state.flight.fallen_back is Reason.BATTERY_LOW)
    assert after_s[0] <= craft.now_s - since_s <= after_s[1]


@pytest.mark.parametrize("after_s", [1.0, 3.0, 30.0])
def test_a_battery_that_is_short_is_short_for_a_companion_that_is_started_again(
    after_s: float,
) -> None:
    craft = flying(replace(two_legs_away(), fallback=Fallback.LAND))
    craft.battery = 0.1
    craft.run_for(after_s)
    craft.restart()
    assert craft.fly_to(Phase.DONE).landed is Landed.ON_GROUND


def going_back(of: Mission) -> Craft:
    """On the way back that a person has asked for."""
    craft = flying(of, plan=home_or_on).order(OrderKind.RETURN)
    return craft.fly_to(Phase.RETURNING).run_for(10.0)


@pytest.mark.parametrize("how", Fallback)
def test_a_pause_on_the_way_back_ends_before_the_battery_does(how: Fallback) -> None:
    """And it goes back, whatever the fallback: it was on its way there."""
    craft = going_back(replace(two_legs_away(), fallback=how))
    craft.order(OrderKind.PAUSE)
    craft.fly_to(Phase.HOLDING).run_for(20.0)
    assert craft.state.reason is Reason.PAUSED
    count = len(craft.commands)
    craft.battery = 0.1
    assert craft.fly_to(Phase.DONE).here[:2] == pytest.approx((0.0, 0.0), abs=1.0)
    assert f"hold: {Reason.BATTERY_LOW.text}" in warnings(craft.commands[count:])


def test_what_was_flown_of_the_way_back_before_a_pause_is_not_left_to_fly() -> None:
    craft = going_back(two_legs_away())
    craft.order(OrderKind.PAUSE)
    craft.fly_to(Phase.HOLDING).run_for(5.0)
    left_s = math.dist(craft.here[:2], (0.0, 0.0)) / craft.state.task.limits.speed_m_s
    state = replace(craft.state, vehicle=replace(craft.state.vehicle, battery=1.0))
    for share, lasts in ((0.98, False), (1.02, True)):
        mission = replace(two_legs_away(), reserve=0.0, endurance_s=share * left_s)
        assert battery_lasts(state, mission) is lasts


@pytest.mark.parametrize("how", Fallback)
@pytest.mark.parametrize("pauses", [False, True])
def test_a_return_that_was_asked_for_goes_before_the_fallback_of_a_battery(
    how: Fallback, pauses: bool
) -> None:
    """While it still stops for it, and out of a pause in which it waits."""
    craft = flying(replace(two_legs_away(), fallback=how), plan=home_or_on)
    craft.battery = 0.1
    craft.order(OrderKind.RETURN)
    if pauses:
        craft.order(OrderKind.PAUSE)
    craft.fly_to(Phase.RETURNING)
    assert craft.fly_to(Phase.DONE).here[:2] == pytest.approx((0.0, 0.0), abs=1.0)


@pytest.mark.parametrize("where", ["stopping for it", "on the way back"])
def test_a_pause_that_the_battery_would_end_at_once_is_refused(where: str) -> None:
    """Who is told that it pauses walks up to it."""
    mission = replace(two_legs_away(), fallback=Fallback.LAND)
    craft = flying(mission) if where == "stopping for it" else going_back(mission)
    craft.battery = 0.1
    craft.run_for(5.0)
    pause = Order(time_s=craft.now_s, kind=OrderKind.PAUSE)
    assert changes.order_result(craft.state, pause) is OrderResult.NOT_NOW
    assert changes.why_not(craft.state, pause) == f"pause refused: {Reason.BATTERY_LOW.text}"
    craft.obey(craft.take(pause))
    stop = craft.state.path.stop
    assert Reason.PAUSED not in (craft.state.orders.active, None if stop is None else stop.reason)
    assert craft.fly_to(Phase.DONE).landed is Landed.ON_GROUND


def test_on_the_way_back_it_is_warned_of_the_battery_once_and_goes_on() -> None:
    craft = going_back(two_legs_away())
    craft.battery = 0.1
    assert warnings(craft.during(8.0)) == [Reason.BATTERY_LOW.text]
    assert craft.phase is Phase.RETURNING
    assert craft.fly_to(Phase.DONE).landed is Landed.ON_GROUND


@pytest.mark.parametrize("kind", [OrderKind.START, OrderKind.CONTINUE])
def test_told_to_go_on_with_a_battery_that_is_short_it_does_not_fly_to_the_target(
    kind: OrderKind,
) -> None:
    craft = flying(replace(two_legs_away(), fallback=Fallback.LAND))
    craft.battery = 0.1
    craft.run_for(3.5)
    asked = len(craft.sent(events.Plan))
    for _ in range(60):
        craft.order(kind)
        craft.run_for(1.0)
    assert len(craft.sent(events.Plan)) == asked
    assert craft.phase in (Phase.LANDING, Phase.DONE)


def test_who_goes_on_towards_a_target_has_not_fallen_back_and_minds_the_battery() -> None:
    """The way back was asked for, then a person said pause, and go on."""
    craft = flying(replace(two_legs_away(), fallback=Fallback.RETURN))
    craft.plan = lambda request: not_planned(request) if request.flown is None else None
    craft.run_until(lambda craft: craft.state.flight.fallen_back is Reason.NO_PLAN)
    craft.order(OrderKind.PAUSE)
    craft.plan = planned
    craft.order(OrderKind.CONTINUE)
    craft.fly_to(Phase.FLYING).run_for(20.0)
    craft.battery = 0.1
    craft.fly_to(Phase.HOLDING)
    assert craft.state.reason is Reason.BATTERY_LOW


# --- a landing broken off


def sinking() -> Craft:
    return landing().run_until(lambda craft: craft.mode is Mode.LAND).run_for(3.0)


@pytest.mark.parametrize("by_hand", [None, Mode.OTHER, Mode.HOLD])
def test_a_landing_broken_off_is_held_where_it_is_until_told(by_hand: Mode | None) -> None:
    """Into guided mode at once, or by a pilot who gives it back later."""
    craft = sinking()
    said = len(craft.commands)
    if by_hand is not None:
        craft.mode = by_hand
        craft.run_for(20.0)
        assert (craft.phase, craft.state.reason) == (Phase.HOLDING, Reason.MODE_TAKEN)
    craft.mode, here = Mode.GUIDED, craft.here
    later = craft.during(120.0)
    assert (craft.phase, craft.state.reason) == (Phase.HOLDING, Reason.PAUSED)
    assert craft.mode is Mode.GUIDED
    assert not [c for c in craft.commands[said:] if isinstance(c, SetMode)]
    assert [text for text in warnings(craft.commands[said:]) if "MISSION_START" in text]
    held = [c.position_nea_m for c in later if isinstance(c, events.Setpoint)]
    assert len(held) > 100
    assert all(abs(there[2] - here[2]) < 5.0 for there in held)
    craft.order(OrderKind.START)
    craft.fly_to(Phase.DONE)
    assert craft.landed is Landed.ON_GROUND
    assert craft.end().outcome is events.Outcome.ARRIVED


@pytest.mark.parametrize("meanwhile", [Mode.GUIDED, Mode.HOLD])
def test_a_landing_that_was_never_begun_is_asked_for_again(meanwhile: Mode) -> None:
    """Guided mode is what it is in until its autopilot obeys; without setpoints PX4 holds."""
    craft = arrived(LAND)
    craft.obeys_modes = False
    craft.fly_to(Phase.LANDING)
    craft.mode = meanwhile
    craft.run_for(5.0)
    assert craft.phase is Phase.LANDING
    craft.obeys_modes = True
    craft.fly_to(Phase.DONE)
    assert craft.landed is Landed.ON_GROUND


@pytest.mark.parametrize("reboots", [False, True])
@pytest.mark.parametrize("broken_off", [False, True])
def test_a_landing_goes_on_after_a_restart_or_a_reboot(broken_off: bool, reboots: bool) -> None:
    craft = sinking().reboot() if reboots else sinking().restart()
    craft.mode = Mode.GUIDED if broken_off else Mode.LAND
    said = craft.during(15.0)
    assert SetMode(mode=Mode.LAND) not in said
    if broken_off:
        assert (craft.phase, craft.state.orders.active) == (Phase.HOLDING, Reason.PAUSED)
        assert [text for text in warnings(said) if "MISSION_START" in text]
    else:
        assert craft.fly_to(Phase.DONE).landed is Landed.ON_GROUND
