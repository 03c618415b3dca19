"""px4.md, statement by statement: what a client sees of the simulated PX4.

Everything goes over the wire (px4_wire.py); the experiments are in px4_flights*.py, and each serves
all statements about it.  Where a recorded flight and the document disagree, the recording is right,
and the case says so.  Tolerances: what the document gives as a range; otherwise 5 % of a rate,
0.1 s (0.3 s where it is seen in a message of 5 Hz, 1 s in a heartbeat), 0.7 m (two times the noise
of the EKF), 10 % of speeds, and as stated.

Left out is what is stated elsewhere: boot and loss of GPS (conformance/, test_estimator.py), who
may send and intervals (test_routing.py, test_streams.py), what masks and frames mean
(test_px4_setpoints.py), the aeroplane (test_px4_fixed_wing.py).
"""

import functools
import math
from collections.abc import Callable
from typing import Any

import px4_flights as links
import px4_flights_mission as mission
import px4_flights_offboard as offboard
import pytest
from harness import (
    ALTCTL,
    HOLD,
    LAND,
    MISSION,
    OFFBOARD,
    POSCTL,
    RETURN,
    TAKEOFF,
    local,
    worldwide,
)

Experiment = Callable[..., Any]


def case(section: str, says: str, expected: Any, seen: Experiment, *arguments: Any) -> Any:
    """One statement: what the document says, what is expected, and the experiment."""
    return pytest.param(functools.partial(seen, *arguments), expected, id=f"{section}: {says}")


def looks(section: str, seen: Experiment, *arguments: Any, **expected: Any) -> list[Any]:
    """Statements about the fields of what one experiment returns."""

    def field(name: str) -> Any:
        return seen(*arguments)[name]

    about = " ".join([seen.__name__, *map(str, arguments)])
    return [case(section, f"{about}: {name}", expected[name], field, name) for name in expected]


def about(value: Any, within: float) -> Any:
    return pytest.approx(value, abs=within)


def between(least: float, most: float) -> Any:
    return pytest.approx((least + most) / 2.0, abs=(most - least) / 2.0 + 1e-9)


# --- 1 and 2 --------------------------------------------------------------------------------------

