import pytest
from pymavlink.dialects.v20 import all as wire

from companion.mavlink.autopilots import ARDUCOPTER
from companion.mission.events import Mode

# Streams that ArduCopter denies (reference/ardupilot.md, section 1).
DENIED = (230, 331, 64, 111, 330, 231)


@pytest.mark.parametrize("mode", [Mode.GUIDED, Mode.HOLD, Mode.LAND])
def test_a_mode_is_recognised_by_the_number_that_sets_it(mode: Mode) -> None:
    assert ARDUCOPTER.mode_of(ARDUCOPTER.mode_numbers[mode]) is mode


def test_the_numbers_are_those_of_the_copter_and_hold_is_brake() -> None:
    modes = wire.enums["COPTER_MODE"]
    names = {mode: modes[number].name for mode, number in ARDUCOPTER.mode_numbers.items()}
    assert names == {
        Mode.GUIDED: "COPTER_MODE_GUIDED",
        Mode.HOLD: "COPTER_MODE_BRAKE",
        Mode.LAND: "COPTER_MODE_LAND",
    }


@pytest.mark.parametrize("number", [0, 1, 5, 6, 255, 4_294_967_295])
def test_every_other_number_is_another_mode(number: int) -> None:
    assert ARDUCOPTER.mode_of(number) is Mode.OTHER


def test_no_stream_is_asked_for_that_the_autopilot_denies() -> None:
    assert not set(DENIED) & set(ARDUCOPTER.streams_hz)
    assert all(rate_hz > 0 for rate_hz in ARDUCOPTER.streams_hz.values())
