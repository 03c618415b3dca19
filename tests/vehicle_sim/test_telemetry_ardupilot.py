"""ArduPilot's messages: the constants of the recordings, and that all of them can be packed."""

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as mavlink
from tracking_copter import Flown

from vehicle_sim.autopilots import Battery, Report
from vehicle_sim.sensors.gps import Fix
from vehicle_sim.wire.frames import Packer
from vehicle_sim.wire.telemetry_ardupilot import MESSAGES


def report_of(it: Flown, **fields: Any) -> Report:
    return Report(
        autopilot=it.autopilot,
        time_us=it.now_us,
        fix=fields.get("fix", it.fix),
        battery=Battery(),
        hardware_id=7,
    )


@pytest.fixture(scope="module")
def booting() -> Report:
    it = Flown()
    it.run(5.0)
    return report_of(it)


@pytest.fixture(scope="module")
def flying() -> Report:
    it = Flown(ANGLE_MAX=4500.0).airborne(30.0)
    for k in range(500):
        if k % 10 == 0:
            it.setpoint((0.0, 0.0, -30.0), (k * 0.01, 0.0, 0.0), kind="pos+vel+acc")
        it.step()
    return report_of(it)


def read(said: Any) -> Any:
    """As pymavlink reads it out of its frame."""
    return mavlink.MAVLink(None).decode(bytearray(Packer(1, 1).frame(said)))


@pytest.mark.parametrize("number", sorted(MESSAGES))
@pytest.mark.parametrize("when", ["booting", "flying"])
def test_every_message_can_be_packed_and_read_again(
    number: int, when: str, request: pytest.FixtureRequest
) -> None:
    said = MESSAGES[number](request.getfixturevalue(when))
    if said is not None:
        assert read(said).get_msgId() == number


def test_the_receiver_has_no_speed_or_position_before_it_speaks(flying: Report) -> None:
    flying.fix = Fix()
    message = read(MESSAGES[24](flying))
    assert (message.fix_type, message.eph, message.epv) == (0, 65535, 65535)
    assert (message.lat, message.vel, message.cog, message.satellites_visible) == (0, 0, 0, 0)


def test_home_has_no_attitude(flying: Report) -> None:
    home = read(MESSAGES[242](flying))
    assert all(math.isnan(part) for part in home.q)
    assert (home.x, home.y) == pytest.approx((0.0, 0.0), abs=0.05)


def test_its_own_question_of_the_time_is_told_by_its_last_digit(flying: Report) -> None:
    message = read(MESSAGES[111](flying))
    assert (message.tc1, message.ts1) == (0, flying.time_us * 1000 + 1)