RATES_HZ = {
    98.0: "ATTITUDE",
    49.0: "ATTITUDE_QUATERNION GLOBAL_POSITION_INT",
    29.5: "LOCAL_POSITION_NED ODOMETRY",
    9.9: "TIMESYNC ALTITUDE DISTANCE_SENSOR POSITION_TARGET_LOCAL_NED VFR_HUD",
    8.0: "GPS_RAW_INT",
    5.0: "EXTENDED_SYS_STATE SYS_STATUS",
    1.0: "HEARTBEAT MISSION_CURRENT ESTIMATOR_STATUS SYSTEM_TIME",
    0.5: "BATTERY_STATUS HOME_POSITION CURRENT_MODE",
}
"""Messages of an onboard link that somebody reads."""
RATE_HZ = {kind: hz for hz, kinds in RATES_HZ.items() for kind in kinds.split()}
DEFAULTS: dict[str, float] = {
    "COM_OF_LOSS_T": 1.0,
    "COM_OBL_RC_ACT": 0,
    "MPC_LAND_SPEED": 0.7,
    "SIH_KDV": 1.0,
    "COM_OBC_LOSS_T": 5,
    "NAV_DLL_ACT": 0,
    "COM_RC_IN_MODE": 1,
    "COM_LOW_BAT_ACT": 3,
    "MIS_TAKEOFF_ALT": 2.5,
    "COM_DISARM_PRFLT": 10.0,
    "COM_DISARM_LAND": 2.0,
    "MPC_XY_VEL_MAX": 12.0,
    "MPC_Z_VEL_MAX_UP": 3.0,
    "MPC_Z_VEL_MAX_DN": 1.5,
    "MPC_TILTMAX_AIR": 45.0,
    "MPC_XY_P": 0.95,
    "COM_RC_OVERRIDE": 1,
    "COM_RCL_EXCEPT": 0,
    "RTL_RETURN_ALT": 30.0,
    "GF_ACTION": 2,
    "SIM_GPS_USED": 10,
}
WING_DEFAULTS = {"FW_AIRSPD_TRIM": 15.0, "NAV_LOITER_RAD": 80.0, "NAV_FW_ALT_RAD": 10.0}
LINKS = [
    case("2", "rates", pytest.approx(RATE_HZ, rel=0.05), links.rates, RATE_HZ),
    case("1.9", "HEARTBEAT stays at 1 Hz", about(1.0, 0.1), links.rate_after, "HEARTBEAT", 0, 2e4),
    case("1.9", "436 at 20 Hz: 2 Hz", about(2.0, 0.1), links.rate_after, "CURRENT_MODE", 436, 5e4),
    case("1.9", "436 at 20 Hz: at once on a change", between(0.0, 0.1), links.mode_is_told_after),
    case("1.3", "no STATUSTEXT to a companion", False, links.texts),
    case("1.3", "nor for its own heartbeat", False, links.texts, 18),
    case("1.3", "STATUSTEXT to a ground station", True, links.texts, 6),
    case("1.3", "STATUSTEXT on that same link only", (False, True), links.texts_by_link),
    *looks("2", links.default_streams, echoes=True, wind=False),
    case("2", "GPS_GLOBAL_ORIGIN never comes later; 512 brings it", (0, 1), links.origins),
    case("2", "takes signed and unsigned, never signs", (True, True, False), links.signing),
    case("2", "no TRAJECTORY_REPRESENTATION", True, links.leaves_it_cold, links.ROUTE),
    case("2", "OBSTACLE_DISTANCE: not in OFFBOARD", True, links.leaves_it_cold, links.OBSTACLES),
    case("0 to 8", "defaults", pytest.approx(DEFAULTS), links.defaults, DEFAULTS),
    case("10", "defaults", WING_DEFAULTS, links.defaults, WING_DEFAULTS, "plane"),
]

# --- 3: start, arming, modes ----------------------------------------------------------------------

START = [
    *(
        case("3 modes", f"{mode:#010x}", (mode, 3, True), links.disarmed_mode, mode)
        for mode in (TAKEOFF, HOLD, RETURN, LAND)
    ),
    *(  # no stream, no pilot, no mission
        case("3 modes", f"{mode:#010x}", (mode, 0, False), links.disarmed_mode, mode)
        for mode in (OFFBOARD, POSCTL, ALTCTL, MISSION)
    ),
    case("3", "one earlier setpoint is enough, in 0.6 s", True, links.enters_offboard_within, 0.6),
    *looks(
        "3",
        links.climb,
        lift_off_s=between(1.6, 2.3),  # 1.7 there, 2.1 in the log
        to_9_5_m_s=about(7.9, 0.8),
        fastest_m_s=about(2.8, 0.28),
        highest_m=about(10.0, 0.7),
    ),
    *looks("3 velocity only", links.climb, True, fastest_m_s=about(1.0, 0.2)),
    *looks(
        "3 NAV_TAKEOFF",
        links.commanded_takeoff,
        modes=[TAKEOFF, HOLD],
        hold_s=about(7.8, 1.0),
        height_m=about(2.5, 0.7),
    ),
    case("3", "armed without takeoff: 10 s", between(10.0, 11.1), links.disarms_unflown_after),
    *looks(
        "3 NAV_LAND",
        links.landing,
        result=0,
        mode=LAND,
        disarms_after_s=between(1.8, 3.1),
        mode_after=OFFBOARD,
        height_after_arming_m=between(3.0, 6.7),
    ),
    case("3", "DO_CHANGE_SPEED: 0, no effect", about((0, 6.0), 0.3), links.speed_after_change),
]

# --- 4: masks and frames, limits, steps -----------------------------------------------------------

