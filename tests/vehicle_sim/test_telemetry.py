"""Telemetry: that every message can be packed at any time, and what its fields say."""

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as mavlink
from pymavlink.quaternion import QuaternionBase as Quaternion
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
            saids = [build(report_of(rig)) for rig in rigs]
            for frame in map(Packer(1, 1).frame, filter(None, saids)):
                assert number_of(frame) == number
                assert mavlink.MAVLink(None).decode(bytearray(frame)).get_msgId() == number
    assert {*px4plane.FIRMWARE.profile.rates_hz, 49, 148} <= set(PX4)


def test_where_it_is_is_told_alike_by_all_messages(copter: Flown, multicopter: Rig) -> None:
    """Truth and estimate differ by what the receiver's delay makes of the speed."""
    for messages, rig in ((ARDUPILOT, copter), (PX4, multicopter)):
        report, vehicle = report_of(rig), report_of(rig).vehicle
        told = {number: read(build(report)) for number, build in messages.items() if build(report)}
        place, attitude, local_m = told[33], told[30], told[32]
        assert place.lat * 1e-7 == pytest.approx(vehicle.latitude_deg, abs=3e-5)
        assert place.lon * 1e-7 == pytest.approx(vehicle.longitude_deg, abs=3e-5)
        assert place.alt * 1e-3 == pytest.approx(vehicle.altitude_amsl_m, abs=1.0)
        assert place.relative_alt * 1e-3 == pytest.approx(-local_m.z, abs=0.2)
        assert (place.vx, place.vy) == pytest.approx((local_m.vx * 100, local_m.vy * 100), abs=1.0)
        assert (told[74].groundspeed, told[74].climb) == pytest.approx(
            (math.hypot(local_m.vx, local_m.vy), -local_m.vz)
        )
        assert attitude.roll == pytest.approx(vehicle.roll_rad, abs=1e-6)
        assert place.hdg == pytest.approx(math.degrees(attitude.yaw) % 360.0 * 100.0, abs=1.0)
        wanted = Quaternion([attitude.roll, attitude.pitch, attitude.yaw]).q
        by_itself = told[31]
        assert [by_itself.q1, by_itself.q2, by_itself.q3, by_itself.q4] == pytest.approx(wanted)
        if 331 in told:
            assert told[331].q == pytest.approx(wanted)
            assert (told[331].x, told[331].vx, told[331].yawspeed, told[331].estimator_type) == (
                *(local_m.x, local_m.vx, attitude.yawspeed, 8),
            )


def test_the_echo_is_what_the_controller_wants(copter: Flown, multicopter: Rig) -> None:
    """POSITION_TARGET_LOCAL_NED: what is not given is NaN (PX4) or 0, and has its bits."""
    echo = read(PX4[85](report_of(multicopter)))
    assert echo.type_mask == 7
    assert math.isnan(echo.x)
    assert echo.vx == pytest.approx(5.0)
    fresh = Rig()
    fresh.run(5.0)
    idle = read(PX4[85](report_of(fresh)))
    assert (idle.type_mask, idle.afz) == (63, 100.0)
    assert math.isnan(idle.vx)
    for kind, mask in (("position", 0xDF8), ("pos+vel", 0xC00), ("velocity", 0xC07)):
        copter.setpoint((5.0, 0.0, -30.0), (1.0, 0.0, 0.0), kind=kind)
        copter.step()
        echo = read(ARDUPILOT[85](report_of(copter)))
        assert echo.type_mask == mask
        assert ((echo.x != 0.0), (echo.vx != 0.0)) == (mask & 7 == 0, mask & 0x38 == 0)
