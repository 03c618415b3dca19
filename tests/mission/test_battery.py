"""The battery: believed when it is short for a while, and then it goes before a pause and a target.

Laws at each step, whatever happens: `watch_orders`; flights with too little of it: `test_stories`.
"""

import math

import pytest
from made_up import AWAY, Craft, flying, home_or_on, order_of, warnings
from renewed import replace

from companion.mission import changes
from companion.mission.battery import battery_lasts
from companion.mission.changes import OrderResult
from companion.mission.events import Battery, Landed, OrderKind
from companion.mission.mission import Fallback, Mission
from companion.mission.phases import Phase, Reason

LOW = Reason.BATTERY_LOW


def going_back(of: Mission = AWAY) -> Craft:
    """On the way back that a person has asked for."""
    craft = flying(of, plan=home_or_on).order(OrderKind.RETURN)
    return craft.fly_to(Phase.RETURNING).run_for(10.0)


def test_one_word_of_an_empty_battery_ends_nothing() -> None:
    """A smart battery may say 0 % once; what two sources say in turns is no more than that."""
    craft = flying(AWAY)
    craft.battery = 0.8
    for _ in range(10):
        craft.take(Battery(time_s=craft.now_s, remaining=0.0))
        craft.run_for(1.0)
    assert craft.phase is Phase.FLYING
    assert craft.state.flight.fallen_back is craft.state.path.stop is None


@pytest.mark.parametrize(("goes_on", "after_s"), [(True, (3.0, 5.0)), (False, (9.5, 10.5))])
def test_a_battery_below_its_reserve_is_believed_after_three_seconds_or_when_it_falls_silent(
    goes_on: bool, after_s: tuple[float, float]
) -> None:
    craft = flying(AWAY)
    since_s = craft.now_s
    craft.take(Battery(time_s=since_s, remaining=0.19))
    craft.battery = 0.19 if goes_on else None
    craft.run_until(lambda craft: craft.state.flight.fallen_back is LOW)
    assert after_s[0] <= craft.now_s - since_s <= after_s[1]


# --- in a pause, and on the way back


@pytest.mark.parametrize("made", [flying, going_back], ids=["stopping for it", "on the way back"])
def test_a_pause_that_the_battery_would_end_at_once_is_refused(made: object) -> None:
    """Who is told that it pauses walks up to it; on the way back it is warned of once."""
    of = replace(AWAY, fallback=Fallback.LAND)
    craft = flying(of) if made is flying else going_back(of)
    craft.battery = 0.1
    said = warnings(craft.during(5.0))
    assert made is flying or said == [LOW.text]
    pause = order_of(craft, OrderKind.PAUSE)
    assert changes.order_result(craft.state, pause) is OrderResult.NOT_NOW
    assert changes.why_not(craft.state, pause) == f"pause refused: {LOW.text}"
    craft.obey(craft.take(pause))
    stop = craft.state.path.stop
    assert Reason.PAUSED not in (craft.state.orders.active, None if stop is None else stop.reason)
    assert craft.fly_to(Phase.DONE).landed is Landed.ON_GROUND


def test_what_was_flown_of_the_way_back_before_a_pause_is_not_left_to_fly() -> None:
    craft = going_back().order(OrderKind.PAUSE).fly_to(Phase.HOLDING).run_for(5.0)
    left_s = math.dist(craft.here[:2], (0.0, 0.0)) / craft.state.task.limits.speed_m_s
    state = replace(craft.state, vehicle=replace(craft.state.vehicle, battery=1.0))
    for share, lasts in ((0.98, False), (1.02, True)):
        mission = replace(AWAY, reserve=0.0, endurance_s=share * left_s)
        assert battery_lasts(state, mission) is lasts
