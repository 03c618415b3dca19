"""While it is paused the battery goes on; a landing that was broken off is not taken up again."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
from made_up import (
    LAND,
    Craft,
    arrived,
    flying,
    landing,
    two_legs_away,
)

from companion.mission import checkpoint
from companion.mission.events import (
    Battery,
    Command,
    Landed,
    Mode,
    Order,
    OrderKind,
    Outcome,
    Say,
    SetMode,
    Setpoint,
)
from companion.mission.mission import EndAction, Fallback, Mission
from companion.mission.state import Phase, Reason


def warnings(commands: list[Command]) -> list[str]:
    return [c.text for c in commands if isinstance(c, Say) and c.warning]


def paused(of: Mission) -> Craft:
    craft = flying(of)
    craft.take(Order(time_s=craft.now_s, kind=OrderKind.PAUSE))
    return craft.fly_to(Phase.HOLDING).run_for(5.0)


def told(craft: Craft, kind: OrderKind) -> None:
    craft.obey(craft.take(Order(time_s=craft.now_s, kind=kind)))


# --- the battery


@pytest.mark.parametrize("how", Fallback)
def test_a_battery_that_runs_low_in_a_pause_ends_it_by_the_fallback(how: Fallback) -> None:
    craft = paused(replace(two_legs_away(), fallback=how))
    count = len(craft.commands)
    craft.take(Battery(time_s=craft.now_s, remaining=0.1))
    craft.tick()
    assert craft.state.reason is Reason.BATTERY_LOW
    assert warnings(craft.commands[count:]) == [f"hold: {Reason.BATTERY_LOW.text}"]
    if how is Fallback.HOLD:
        craft.fly_to(Phase.DONE)
        assert craft.mode is Mode.HOLD
        assert craft.end().outcome is Outcome.FAILED
        assert craft.end().remedy == Reason.BATTERY_LOW.remedy
    elif how is Fallback.LAND:
        craft.fly_to(Phase.LANDING)
    else:
        craft.run_until(lambda craft: craft.phase in (Phase.RETURNING, Phase.DONE))


def test_a_battery_that_lasts_leaves_a_pause_a_pause() -> None:
    craft = paused(two_legs_away())
    craft.take(Battery(time_s=craft.now_s, remaining=0.21))
    craft.run_for(600.0)
    assert (craft.phase, craft.state.reason) == (Phase.HOLDING, Reason.PAUSED)


def test_a_battery_that_will_not_reach_the_target_is_warned_of_in_a_pause() -> None:
    craft = paused(two_legs_away())
    count = len(craft.commands)
    for second in range(90):
        craft.take(Battery(time_s=craft.now_s, remaining=0.9 - 0.007 * second))
        craft.run_for(1.0)
    assert craft.state.reason is Reason.PAUSED
    assert warnings(craft.commands[count:]) == [Reason.BATTERY_LOW.text]


# --- a landing broken off


def sinking() -> Craft:
    return landing().run_until(lambda craft: craft.mode is Mode.LAND).run_for(3.0)


def test_a_landing_broken_off_into_guided_mode_is_held_where_it_is_until_told() -> None:
    craft = sinking()
    count, here = len(craft.commands), craft.here
    craft.mode = Mode.GUIDED
    craft.run_for(120.0)
    later = craft.commands[count:]
    assert (craft.phase, craft.state.reason) == (Phase.HOLDING, Reason.PAUSED)
    assert not [c for c in later if isinstance(c, SetMode)]
    assert craft.mode is Mode.GUIDED
    assert [text for text in warnings(later) if "MISSION_START" in text]
    held = [c.position_nea_m for c in later if isinstance(c, Setpoint)]
    assert len(held) > 100
    assert all(abs(there[2] - here[2]) < 5.0 for there in held)
    told(craft, OrderKind.START)
    craft.fly_to(Phase.DONE)
    assert craft.landed is Landed.ON_GROUND
    assert craft.end().outcome is Outcome.ARRIVED


def test_a_landing_broken_off_by_hand_and_given_back_is_held_too() -> None:
    craft = sinking()
    craft.mode = Mode.OTHER
    craft.run_for(20.0)
    assert (craft.phase, craft.state.reason) == (Phase.HOLDING, Reason.MODE_TAKEN)
    count = len(craft.commands)
    craft.mode = Mode.GUIDED
    craft.run_for(60.0)
    assert (craft.phase, craft.state.reason) == (Phase.HOLDING, Reason.PAUSED)
    assert not [c for c in craft.commands[count:] if isinstance(c, SetMode)]


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


@pytest.mark.parametrize("broken_off", [False, True])
def test_a_landing_broken_off_while_the_companion_was_dead(broken_off: bool) -> None:
    craft = sinking()
    values = json.loads(json.dumps(checkpoint.values_of(craft.state)))
    craft.state = checkpoint.restored(craft.context.mission, craft.state.flight.known, values)
    count = len(craft.commands)
    craft.mode = Mode.GUIDED if broken_off else Mode.LAND
    craft.run_for(15.0)
    lands = [c for c in craft.commands[count:] if c == SetMode(mode=Mode.LAND)]
    assert lands == []
    if broken_off:
        assert (craft.phase, craft.state.standing) == (Phase.HOLDING, Reason.PAUSED)
        assert [text for text in warnings(craft.commands[count:]) if "MISSION_START" in text]
    else:
        assert craft.fly_to(Phase.DONE).landed is Landed.ON_GROUND


def test_the_missions_end_is_a_landing() -> None:
    assert LAND.end_action is EndAction.LAND
