"""PX4's telemetry: every message packed, and what its fields say."""

import math
import struct
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as mavlink
from tracking_px4 import Rig

from vehicle_sim.autopilot import px4plane
from vehicle_sim.autopilots import Battery, Report
from vehicle_sim.wire.frames import Packer
from vehicle_sim.wire.telemetry_px4 import MESSAGES


def read(said: Any) -> Any:
    """As pymavlink reads it out of its frame."""
    return mavlink.MAVLink(None).decode(bytearray(Packer(1, 1).frame(said)))


def _report(rig: Rig) -> Report:
    return Report(autopilot=rig.px4, time_us=rig.now_us, fix=rig.fix, battery=Battery())


@pytest.fixture(scope="module")
def flying() -> Rig:
    rig = Rig()
    rig.take_off(12.0)
    rig.stream(3.0, velocity=(5.0, 3.0, 0.0))
    return rig


def test_everything_it_streams_can_be_made_and_packed(flying: Rig) -> None:
    """Also before there is anything to say."""
    fresh = Rig()
    fresh.step()
    for rig in (fresh, flying):
        report = _report(rig)
        for number in (*px4plane.FIRMWARE.profile.rates_hz, 49, 148, 300):
            said = MESSAGES[number](report)
            if said is not None:
                frame = Packer(1, 1).frame(said)
                assert struct.unpack("<I", frame[7:10] + b"\0")[0] == number


def test_the_echo_is_what_the_controller_wants(flying: Rig) -> None:
    """POSITION_TARGET_LOCAL_NED: position not given: NaN and its bits; motors idle: mask 63."""
    echo = read(MESSAGES[85](_report(flying)))
    assert echo.type_mask == 7
    assert math.isnan(echo.x)
    assert echo.vx == pytest.approx(5.0)
    fresh = Rig()
    fresh.run(5.0)
    idle = read(MESSAGES[85](_report(fresh)))
    assert (idle.type_mask, idle.afz) == (63, 100.0)
    assert math.isnan(idle.vx)


def test_global_targets_are_told_in_auto_modes_only(flying: Rig) -> None:
    assert MESSAGES[87](_report(flying)) is None
    rig = Rig()
    rig.take_off(8.0)
    rig.command(21)
    rig.run(2.0)
    landing = read(MESSAGES[87](_report(rig)))
    assert (landing.coordinate_frame, landing.alt) == (5, 0.0)
