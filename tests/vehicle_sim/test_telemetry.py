"""Telemetry: that every message can be packed at any time, and what its fields say."""

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as mavlink
from tracking_copter import Flown
from tracking_px4 import Rig

from vehicle_sim.autopilot import px4plane
from vehicle_sim.autopilot.values import Battery, Report
from vehicle_sim.sensors.gps import Fix
from vehicle_sim.wire.frames import Packer, number_of
from vehicle_sim.wire.telemetry import MESSAGES

ARDUPILOT, PX4 = MESSAGES["ardupilot"], MESSAGES["px4"]


def read(said: Any) -> Any:
    """As pymavlink reads it out of its frame."""
    return mavlink.MAVLink(None).decode(bytearray(Packer(1, 1).frame(said)))


def report_of(rig: Any, fix: Fix | None = None) -> Report:
    """Of a vehicle in the tests of its autopilot."""
    it = rig.px4 if isinstance(rig, Rig) else rig.autopilot
    known = rig.fix if fix is None else fix
    return Report(autopilot=it, time_us=rig.now_us, fix=known, battery=Battery(), hardware_id=7)


@pytest.fixture(scope="module")
def copter() -> Flown:
    it = Flown(ANGLE_MAX=4500.0).airborne(30.0)
    for k in range(500):
        if k % 10 == 0:
            it.setpoint((0.0, 0.0, -30.0), (k * 0.01, 0.0, 0.0), kind="pos+vel+acc")
        it.step()
    return it


@pytest.fixture(scope="module")
def multicopter() -> Rig:
    rig = Rig()
    rig.take_off(12.0)
    rig.stream(3.0, velocity=(5.0, 3.0, 0.0))
    return rig


def test_every_message_can_be_packed_and_read_again(copter: Flown, multicopter: Rig) -> None:
    """Also before there is anything to say."""
    booting, fresh = Flown(), Rig()
    booting.run(5.0)
    fresh.step()
    for messages, rigs in ((ARDUPILOT, (booting, copter)), (PX4, (fresh, multicopter))):
        for number, build in messages.items():
            for rig in rigs:
                said = build(report_of(rig))
                if said is not None:
                    frame = Packer(1, 1).frame(said)
                    assert number_of(frame) == number
                    assert read(said).get_msgId() == number
    assert {*px4plane.FIRMWARE.profile.rates_hz, 49, 148} <= set(PX4)


def test_px4s_echo_is_what_the_controller_wants(multicopter: Rig) -> None:
    """POSITION_TARGET_LOCAL_NED: position not given: NaN and its bits; motors idle: mask 63."""
    echo = read(PX4[85](report_of(multicopter)))
    assert echo.type_mask == 7
    assert math.isnan(echo.x)
    assert echo.vx == pytest.approx(5.0)
    fresh = Rig()
    fresh.run(5.0)
    idle = read(PX4[85](report_of(fresh)))
    assert (idle.type_mask, idle.afz) == (63, 100.0)
    assert math.isnan(idle.vx)
