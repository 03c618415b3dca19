"""What the mission does when the ground is nearer than its map says."""

from made_up import Craft, flying, home_or_on, mission, two_legs_away

from companion.mission.events import GroundSeen, StatusText
from companion.mission.mission import Fallback
from companion.mission.state import Phase, Reason

MISSION = two_legs_away(mission(rangefinder_error_m=2.0, fallback=Fallback.RETURN))


def seen(craft: Craft, above_m: float) -> GroundSeen:
    return GroundSeen(time_s=craft.now_s, above_m=above_m)


def told(craft: Craft) -> int:
    return sum(text.text.startswith(Reason.GROUND_NEARER.text) for text in craft.sent(StatusText))


def test_it_stops_on_its_path_and_goes_on_when_the_two_agree() -> None:
    craft = flying(MISSION)
    for _ in range(3):
        craft.take(seen(craft, 5.0))
    stop = craft.state.flight.stop
    assert stop is not None
    assert stop.reason is Reason.GROUND_NEARER
    craft.fly_to(Phase.HOLDING)
    assert craft.state.reason is Reason.GROUND_NEARER
    assert told(craft) == 1
    craft.run_for(20.0)
    assert craft.phase is Phase.HOLDING
    craft.take(seen(craft, 0.0))
    craft.fly_to(Phase.FLYING)
    craft.fly_to(Phase.ARRIVED)


def test_ground_that_stays_higher_ends_in_the_fallback_and_stops_no_way_back() -> None:
    craft = flying(MISSION, plan=home_or_on)
    craft.take(seen(craft, 5.0))
    craft.fly_to(Phase.HOLDING)
    since_s = craft.now_s
    craft.run_until(lambda craft: craft.phase is Phase.RETURNING, limit_s=300.0)
    assert 50.0 < craft.now_s - since_s < 80.0
    craft.take(seen(craft, 5.0))
    assert craft.state.flight.stop is None
    craft.run_until(lambda craft: craft.phase in (Phase.LANDING, Phase.DONE, Phase.FAULTED))
    assert craft.phase is Phase.LANDING


def test_agreement_stops_nobody() -> None:
    craft = flying(MISSION)
    craft.run_for(5.0)
    craft.take(seen(craft, 0.0))
    assert craft.state.flight.stop is None
