"""The commander of the simulated PX4: boot, arming, commands and events (px4.md 1, 3; the logs)."""

import math

import pytest
from tracking_px4 import Rig

from vehicle_sim.autopilots import Ack, Event, Reboot, Result, Say, Send
from vehicle_sim.autopilots.px4 import health
from vehicle_sim.autopilots.px4.autopilot import parameter_rows
from vehicle_sim.autopilots.px4.modes import Mode, base_mode
from vehicle_sim.autopilots.px4.pilot import Pilot
from vehicle_sim.autopilots.px4.style import RATES_HZ, style
from vehicle_sim.faults.conditions import SIM_PARAMETERS_PX4
from vehicle_sim.parameters import Kind

UP = (0.0, 0.0, -10.0)


def _acks(rig: Rig, number: int) -> list[int]:
    return [
        reply.result for _, reply in rig.said if isinstance(reply, Ack) and reply.command == number
    ]


def _events(rig: Rig, number: int) -> list[tuple[float, bytes]]:
    return [
        (at_s, reply.arguments)
        for at_s, reply in rig.said
        if isinstance(reply, Event) and reply.number == number
    ]


# --- numbers --------------------------------------------------------------------------------------


def test_base_modes_are_the_recorded_ones() -> None:
    assert base_mode(Mode.LOITER, armed=False) == 29
    assert base_mode(Mode.OFFBOARD, armed=False) == 17
    assert base_mode(Mode.OFFBOARD, armed=True) == 145
    assert base_mode(Mode.DESCEND, armed=True) == 157


def test_parameters_have_legal_names_and_are_in_order() -> None:
    rows = parameter_rows("px4/common", "px4/multicopter")[: -len(SIM_PARAMETERS_PX4)]
    names = [row.name for row in rows]
    assert names == sorted(set(names))
    assert all(len(name) <= 16 for name in names)
    assert {row.name for row in rows if row.kind is Kind.INT32} >= {"COM_OBL_RC_ACT", "GF_ACTION"}


def test_what_can_be_streamed() -> None:
    """px4.md 2: FAILED for HEARTBEAT, MISSION_CURRENT and unknown ids."""
    quad = style(vehicle_type=2, rates_hz=RATES_HZ)
    assert {30, 32, 33, 436, 140 - 110} <= quad.streamable
    assert not {0, 42, 9999, 140} & quad.streamable
    assert quad.not_streamable is Result.FAILED
    assert quad.capabilities == 59647
    assert quad.software_version == 17891392


# --- boot -----------------------------------------------------------------------------------------


def test_boot() -> None:
    """px4-offboard-short.tlog: status 0 at 2.6 s, 3 at 3.6 s; PREARM bit with the next report."""
    rig = Rig()
    standby_s = prearm_s = home_s = None
    for _ in range(600):
        rig.step()
        status = rig.px4.status()
        if standby_s is None and status.system_status == 3:
            standby_s = rig.now_s
        if prearm_s is None and status.prearm_ok:
            prearm_s = rig.now_s
        if home_s is None and status.home is not None:
            home_s = rig.now_s
    assert standby_s is not None
    assert 2.65 < standby_s < 3.65
    assert prearm_s == pytest.approx(4.15, abs=0.1)
    assert home_s == pytest.approx(2.1, abs=0.4)
    assert rig.px4.mode is Mode.LOITER
    origins = [at_s for at_s, reply in rig.said if reply == Send(message=49)]
    assert len(origins) == 1  # told once, to who is there


def test_the_arming_checks_are_reported_as_recorded() -> None:
    """px4-offboard-short.tlog: at 2.088 without a position, at 4.140 with one; then quiet."""
    rig = Rig()
    rig.run(6.0)
    summaries = _events(rig, 27825120)
    assert [at_s for at_s, _ in summaries] == [
        pytest.approx(2.088, abs=0.06),
        pytest.approx(4.14, abs=0.06),
    ]
    assert summaries[0][1].hex() == "000000120180000000803a0180803a0180"
    assert summaries[1][1].hex() == "000000100080000000b03a7f80b03a7f80"
    rig.stream(1.0, position=UP)
    assert _events(rig, 27825120)[-1][1].hex() == "000000000080000000b07a7f80b07a7f80"


def test_it_cannot_be_armed_while_it_boots() -> None:
    rig = Rig()
    rig.run(1.0)
    assert rig.command(400, 1.0) == [Result.TEMPORARILY_REJECTED]
    assert rig.command(400, 1.0, 21196.0) == [Result.ACCEPTED]


# --- modes and arming -----------------------------------------------------------------------------


def test_while_disarmed_every_mode_is_accepted_but_not_armed_in() -> None:
    """px4.md 1, item 2."""
    rig = Rig()
    rig.run(6.0)
    rig.command(176, 1.0, 6.0)
    rig.run(0.5)
    assert _acks(rig, 176) == [Result.ACCEPTED, Result.ACCEPTED]
    assert rig.px4.mode is Mode.OFFBOARD
    assert rig.px4.status().system_status == 0
    assert rig.command(400, 1.0) == [Result.TEMPORARILY_REJECTED]


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
    assert rig.px4.mode is Mode.OFFBOARD


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