ONWARD, THERE, UP = (3.0, 1.0, -1.0), (10.0, 5.0, -12.0), (0.0, 0.0, -15.0)
ENDS_UP = {
    "position": (local(THERE), (10.0, 5.0, 12.0), 0.7),
    # the point and v / MPC_XY_P
    "position + velocity": (local(THERE, (1.0, 0.0, 0.0)), (11.05, 5.0, 12.0), 0.7),
    "all three": (local(THERE, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), (10.0, 5.0, 12.0), 0.7),
    "xy position + z velocity": (
        *(local((10.0, 5.0, 0.0), (0.0, 0.0, -0.3), mask=0xDDC), (10.0, 5.0, 19.5), 1.0),
    ),
    "GLOBAL_INT frame 6": (worldwide(20.0, 10.0, 12.0, frame=6), (20.0, 10.0, 12.0), 2.0),
}
BRAKES = (0.0, 0.0, 0.0)
VELOCITY_AFTER = {
    "velocity": (local(None, ONWARD), (3.0, 1.0, 1.0)),
    "z position + xy velocity": (local(UP, (3.0, 0.0, 0.0), mask=0xDE3), (3.0, 0.0, 0.0)),
    "GLOBAL_INT velocity": (worldwide(0, 0, 0, ONWARD, mask=0xDC7, frame=0), (3.0, 1.0, 1.0)),
    "x only: brakes": (local(UP, mask=0xDFE), BRAKES),
    "GLOBAL_INT altitude + velocity: brakes": (worldwide(0, 0, 510.0, ONWARD, mask=0xDE3), BRAKES),
}
TURNS = {
    "yaw": (local(UP, yaw=math.pi / 3), about(60.0, 3.0)),
    "yaw rate": (local(UP, yaw_rate=math.radians(6.0)), about(36.0, 6.0)),
    "neither": (local(UP), about(0.0, 3.0)),
}
MASKS = [
    *(
        case("4", says, about(place, within), offboard.ends_up, setpoint)
        for says, (setpoint, place, within) in ENDS_UP.items()
    ),
    *(
        case("4", says, about(velocity, 0.4), offboard.velocity_after, setpoint)
        for says, (setpoint, velocity) in VELOCITY_AFTER.items()
    ),
    *(
        case("4", f"nose: {says}", heading, offboard.heading_after, setpoint)
        for says, (setpoint, heading) in TURNS.items()
    ),
    case(
        "4", "frame 8 velocity, rotated by yaw", about((0, 3), 0.3), offboard.turned_body_velocity
    ),
    case("4", "no setpoint: lost", None, offboard.velocity_after, local(UP, frame=8)),
]
STEPS = [
    case("4", "asked 15 m/s, flew 11.9", about((11.9, 0.0), 0.25), offboard.reached, 15.0, 0.0),
    case("4", "vz -6: -2.8 m/s", about((0.0, -2.8), 0.28), offboard.reached, 0.0, -6.0),
    case("4", "vz 6: 1.6 m/s", about((0.0, 1.6), 0.16), offboard.reached, 0.0, 6.0),
    *looks(
        *("4", offboard.jump, 30.0, 12.0),
        tilt_deg=about(45.0, 2.0),
        fastest_m_s=about(8.8, 0.5),
        to_29_m_s=about(4.8, 0.4),
        farthest_m=about(31.4, 0.7),
    ),
    *looks("4", offboard.jump, 500.0, 25.0, at_last_m_s=about(9.7, 0.3), offboard=True),
    # 15 %: 0.1 s of delay is 1.2 m
    *looks("4 from 12 m/s", offboard.stop, "position", farthest_m=about(10.0, 1.5)),
    *looks(
        *("4 from 12 m/s", offboard.stop, "velocity"),
        metres=about(11.0, 1.65),
        seconds=about(2.3, 0.35),
    ),
    *looks(
        *("4 from 12 m/s", offboard.stop, "hold"),
        metres=about(31.2, 3.1),
        seconds=about(5.6, 0.85),
        again_m_s=between(0.0, 0.5),
    ),
    case("4", "10 m/s, stream stops: 18.5 m in all", about(18.5, 1.85), offboard.frozen),
]

