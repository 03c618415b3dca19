"""The commander of the simulated PX4: boot, arming, commands and events (px4.md 1, 3; the logs)."""

import math

import pytest
from tracking_px4 import Rig

from vehicle_sim.autopilot.px4 import RATES_HZ, parameter_rows, profile
from vehicle_sim.autopilot.values import Ack, Reboot, Result, Sender
from vehicle_sim.conditions import SIM_PARAMETERS_PX4
from vehicle_sim.parameters import Kind

UP = (0.0, 0.0, -10.0)


def _acks(rig: Rig, number: int) -> list[int]:
    return [
        reply.result for _, reply in rig.said if isinstance(reply, Ack) and reply.command == number
    ]


# --- numbers --------------------------------------------------------------------------------------


def test_parameters_have_legal_names_and_are_in_order() -> None:
    rows = parameter_rows("px4", "px4copter")[: -len(SIM_PARAMETERS_PX4)]
    names = [row.name for row in rows]
    assert names == sorted(set(names))
    assert all(len(name) <= 16 for name in names)
    assert {row.name for row in rows if row.kind is Kind.INT32} >= {"COM_OBL_RC_ACT", "GF_ACTION"}


def test_what_can_be_streamed() -> None:
    """px4.md 2: FAILED for HEARTBEAT, MISSION_CURRENT and unknown ids."""
    quad = profile(vehicle_type=2, rates_hz=RATES_HZ)
    assert {30, 32, 33, 436, 140 - 110} <= quad.streamable
    assert not {0, 42, 9999, 140} & quad.streamable
    assert quad.capabilities == 59647
    assert quad.software_version == 17891392


# --- boot -----------------------------------------------------------------------------------------


def test_it_cannot_be_armed_while_it_boots() -> None:
    rig = Rig()
    rig.run(1.0)
    assert rig.command(400, 1.0) == [Result.TEMPORARILY_REJECTED]
    assert rig.command(400, 1.0, 21196.0) == [Result.ACCEPTED]


# --- modes and arming -----------------------------------------------------------------------------


def test_a_setpoint_and_the_command_in_the_same_moment_suffice() -> None:
    """As MAVSDK 4 sends them: PX4 runs the checks at once for the first setpoint."""
    rig = Rig()
    rig.run(6.0)
    rig.command(400, 1.0)
    rig.run(0.3)
    rig.send(UP)
    rig.command(176, 1.0, 6.0)
    rig.step()
    assert _acks(rig, 176) == [Result.ACCEPTED, Result.ACCEPTED]
    assert rig.px4.mode_name == "Offboard"


@pytest.mark.parametrize("flags", [0.0, math.nan])
def test_a_mode_that_is_not_custom_is_refused(flags: float) -> None:
    rig = Rig()
    rig.run(6.0)
    rig.command(176, flags, 6.0)
    rig.step()
    assert _acks(rig, 176) == [Result.ACCEPTED, Result.TEMPORARILY_REJECTED]


def test_it_does_not_disarm_in_the_air_unless_forced() -> None:
    rig = Rig()
    rig.take_off(10.0)
    assert rig.command(400, 0.0) == [Result.TEMPORARILY_REJECTED]
    assert rig.px4.armed
    assert rig.command(400, 0.0, 21196.0) == [Result.ACCEPTED]
    rig.run(3.0)
    assert rig.height_m <= 0.0
    assert rig.px4.landed


# --- other commands -------------------------------------------------------------------------------


def test_home_can_be_moved() -> None:
    """px4.md 3: DO_SET_HOME shifts it at once; nonsense does not."""
    rig = Rig()
    rig.run(6.0)
    assert rig.command(179, 0.0, 0.0, 0.0, 0.0, 47.4, 8.55, 500.0, frame=0) == [Result.ACCEPTED]
    home = rig.px4.home
    assert home is not None
    assert (home.latitude_deg, home.altitude_amsl_m) == (47.4, 500.0)
    for altitude_m in (math.nan, 3.4e38):
        result = rig.command(179, 0.0, 0.0, 0.0, 0.0, 47.4, 8.55, altitude_m, frame=0)
        assert result == [Result.DENIED]
    assert rig.px4.home == home


def test_a_reposition_switches_to_hold() -> None:
    rig = Rig()
    rig.take_off(10.0)
    goal = (47.398, 8.5458, 505.0)
    assert rig.command(192, -1.0, 1.0, 0.0, math.nan, *goal, frame=5) == [Result.ACCEPTED]
    rig.stream(25.0, velocity=(0.0, 0.0, 0.0))
    assert rig.px4.mode_name == "Hold"
    assert rig.px4.estimate.latitude_deg == pytest.approx(47.398, abs=1e-5)
    assert rig.px4.estimate.altitude_amsl_m == pytest.approx(505.0, abs=0.6)


def test_it_reboots_only_while_disarmed() -> None:
    rig = Rig()
    rig.run(6.0)
    assert rig.command(246, 1.0) == [Result.ACCEPTED]
    assert any(isinstance(reply, Reboot) for _, reply in rig.said)
    rig.command(400, 1.0)
    assert rig.command(246, 1.0) == [Result.TEMPORARILY_REJECTED]


def test_the_battery_brings_it_home() -> None:
    """COM_LOW_BAT_ACT 3: return when critical, land in an emergency."""
    rig = Rig()
    rig.take_off(15.0)
    rig.px4.battery.remaining = 0.065
    rig.stream(0.5, velocity=(0.0, 0.0, 0.0))
    assert rig.px4.mode_name == "Return"
    rig.px4.battery.remaining = 0.04
    rig.stream(0.5, velocity=(0.0, 0.0, 0.0))
    assert rig.px4.mode_name == "Land"


def test_a_ground_station_is_missed_only_after_it_was_heard() -> None:
    rig = Rig(NAV_DLL_ACT=3.0)
    rig.take_off(10.0)
    rig.stream(12.0, velocity=(0.0, 0.0, 0.0))
    rig.px4.on_heartbeat(Sender(system=255, component=190), 6)
    rig.stream(9.5, velocity=(0.0, 0.0, 0.0))
    assert rig.px4.mode_name == "Offboard"
    rig.stream(1.0, velocity=(0.0, 0.0, 0.0))
    assert rig.px4.mode_name == "Land"