def test_the_events_of_a_flight() -> None:
    """Ids and arguments of the recorded flights, in their order."""
    rig = Rig()
    rig.take_off(5.0, seconds=9.0)
    rig.command(21)
    rig.run(25.0)
    wanted = {
        health.ARMED: b"\x04",
        health.TAKEOFF_DETECTED: b"",
        health.LANDING_HERE: b"",
        health.LANDING_DETECTED: b"",
        health.DISARMED: b"\x06",
    }
    said = [
        (reply.number, reply.arguments)
        for _, reply in rig.said
        if isinstance(reply, Event) and reply.number in wanted
    ]
    assert said == list(wanted.items())


def test_landing_straightens_a_gimbal() -> None:
    """COMMAND_LONGs that PX4 broadcasts: 0.25, 1.25, 1.76 and 2.27 s after the mode (logs)."""
    rig = Rig()
    rig.take_off(8.0)
    rig.command(21)
    landing_s = rig.now_s
    rig.run(4.0)
    said = [
        (at_s - landing_s, reply.message.command, reply.message.confirmation)
        for at_s, reply in rig.said
        if isinstance(reply, Say) and reply.message.get_type() == "COMMAND_LONG"
    ]
    assert [(command, confirmation) for _, command, confirmation in said] == [
        (1001, 0),
        (1000, 0),
        (1001, 0),
        (1001, 1),
        (1001, 2),
        (1001, 3),
    ]
    assert [at_s for at_s, _, _ in said[2:]] == pytest.approx([0.25, 1.25, 1.76, 2.27], abs=0.06)


# --- other commands -------------------------------------------------------------------------------


def test_home_can_be_moved() -> None:
    """px4.md 3: DO_SET_HOME shifts it at once; nonsense does not."""
    rig = Rig()
    rig.run(6.0)
    assert rig.command(179, 0.0, 0.0, 0.0, 0.0, 47.4, 8.55, 500.0, frame=0) == [Result.ACCEPTED]
    home = rig.px4.status().home
    assert home is not None
    assert (home.latitude_deg, home.altitude_amsl_m) == (47.4, 500.0)
    for altitude_m in (math.nan, 3.4e38):
        result = rig.command(179, 0.0, 0.0, 0.0, 0.0, 47.4, 8.55, altitude_m, frame=0)
        assert result == [Result.DENIED]
    assert rig.px4.status().home == home


def test_a_reposition_switches_to_hold() -> None:
    rig = Rig()
    rig.take_off(10.0)
    goal = (47.398, 8.5458, 505.0)
    assert rig.command(192, -1.0, 1.0, 0.0, math.nan, *goal, frame=5) == [Result.ACCEPTED]
    rig.stream(25.0, velocity=(0.0, 0.0, 0.0))
    assert rig.px4.mode is Mode.LOITER
    assert rig.px4.estimate.latitude_deg == pytest.approx(47.398, abs=1e-5)
    assert rig.px4.estimate.altitude_amsl_m == pytest.approx(505.0, abs=0.6)


def test_it_reboots_only_while_disarmed() -> None:
    rig = Rig()
    rig.run(6.0)
    assert rig.command(246, 1.0) == [Result.ACCEPTED]
    assert any(isinstance(reply, Reboot) for _, reply in rig.said)
    rig.command(400, 1.0)
    assert rig.command(246, 1.0) == [Result.TEMPORARILY_REJECTED]


@pytest.mark.parametrize("number", [31000, 207, 0])
def test_unknown_commands_are_unsupported(number: int) -> None:
    assert Rig().command(number) == [Result.UNSUPPORTED]


@pytest.mark.parametrize("number", [1000, 203])
def test_commands_of_others_get_no_answer(number: int) -> None:
    """Gimbals and cameras answer themselves."""
    assert Rig().command(number) == []


def test_the_battery_brings_it_home() -> None:
    """COM_LOW_BAT_ACT 3: return when critical, land in an emergency."""
    rig = Rig()
    rig.take_off(15.0)
    rig.px4.battery.remaining = 0.065
    rig.stream(0.5, velocity=(0.0, 0.0, 0.0))
    assert rig.px4.mode is Mode.RTL
    rig.px4.battery.remaining = 0.04
    rig.stream(0.5, velocity=(0.0, 0.0, 0.0))
    assert rig.px4.mode is Mode.LAND


def test_a_moved_origin_and_a_reset_estimate_show_in_the_local_frame() -> None:
    rig = Rig()
    rig.take_off(10.0)
    north_m, east_m, down_m = rig.px4.local_m
    rig.px4.move_origin(10.0, -5.0, 2.0)
    rig.step()
    moved = rig.px4.local_m
    assert moved == pytest.approx((north_m - 10.0, east_m + 5.0, down_m + 2.0), abs=0.1)
    rig.px4.reset_estimate(20.0, 0.0)
    rig.step()
    assert rig.px4.local_m[0] == pytest.approx(moved[0] + 20.0, abs=0.1)


def test_the_pilot_that_a_fault_brings_holds_the_vehicle() -> None:
    rig = Rig()
    rig.take_off(10.0)
    rig.px4.pilot_takes()
    rig.stream(6.0, velocity=(3.0, 0.0, 0.0))
    assert rig.px4.mode is Mode.POSCTL
    assert rig.speed_m_s < 0.4


def test_a_ground_station_is_missed_only_after_it_was_heard() -> None:
    pilot = Pilot()
    assert not pilot.ground_station_lost(100_000_000, 10.0)
    pilot.hear(6, 100_000_000, ours=False)
    assert not pilot.ground_station_lost(105_000_000, 10.0)
    assert pilot.ground_station_lost(111_000_000, 10.0)