# --- 6: loss of the stream ------------------------------------------------------------------------

BACK = between(0.0, 0.3)
"""Seconds until OFFBOARD by itself when the stream is back."""
LOSS = [
    *looks(
        *("6 Position", offboard.loss, 0),
        mode=POSCTL,
        sinks_m_s=about(0.7, 0.1),
        metres=between(5.0, 20.0),
        back_s=BACK,
    ),
    *looks("6 Altitude", offboard.loss, 1, mode=ALTCTL, sinks_m_s=between(0.5, 0.7), back_s=BACK),
    *looks("6 Return", offboard.loss, 3, mode=RETURN, climbs_to_m=about(30.0, 1.0), back_s=BACK),
    case("6 Return", "returns", about((0.0, 30.0), 2.0), offboard.returned),
    *looks(
        *("6 Land", offboard.loss, 4),
        mode=LAND,
        sinks_m_s=about(1.4, 0.14),
        speed_m_s=about(0.0, 0.4),
        back_s=BACK,
    ),
    case("6 Land", "then 0.7 m/s", about(0.7, 0.1), offboard.sinks_low),
    *looks(
        *("6 Hold", offboard.loss, 5),
        mode=HOLD,
        status=5,
        metres=about(7.2, 1.4),  # about 4 m there, 7.2 in px4-offboard-short.tlog
        speed_m_s=about(0.0, 0.4),
        back_s=BACK,
        mode_s=about(1.12, 0.1),
        intended=OFFBOARD,
        heartbeat_s=between(1.1, 2.2),
    ),
    *(
        case("6", f"{hz:g} Hz keeps OFFBOARD", [OFFBOARD], offboard.modes_at_rate, hz)
        for hz in (5.0, 1.2)
    ),
    case(
        "6",
        "0.8 Hz flips between the modes every second",
        [OFFBOARD, HOLD] * 4,
        lambda: offboard.modes_at_rate(0.8)[:8],
    ),
    *(
        case("6", f"a gap of {gap_s} s", modes, offboard.modes_with_gap, gap_s)
        for gap_s, modes in ((0.9, {OFFBOARD}), (1.2, {OFFBOARD, HOLD}))
    ),
    *looks("6", offboard.loss_on_the_ground, seconds=about(1.1, 0.2), mode=HOLD, armed=True),
    case("1.5", "a commanded Hold is not undone", HOLD, offboard.commanded, HOLD),
    case("1.5", "a commanded Land is not undone", LAND, offboard.commanded, LAND),
]
PILOT = [
    *looks(
        "6 pilot",
        offboard.loss_with_pilot,
        mode=POSCTL,
        metres=about(4.0, 1.5),
        speed_m_s=about(0.0, 0.7),
        sunk_m=about(0.0, 0.7),
        mode_with_stream=OFFBOARD,
    ),
]

# --- 7 --------------------------------------------------------------------------------------------

MISSIONS = [
    *looks(
        "7",
        mission.mission,
        uploaded=0,
        frames=[6, 5, 6, 6],
        started=(0, MISSION),
        left=(0, OFFBOARD),
        cleared=0,
        items_after=(0, 1),
    ),
    *looks(
        "7",
        mission.fence,
        uploaded=0,
        hold_s=between(0.0, 1.0),
        mode=HOLD,
        inside_m=about(5.0, 1.5),
        told=True,
        mode_with_stream=HOLD,
        commanded=0,
        deeper_m=between(8.0, 24.0),
    ),
]


def sample(cases: list[Any]) -> list[Any]:
    """Every other one; nightly the rest, of which test_px4_setpoints.py states how it is read."""
    rest = [pytest.param(*c.values, id=c.id, marks=pytest.mark.nightly) for c in cases[1::2]]
    return cases[::2] + rest


@pytest.mark.parametrize(
    ("seen", "expected"), LINKS + START + sample(MASKS) + STEPS + LOSS + PILOT + MISSIONS
)
def test_the_simulator_does_what_px4_md_says(seen: Experiment, expected: Any) -> None:
    assert seen() == expected
