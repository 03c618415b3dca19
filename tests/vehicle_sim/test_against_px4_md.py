"""px4.md, statement by statement: what a client sees of the simulated PX4.

Everything goes over the wire (px4_wire.py); the experiments are in px4_flights*.py, and each serves
all statements about it.  Where a recorded flight and the document disagree, the recording is right,
and the case says so.  Tolerances: what the document gives as a range; otherwise 5 % of a rate,
0.1 s (0.3 s where it is seen in a message of 5 Hz, 1 s in a heartbeat), 0.7 m (two times the noise
of the EKF), 10 % of speeds, and as stated.
"""

import functools
import math
from collections.abc import Callable
from typing import Any

import px4_flights as links
import px4_flights_mission as mission
import px4_flights_offboard as offboard
import px4_flights_wing as wing
import pytest
from px4_wire import (
    ALTCTL,
    GROUND_AMSL_M,
    HOLD,
    LAND,
    MISSION,
    NAN,
    OFFBOARD,
    POSCTL,
    RETURN,
    TAKEOFF,
    local,
    worldwide,
)

ACCEPTED, TEMPORARILY_REJECTED, DENIED, FAILED = 0, 1, 2, 4
Cases = list[Any]


def case(
    section: str, says: str, expected: Any, seen: Callable[..., Any], *arguments: Any, **named: Any
) -> Any:
    """One statement: what the document says, what is expected, and the experiment."""
    return pytest.param(
        functools.partial(seen, *arguments, **named), expected, id=f"{section}: {says}"
    )


def about(value: Any, within: float) -> Any:
    return pytest.approx(value, abs=within)


def between(least: float, most: float) -> Any:
    return pytest.approx((least + most) / 2.0, abs=(most - least) / 2.0 + 1e-9)


def field(name: str, seen: Callable[..., Any], *arguments: Any) -> Any:
    """One field of what an experiment returns."""
    return getattr(seen(*arguments), name)


def has(container: str, what: Any, seen: Callable[..., Any], *arguments: Any) -> bool:
    return what in field(container, seen, *arguments)


def entry(table: str, key: int, seen: Callable[..., Any], *arguments: Any) -> Any:
    """One entry of a table that an experiment returns; None: it is not there."""
    return field(table, seen, *arguments).get(key)


def said(words: str, seen: Callable[..., Any], *arguments: Any) -> bool:
    """Whether a STATUSTEXT has these words."""
    return any(words in text for text in field("texts", seen, *arguments))


# --- 1 and 2 --------------------------------------------------------------------------------------

RATES_HZ = {
    98.0: ("ATTITUDE",),
    49.0: ("HIGHRES_IMU", "ATTITUDE_QUATERNION", "GLOBAL_POSITION_INT"),
    29.5: ("LOCAL_POSITION_NED", "ODOMETRY"),
    9.9: (
        *("TIMESYNC", "ALTITUDE", "DISTANCE_SENSOR", "ATTITUDE_TARGET"),
        *("POSITION_TARGET_LOCAL_NED", "SERVO_OUTPUT_RAW", "VFR_HUD"),
    ),
    8.0: ("GPS_RAW_INT",),
    5.0: ("EXTENDED_SYS_STATE", "SYS_STATUS"),
    1.0: (
        *("HEARTBEAT", "MISSION_CURRENT", "ESTIMATOR_STATUS", "SYSTEM_TIME", "PING"),
        *("SCALED_PRESSURE", "OPEN_DRONE_ID_LOCATION", "OPEN_DRONE_ID_SYSTEM"),
        *("UNKNOWN_8", "GNSS_INTEGRITY"),
    ),
    0.5: ("BATTERY_STATUS", "HOME_POSITION", "VIBRATION", "CURRENT_MODE", "UNKNOWN_380"),
}
"""Messages of an onboard link; the dialect of the tests does not know 8 and 380."""
RATES = [
    case("2 rates", f"{kind} {hz:g} Hz", about(hz, 0.05 * hz), links.rate, kind)
    for hz, kinds in RATES_HZ.items()
    for kind in kinds
]

INTERVALS = {
    "ATTITUDE": (30, ACCEPTED),
    "LOCAL_POSITION_NED": (32, ACCEPTED),
    "GLOBAL_POSITION_INT": (33, ACCEPTED),
    "436": (436, ACCEPTED),
    "HEARTBEAT": (0, FAILED),
    "MISSION_CURRENT": (42, FAILED),
    "an unknown id": (9999, FAILED),
    "a message that it only receives": (84, FAILED),
}
SET_MESSAGE_INTERVAL = [
    *(
        case("2 intervals", f"result for {name}", result, links.set_interval, number, 100_000)
        for name, (number, result) in INTERVALS.items()
    ),
    *(
        case(
            "2 intervals", f"p{place + 3} must be 0", FAILED, links.set_interval, 30, 100_000, *rest
        )
        for place, rest in ((0, (1,)), (1, (0, 1)), (4, (0, 0, 0, 0, 1)))
    ),
    *(
        case("2 intervals", f"{kind} obeys", about(20.0, 0.2), links.rate_after, kind, number, 5e4)
        for kind, number in (("ATTITUDE", 30), ("GLOBAL_POSITION_INT", 33))
    ),
    case("2 intervals", "-1 stops", 0.0, links.rate_after, "LOCAL_POSITION_NED", 32, -1),
    case(
        "2 intervals",
        "0 restores the default",
        about(100.0, 1.0),
        *(links.rate_after, "ATTITUDE", 30, -1, 0),
    ),
    case("2 intervals", "GET_MESSAGE_INTERVAL works", 100_000, links.interval_told, 30),
    case(
        "1.9", "HEARTBEAT is fixed at 1 Hz", about(1.0, 0.1), links.rate_after, "HEARTBEAT", 0, 2e4
    ),
    case("1.9", "436 at 20 Hz: 2 Hz", about(2.0, 0.1), links.rate_after, "CURRENT_MODE", 436, 5e4),
    case("1.9", "436 at 20 Hz: at once on a change", between(0.0, 0.1), links.mode_is_told_after),
]

LINKS = [
    case("2", "system 1, component 1", {(1, 1)}, links.ids),
    case("2", "takes commands from any system (42/191)", True, links.armed_by, (42, 191)),
    case("2", "takes commands from any type", True, links.armed_by, (1, 25), kind=27),
    case("2", "a command to component 0 is taken", True, links.armed_by, target=(1, 0)),
    case("2", "a command to component 191 is not", False, links.armed_by, target=(1, 191)),
    case("2", "a command to another system is not", False, links.armed_by, target=(2, 1)),
    case("2", "a setpoint to 1/1 counts", (True, 0), links.setpoints_to, 1, 1),
    case("2", "a setpoint to 0/1 counts", (True, 0), links.setpoints_to, 0, 1),
    case("2", "a setpoint to 1/0 counts", (True, 0), links.setpoints_to, 1, 0),
    case("2", "a setpoint from system 42 counts", (True, 0), links.setpoints_to, 1, 1, source=42),
    case("2", "one to component 191 is ignored silently", (False, 0), links.setpoints_to, 1, 191),
    case("2", "one to another system is ignored silently", (False, 0), links.setpoints_to, 2, 1),
    case(
        "2",
        "a companion's heartbeats have ended: text",
        True,
        lambda: "Connection to mission computer lost" in links.companion_lost()[0],
    ),
    case(
        "2",
        "a companion's heartbeats have ended: no action",
        (OFFBOARD, 4),
        lambda: links.companion_lost()[1:],
    ),
    case("1.3", "no STATUSTEXT to a companion, but EVENT", (False, True), links.texts_and_events),
    case("1.3", "nor for its own heartbeat", (False, True), links.texts_and_events, 18),
    case("1.3", "STATUSTEXT to a ground station", (True, True), links.texts_and_events, 6),
    case("1.3", "STATUSTEXT on that same link only", (False, True), links.texts_by_link),
    case(
        "2",
        "POSITION_TARGET_LOCAL_NED in OFFBOARD",
        True,
        *(has, "kinds", "POSITION_TARGET_LOCAL_NED", links.traffic),
    ),
    case(
        "2",
        "POSITION_TARGET_GLOBAL_INT only in AUTO modes",
        about((0.0, 10.0), 0.2),
        links.global_target_rates,
    ),
    case("2", "no WIND_COV of a quad", False, has, "kinds", "WIND_COV", links.traffic),
    case("2", "WIND_COV of a fixed wing", about(9.9, 0.5), wing.wind_rate),
    case(
        "2",
        "messages per second (480 there, 409 in px4-offboard-short.tlog)",
        about(409.0, 15.0),
        *(field, "per_second", links.traffic),
    ),
    case(
        "2",
        "kB/s (14-17 there, 24.3 in px4-offboard-short.tlog)",
        about(24.3, 1.2),
        *(field, "kilobytes_per_second", links.traffic),
    ),
    case(
        "2",
        "gimbal commands of its own at a change of the mode",
        {1000, 1001},
        lambda: {command for command, _ in links.traffic().commands},
    ),
    case("2", "GPS_GLOBAL_ORIGIN never comes later; 512 brings it", (0, 1), links.origins),
    case(
        "2",
        "capabilities 0xE8FF",
        0xE8FF,
        *(links.requested, 148, "AUTOPILOT_VERSION", "capabilities"),
    ),
    case(
        "0",
        "flight_sw_version 17891392",
        17891392,
        *(links.requested, 148, "AUTOPILOT_VERSION", "flight_sw_version"),
    ),
    case("2", "integer parameters are bit-cast", 3, links.whole_parameter, "GF_ACTION", 3),
    case("2", "signed frames are accepted as if unsigned", True, lambda: links.signing()[0]),
    case("2", "SETUP_SIGNING is ignored", True, lambda: links.signing()[1]),
    case("2", "PX4 never signs", False, lambda: links.signing()[2]),
    case("2", "no TRAJECTORY_REPRESENTATION", True, links.leaves_it_cold, links.ROUTE),
    case("2", "OBSTACLE_DISTANCE: not in OFFBOARD", True, links.leaves_it_cold, links.OBSTACLES),
]

DEFAULTS: dict[str, dict[str, float]] = {
    "1": {"COM_OF_LOSS_T": 1.0, "COM_OBL_RC_ACT": 0, "MPC_LAND_SPEED": 0.7},
    "0": {"SIH_KDV": 1.0},
    "2": {"COM_OBC_LOSS_T": 5, "NAV_DLL_ACT": 0},
    "3": {"COM_RC_IN_MODE": 1, "COM_ARM_WO_GPS": 1, "SYS_FAILURE_EN": 1, "COM_LOW_BAT_ACT": 3}
    | {"MIS_TAKEOFF_ALT": 2.5, "COM_DISARM_PRFLT": 10.0, "COM_DISARM_LAND": 2.0},
    "4": {"MPC_XY_VEL_MAX": 12.0, "MPC_Z_VEL_MAX_UP": 3.0, "MPC_Z_VEL_MAX_DN": 1.5}
    | {"MPC_TILTMAX_AIR": 45.0},
    "5": {"MPC_XY_P": 0.95},
    "6": {"COM_RC_OVERRIDE": 1, "COM_FAIL_ACT_T": 5.0, "NAV_RCL_ACT": 2, "COM_RCL_EXCEPT": 0}
    | {"RTL_RETURN_ALT": 30.0},
    "7": {"GF_PREDICT": 0, "GF_ACTION": 2},
    "8": {"EKF2_NOAID_TOUT": 5_000_000, "SIM_GPS_USED": 10},
}
WING_DEFAULTS = {"FW_AIRSPD_TRIM": 15.0, "NAV_LOITER_RAD": 80.0, "NAV_FW_ALT_RAD": 10.0}
PARAMETERS = [
    *(
        case(section, f"{name} {value:g}", pytest.approx(value), links.default, name)
        for section, values in DEFAULTS.items()
        for name, value in values.items()
    ),
    *(
        case("10", f"{name} {value:g}", value, links.default, name, "plane")
        for name, value in WING_DEFAULTS.items()
    ),
]

# --- 3: start, arming, modes ----------------------------------------------------------------------

MODES = {
    "OFFBOARD": OFFBOARD,
    "POSCTL": POSCTL,
    "ALTCTL": ALTCTL,
    "TAKEOFF": TAKEOFF,
    "LOITER": HOLD,
    "MISSION": MISSION,
    "RTL": RETURN,
    "LAND": LAND,
}
START = [
    case("3", "first heartbeat: status 0, AUTO:LOITER", (0, HOLD), field, "heartbeat", links.boot),
    case(
        "3",
        "STANDBY 2.8 to 4.0 s after the first heartbeat",
        between(2.8, 4.0),
        lambda: links.boot().standby_s - links.boot().heartbeat_s,
    ),
    case(
        "3",
        "armable 2.8 to 5.0 s after the first heartbeat",
        between(2.8, 5.0),
        lambda: links.boot().armable_s - links.boot().heartbeat_s,
    ),
    case(
        "3",
        "fixed wing: armable after 4.2 s of simulated time",
        about(4.2, 0.3),
        *(field, "armable_s", links.boot, "plane"),
    ),
    case("3", "PREARM is never in present or enabled", 0, field, "masks", links.boot),
    case("3", "PREARM: can arm in AUTO:LOITER", True, links.prearm_in, HOLD),
    case("3", "PREARM: not in OFFBOARD without a stream", False, links.prearm_in, OFFBOARD),
    case("3", "arms without RC and ground station", True, links.armed_by),
    *(
        case(
            "3 modes" if name != "OFFBOARD" else "1.2",
            f"{name} is {custom:#010x} and accepted while disarmed",
            custom,
            lambda custom: links.disarmed_mode(custom)[0],
            custom,
        )
        for name, custom in MODES.items()
    ),
    case(
        "3",
        "SET_MODE does it too",
        OFFBOARD,
        lambda: links.disarmed_mode(OFFBOARD, old=True)[0],
    ),
    case("3", "status 0: OFFBOARD without a stream", (OFFBOARD, 0), links.disarmed_mode, OFFBOARD),
    case("3", "status 3: disarmed and armable", (HOLD, 3), links.disarmed_mode, HOLD),
    case("3", "status 4: armed and normal", 4, lambda: links.hover().status),
    case("3", "status 5: failsafe active", 5, field, "status", offboard.loss, 5),
    case(
        "1.1",
        "two ACKs of 176: ACCEPTED, then the real one, in some ms",
        [(ACCEPTED, True), (TEMPORARILY_REJECTED, True)],
        lambda: links.mode_results(links.without_stream(), OFFBOARD),
    ),
    case(
        "1.1",
        "two ACKs of 176 also when it is well",
        [(ACCEPTED, True), (ACCEPTED, True)],
        lambda: links.mode_results(links.hover(), HOLD),
    ),
    case(
        "1.2",
        "arming in OFFBOARD without a stream: result 1",
        TEMPORARILY_REJECTED,
        links.arming_in_offboard_without_stream,
    ),
    case(
        "3",
        "one earlier setpoint is enough on the ground",
        True,
        *(links.enters_offboard_after, 1, 0.05),
        airborne=False,
    ),
    case(
        "3",
        "and in flight within 0.6 s",
        True,
        *(links.enters_offboard_after, 1, 0.6),
        airborne=True,
    ),
    case(
        "3",
        "a setpoint before OFFBOARD is proof of life only",
        about(0.0, 0.7),
        links.early_setpoint_is_flown,
    ),
    case(
        "3", "lift-off 1.7 s (2.1 in the log)", between(1.6, 2.3), field, "lift_off_s", links.climb
    ),
    case("3", "9.5 m after 7.9 s", about(7.9, 0.8), field, "to_9_5_m_s", links.climb),
    case("3", "max climb 2.8 m/s", about(2.8, 0.28), field, "fastest_m_s", links.climb),
    case("3", "no overshoot", about(10.0, 0.7), field, "highest_m", links.climb),
    case(
        "3",
        "velocity only takes off too",
        about(1.0, 0.2),
        lambda: links.climb(by_velocity=True).fastest_m_s,
    ),
    case(
        "3",
        "NAV_TAKEOFF: AUTO:TAKEOFF then AUTO:LOITER",
        [TAKEOFF, HOLD],
        lambda: links.commanded_takeoff()[0],
    ),
    case(
        "3",
        "NAV_TAKEOFF: AUTO:LOITER after 7.8 s",
        about(7.8, 1.0),
        lambda: links.commanded_takeoff()[1],
    ),
    case(
        "3",
        "NAV_TAKEOFF with NaN climbs to 2.5 m",
        about(2.5, 0.7),
        lambda: links.commanded_takeoff()[2],
    ),
    case("3", "armed without takeoff: 10 s", between(10.0, 11.1), links.disarms_unflown_after),
    case("3", "NAV_LAND switches to AUTO:LAND", (0, LAND), lambda: links.landing()[:2]),
    case(
        "3",
        "disarmed 2 s after landing",
        between(1.8, 3.1),
        field,
        "disarms_after_s",
        links.landing,
    ),
    case("3", "after the landing OFFBOARD again", OFFBOARD, field, "mode_after", links.landing),
    case(
        "3",
        "a stream and an arm command then fly off",
        between(3.0, 6.7),
        *(field, "height_after_arming_m", links.landing),
    ),
    case(
        "3",
        "DO_REPOSITION with p2 1: AUTO:LOITER",
        (ACCEPTED, HOLD),
        *(links.after_command, 192, -1, 1, 0, NAN),
        point=(10.0, 0.0, GROUND_AMSL_M + 15.0),
    ),
    case(
        "3",
        "DO_SET_HOME by COMMAND_INT shifts home at once",
        about((ACCEPTED, GROUND_AMSL_M + 5.0, 30.0), 1.0),
        links.home_moved,
    ),
    case("3", "DO_CHANGE_SPEED: 0, no effect", about((0, 6.0), 0.3), links.speed_after_change),
]

# --- 4: masks and frames, limits, steps -----------------------------------------------------------

ONWARD, THERE, UP = (3.0, 1.0, -1.0), (10.0, 5.0, -12.0), (0.0, 0.0, -15.0)
STANDS = about((0.0, 0.0, 0.0), 0.4)
MASKS = [
    case("4", "position", about((10.0, 5.0, 12.0), 0.7), offboard.ends_up, local(THERE)),
    case(
        "4",
        "position + velocity: the point and v / MPC_XY_P",
        about((10.0 + 1.0 / 0.95, 5.0, 12.0), 0.7),
        *(offboard.ends_up, local(THERE, (1.0, 0.0, 0.0))),
    ),
    case(
        "4",
        "position + velocity + acceleration",
        about((10.0, 5.0, 12.0), 0.7),
        *(offboard.ends_up, local(THERE, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))),
    ),
    case(
        "4", "velocity", about((3.0, 1.0, 1.0), 0.3), offboard.velocity_after, local(None, ONWARD)
    ),
    case(
        "4", "acceleration only", True, offboard.keeps_offboard, local(None, None, (0.5, 0.0, 0.0))
    ),
    case("4", "with yaw", about(60.0, 3.0), offboard.heading_after, local(UP, yaw=math.pi / 3)),
    case(
        "4",
        "with yaw rate",
        about(36.0, 6.0),
        *(offboard.heading_after, local(UP, yaw_rate=math.radians(6.0))),
    ),
    case(
        "4",
        "yaw and yaw rate ignored: keeps heading",
        about(0.0, 3.0),
        offboard.heading_after,
        local(UP),
    ),
    case(
        "4",
        "z position + xy velocity",
        about((3.0, 0.0, 0.0), 0.4),
        *(offboard.velocity_after, local(UP, (3.0, 0.0, 0.0), mask=0xDE3)),
    ),
    case(
        "4",
        "xy position + z velocity",
        about((10.0, 5.0, 15.0 + 15.0 * 0.3), 1.0),
        *(offboard.ends_up, local((10.0, 5.0, 0.0), (0.0, 0.0, -0.3), mask=0xDDC)),
    ),
    case(
        "4",
        "frame 8 velocity, rotated by yaw",
        about((0.0, 3.0), 0.3),
        offboard.turned_body_velocity,
    ),
    case(
        "4",
        "frame 8 acceleration",
        True,
        *(offboard.keeps_offboard, local(None, None, (0.5, 0.0, 0.0), frame=8)),
    ),
    case("4", "frame 8 position: lost", None, offboard.velocity_after, local(UP, frame=8)),
    *(
        case(
            "4",
            f"frame {frame}: lost",
            None,
            *(offboard.velocity_after, local(None, ONWARD, frame=frame)),
        )
        for frame in (0, 2, 3, 7, 9, 12, 20, 21)
    ),
    case("4", "all ignored: lost", None, offboard.velocity_after, local(mask=0xDFF)),
    case("4", "yaw only: lost", None, offboard.velocity_after, local(yaw=0.0)),
    case("4", "x only: brakes", STANDS, offboard.velocity_after, local(UP, mask=0xDFE)),
    case("4", "x and y without z: brakes", STANDS, offboard.velocity_after, local(UP, mask=0xDFC)),
    case("4", "mask 0", about((10.0, 5.0, 12.0), 0.7), offboard.ends_up, local(THERE, mask=0)),
    case(
        "4",
        "FORCE with acceleration: lost",
        None,
        *(offboard.velocity_after, local(UP, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), mask=0xE00)),
    ),
    case(
        "4",
        "FORCE without acceleration: harmless",
        about((10.0, 5.0, 12.0), 0.7),
        *(offboard.ends_up, local(THERE, mask=0xFF8)),
    ),
    case("4", "NaN position: lost", None, offboard.velocity_after, local((NAN, NAN, NAN))),
    case(
        "4",
        "NaN velocity: position only",
        about((10.0, 5.0, 12.0), 0.7),
        *(offboard.ends_up, local(THERE, (NAN, NAN, NAN))),
    ),
]
_ABOVE = {5: GROUND_AMSL_M + 12.0, 6: 12.0, 11: 12.0}
GLOBAL_FRAMES = [
    *(
        case(
            "4 GLOBAL_INT",
            f"frame {frame} is accepted",
            about((20.0, 10.0, 12.0), 2.0),
            *(offboard.ends_up, worldwide(20.0, 10.0, height_m, frame=frame)),
        )
        for frame, height_m in _ABOVE.items()
    ),
    *(
        case(
            "4 GLOBAL_INT",
            f"frame {frame} is rejected",
            None,
            *(offboard.velocity_after, worldwide(20.0, 10.0, 12.0, frame=frame)),
        )
        for frame in (0, 3, 10)
    ),
    *(
        case(
            "4 GLOBAL_INT",
            f"velocity only with frame {frame}",
            about((3.0, 1.0, 1.0), 0.3),
            *(offboard.velocity_after, worldwide(0, 0, 0, ONWARD, mask=0xDC7, frame=frame)),
        )
        for frame in (0, 3, 5, 6, 10, 11)
    ),
    case(
        "4 GLOBAL_INT",
        "altitude + horizontal velocity: brakes",
        STANDS,
        *(offboard.velocity_after, worldwide(0, 0, 510.0, ONWARD, mask=0xDE3)),
    ),
    case(
        "4 GLOBAL_INT",
        "position without altitude: dropped as a whole",
        None,
        *(offboard.velocity_after, worldwide(20.0, 0.0, 510.0, mask=0xDFC)),
    ),
    case(
        "1.6",
        "frame 6, home 5 m up, 10 m asked: 0.35 m below home",
        about(-0.35, 1.0),
        *(offboard.with_home_above, 6),
    ),
    case("1.6", "frame 5 is right", about(10.0, 1.0), offboard.with_home_above, 5),
]
STEPS = [
    case("4", "asked 15 m/s, flew 11.9", about((11.9, 0.0), 0.25), offboard.reached, 15.0, 0.0),
    case("4", "vz -6: -2.8 m/s", about((0.0, -2.8), 0.28), offboard.reached, 0.0, -6.0),
    case("4", "vz 6: 1.6 m/s", about((0.0, 1.6), 0.16), offboard.reached, 0.0, 6.0),
    case(
        "4 jump 30 m", "tilt 45 deg", about(45.0, 2.0), field, "tilt_deg", offboard.jump, 30.0, 12.0
    ),
    case(
        "4 jump 30 m", "8.8 m/s", about(8.8, 0.5), field, "fastest_m_s", offboard.jump, 30.0, 12.0
    ),
    case(
        "4 jump 30 m",
        "29 m in 4.8 s",
        about(4.8, 0.4),
        field,
        "to_29_m_s",
        offboard.jump,
        30.0,
        12.0,
    ),
    case(
        "4 jump 30 m",
        "overshoot 1.4 m",
        about(31.4, 0.7),
        *(field, "farthest_m", offboard.jump, 30.0, 12.0),
    ),
    case(
        "4 jump 500 m", "9.7 m/s", about(9.7, 0.3), field, "at_last_m_s", offboard.jump, 500.0, 25.0
    ),
    case("4 jump 500 m", "no rejection", True, field, "offboard", offboard.jump, 500.0, 25.0),
    case(
        "4 jump 500 m",
        "and back",
        about(9.7, 0.3),
        field,
        "at_last_m_s",
        offboard.jump,
        -500.0,
        25.0,
    ),
    case(
        "4 from 12 m/s",
        "position here: overshoot 10.0 m (15 %: 0.1 s of delay is 1.2 m)",
        about(10.0, 1.5),
        *(field, "farthest_m", offboard.stop, "position"),
    ),
    case(
        "4 from 12 m/s",
        "velocity 0: 11.0 m",
        about(11.0, 1.65),
        *(field, "metres", offboard.stop, "velocity"),
    ),
    case(
        "4 from 12 m/s",
        "velocity 0: 2.3 s",
        about(2.3, 0.35),
        *(field, "seconds", offboard.stop, "velocity"),
    ),
    case(
        "4 from 12 m/s",
        "AUTO:LOITER: 31.2 m",
        about(31.2, 3.1),
        *(field, "metres", offboard.stop, "hold"),
    ),
    case(
        "4 from 12 m/s",
        "AUTO:LOITER: 5.6 s",
        about(5.6, 0.85),
        *(field, "seconds", offboard.stop, "hold"),
    ),
    case(
        "4 from 12 m/s",
        "AUTO:LOITER: having stopped it stays",
        between(0.0, 0.5),
        *(field, "again_m_s", offboard.stop, "hold"),
    ),
    case("4", "10 m/s, stream stops: 18.5 m in all", about(18.5, 1.85), offboard.frozen),
]

# --- 6: loss of the stream ------------------------------------------------------------------------

LOSS_MODES = {0: POSCTL, 1: ALTCTL, 3: RETURN, 4: LAND, 5: HOLD}
_NAMES = {0: "Position", 1: "Altitude", 3: "Return", 4: "Land", 5: "Hold"}
LOSS = [
    *(
        case("6 loss", f"{_NAMES[action]}: the mode", mode, field, "mode", offboard.loss, action)
        for action, mode in LOSS_MODES.items()
    ),
    *(
        case(
            "6 loss",
            f"{_NAMES[action]}: OFFBOARD by itself when the stream is back",
            between(0.0, 0.3),
            *(field, "back_s", offboard.loss, action),
        )
        for action in LOSS_MODES
    ),
    case(
        "6 loss", "Position: sinks 0.7 m/s", about(0.7, 0.1), field, "sinks_m_s", offboard.loss, 0
    ),
    case(
        "6 loss",
        "Position: drifts out the speed",
        between(5.0, 20.0),
        *(field, "metres", offboard.loss, 0),
    ),
    case(
        "6 loss",
        "Position: text",
        True,
        *(said, "Matching flight task was not able to run", offboard.loss, 0),
    ),
    case(
        "6 loss",
        "Altitude: sinks 0.5-0.7 m/s",
        between(0.5, 0.7),
        *(field, "sinks_m_s", offboard.loss, 1),
    ),
    case(
        "6 loss",
        "Return: climbs to 30 m above home",
        about(30.0, 1.0),
        *(field, "climbs_to_m", offboard.loss, 3),
    ),
    case("6 loss", "Return: returns", about((0.0, 30.0), 2.0), offboard.returned),
    case(
        "6 loss",
        "Land: descends 1.4 m/s at first",
        about(1.4, 0.14),
        *(field, "sinks_m_s", offboard.loss, 4),
    ),
    case(
        "6 loss",
        "Land: then 0.7 m/s",
        about(0.7, 0.1),
        offboard.sinks_low,
    ),
    case("6 loss", "Land: stops", about(0.0, 0.4), field, "speed_m_s", offboard.loss, 4),
    case(
        "6 loss",
        "Hold: stops in about 4 m (7.2 m in px4-offboard-short.tlog)",
        about(7.2, 1.4),
        *(field, "metres", offboard.loss, 5),
    ),
    case("6 loss", "Hold: holds", about(0.0, 0.4), field, "speed_m_s", offboard.loss, 5),
    case(
        "6 timeline",
        "1.06 s: EVENT 3087815",
        about(1.06, 0.1),
        *(entry, "events", 3087815, offboard.loss, 5),
    ),
    case(
        "6 timeline",
        "1.09 s: EVENT 14605264",
        about(1.09, 0.1),
        *(entry, "events", 14605264, offboard.loss, 5),
    ),
    case("6 timeline", "1.12 s: CURRENT_MODE", about(1.12, 0.1), field, "mode_s", offboard.loss, 5),
    case("6 timeline", "intended OFFBOARD", OFFBOARD, field, "intended", offboard.loss, 5),
    case(
        "6 timeline",
        "1.2 to 2.1 s: HEARTBEAT",
        between(1.1, 2.2),
        *(field, "heartbeat_s", offboard.loss, 5),
    ),
    *(
        case("6", f"{hz:g} Hz keeps OFFBOARD", [OFFBOARD], offboard.modes_at_rate, hz)
        for hz in (5.0, 2.0, 1.2)
    ),
    case(
        "6",
        "0.8 Hz flips between the modes every second",
        [OFFBOARD, HOLD] * 4,
        lambda: offboard.modes_at_rate(0.8)[:8],
    ),
    *(
        case("6", f"a gap of {gap_s} s", modes, offboard.modes_with_gap, gap_s)
        for gap_s, modes in ((0.5, {OFFBOARD}), (0.9, {OFFBOARD}), (1.2, {OFFBOARD, HOLD}))
    ),
    case(
        "6",
        "on the ground and armed: AUTO:LOITER after 1 s, no disarm",
        (about(1.1, 0.2), HOLD, True),
        offboard.loss_on_the_ground,
    ),
    case("1.5", "a commanded Hold is not undone", HOLD, offboard.commanded, HOLD),
    case("1.5", "a commanded Land is not undone", LAND, offboard.commanded, LAND),
]
PILOT = [
    case("6 pilot", "first sticks while disarmed: POSCTL", POSCTL, offboard.first_sticks),
    case("6 pilot", "stream stops: POSCTL", POSCTL, lambda: offboard.loss_with_pilot()[0]),
    case(
        "6 pilot",
        "stops in about 4 m",
        about(4.0, 1.5),
        lambda: offboard.loss_with_pilot()[1],
    ),
    case(
        "6 pilot",
        "holds position and altitude",
        about((0.0, 0.0), 0.7),
        lambda: offboard.loss_with_pilot()[2:4],
    ),
    case(
        "6 pilot",
        "stream resumes: OFFBOARD by itself",
        OFFBOARD,
        lambda: offboard.loss_with_pilot()[4],
    ),
    case(
        "6 pilot",
        "60 % of stick do not take over by default",
        OFFBOARD,
        lambda: offboard.takeover(1)[1],
    ),
    case(
        "6 pilot",
        "with COM_RC_OVERRIDE 3 within the second",
        between(0.0, 1.0),
        lambda: offboard.takeover(3)[0],
    ),
    case("6 pilot", "and it stays in POSCTL", POSCTL, lambda: offboard.takeover(3)[1]),
    case(
        "6 pilot",
        "until OFFBOARD is commanded",
        (ACCEPTED, OFFBOARD),
        lambda: offboard.takeover(3)[2:],
    ),
    case(
        "6 pilot",
        "lost: AUTO:LOITER, then AUTO:RTL",
        [OFFBOARD, HOLD, RETURN],
        lambda: [mode for _, mode in offboard.pilot_lost()],
    ),
    case(
        "6 pilot",
        "lost: AUTO:LOITER after about 1 s",
        about(1.0, 0.5),
        lambda: offboard.pilot_lost()[1][0],
    ),
    case(
        "6 pilot",
        "lost: AUTO:RTL 5 s later",
        about(5.0, 0.2),
        lambda: offboard.pilot_lost()[2][0] - offboard.pilot_lost()[1][0],
    ),
    case(
        "6 pilot",
        "lost: COM_RCL_EXCEPT 4 exempts OFFBOARD",
        [OFFBOARD],
        lambda: [mode for _, mode in offboard.pilot_lost(4)],
    ),
]

# --- 7 and 8 --------------------------------------------------------------------------------------

MISSIONS = [
    case("7", "a mission is uploaded from component 191", 0, field, "uploaded", mission.mission),
    case("7", "frames come back as uploaded", [6, 5, 6, 6], field, "frames", mission.mission),
    case("7", "MISSION_START", (ACCEPTED, MISSION), lambda: mission.mission()[2:4]),
    case("7", "back to OFFBOARD", (ACCEPTED, OFFBOARD), lambda: mission.mission()[4:6]),
    case("7", "MISSION_CLEAR_ALL per type", (0, (0, 1)), lambda: mission.mission()[6:]),
    case("7", "a fence is uploaded", 0, field, "uploaded", mission.fence),
    case("7", "Hold 0 to 1 s after crossing", between(0.0, 1.0), field, "hold_s", mission.fence),
    case("7", "GF_ACTION 2: AUTO:LOITER", HOLD, field, "mode", mission.fence),
    case("7", "stopped 5 m inside", about(5.0, 1.5), field, "inside_m", mission.fence),
    case(
        "7",
        "text of the fence",
        True,
        *(said, "Geofence: approaching or outside geofence", mission.fence),
    ),
    case(
        "7",
        "the stream does not bring OFFBOARD back",
        HOLD,
        *(field, "mode_with_stream", mission.fence),
    ),
    case("1.10", "OFFBOARD can be commanded inside", 0, field, "commanded", mission.fence),
    case("7", "and it goes deeper", between(8.0, 24.0), field, "deeper_m", mission.fence),
    case("7", "DO_REPOSITION into it is refused", DENIED, mission.reposition_into_fence),
]


def _dead_reckoning() -> set[int]:
    return {mission.gps_loss().flags[second] for second in range(5)}


GPS_LOSS = [
    case("8", "0.1 s: fix_type 0", about(0.1, 0.1), field, "fix_s", mission.gps_loss),
    case("8", "0 to 5 s: OFFBOARD, 5.1 s: AUTO:LAND", [OFFBOARD, LAND], mission.blind_modes),
    case("8", "5.1 s", about(5.1, 0.1), lambda: mission.gps_loss().modes[1][0]),
    case("8", "system_status 5", 5, field, "status", mission.gps_loss),
    case("8", "0 to 5 s: flags 0x37f", {0x37F}, _dead_reckoning),
    case("8", "accuracy 0.3 m", about(0.3, 0.1), entry, "accuracy_m", 0, mission.gps_loss),
    case("8", "to 1.2 m", about(1.2, 0.3), entry, "accuracy_m", 5, mission.gps_loss),
    case("8", "to 29 m", about(29.0, 3.0), entry, "accuracy_m", 29, mission.gps_loss),
    case(
        "8",
        "5.1 s: EVENT 12770418",
        about(5.1, 0.1),
        *(entry, "events", 12770418, mission.gps_loss),
    ),
    case("8", "flags 0x365", 0x365, entry, "flags", 6, mission.gps_loss),
    case(
        "8",
        "7.3 s: EVENT 14699175",
        about(7.3, 0.1),
        *(entry, "events", 14699175, mission.gps_loss),
    ),
    case("8", "flags 0x65", 0x65, entry, "flags", 9, mission.gps_loss),
    case("8", "sinks 0.6-1.0 m/s", between(0.6, 1.0), field, "sinks_m_s", mission.gps_loss),
    case("8", "drift about 1 m/s", about(1.0, 0.5), field, "moves_m_s", mission.gps_loss),
    case(
        "1.8",
        "positions keep flowing at full rate",
        about((30.0, 50.0), 1.0),
        *(field, "rates_hz", mission.gps_loss),
    ),
    case(
        "8",
        "fix back + 1.5 s: EVENT 15292483",
        about(1.5, 0.3),
        *(entry, "back_events", 15292483, mission.gps_loss),
    ),
    case("8", "jumps 31 m (20 %)", about(31.0, 6.2), field, "jump_m", mission.gps_loss),
    case(
        "8",
        "flags 0x33f (0x37f as high up as here)",
        0x33F,
        lambda: mission.gps_loss().flags_back & ~0x40,
    ),
    case(
        "8", "+ 2.5 s: OFFBOARD by itself", about(2.5, 0.3), field, "offboard_s", mission.gps_loss
    ),
    case(
        "8", "and it climbs to the target", between(5.0, 40.0), field, "climbs_m", mission.gps_loss
    ),
]

# --- 10 -------------------------------------------------------------------------------------------

WING = [
    case("10", "NAV_TAKEOFF, then AUTO:LOITER", [TAKEOFF, HOLD], field, "modes", wing.departure),
    case("10", "20 m after 10 s", about(10.0, 1.0), field, "to_20_m_s", wing.departure),
    case("10", "AUTO:LOITER after 22 s", about(22.0, 2.0), field, "hold_s", wing.departure),
    case("10", "with NaN AUTO:TAKEOFF for 90 s", TAKEOFF, wing.endless_takeoff),
    case(
        "10",
        "after NAV_TAKEOFF the heartbeat may lag by up to 1 s",
        between(0.0, 1.1),
        wing.takeoff_is_told_after,
    ),
    case("10", "80.0 m within 0.4 m", about((80.0, 80.0), 0.4), wing.circle_flown, 0.0),
    case(
        "10",
        "DO_REPOSITION's radius is ignored",
        about((80.0, 80.0), 0.4),
        wing.circle_flown,
        150.0,
    ),
    case("10", "altitude about 2 m off", about(2.0, 0.7), wing.wing_height),
    case("10", "position only stays in OFFBOARD", OFFBOARD, lambda: wing.wing_at_a_point()[0]),
    case(
        "10",
        "position only: circles tightly, 8-30 m off",
        (between(6.0, 20.0), between(15.0, 32.0)),
        lambda: wing.wing_at_a_point()[1:],
    ),
    case(
        "10",
        "altitude off by more than 10 m: loiters at 80 m until it fits",
        about((80.0, 80.0), 4.0),
        wing.wing_climbing_at_a_point,
    ),
    case(
        "10",
        "position + velocity follows the line",
        about(0.0, 1.0),
        *(field, "offset_m", wing.wing_on_a_line, 14.0),
    ),
    case(
        "10",
        "asking for 20 m/s changes nothing",
        about(0.0, 0.1),
        lambda: wing.wing_on_a_line(20.0).speed_m_s - wing.wing_on_a_line(14.0).speed_m_s,
    ),
    case(
        "10",
        "13.9 m/s ground speed",
        about(13.9, 0.3),
        *(field, "speed_m_s", wing.wing_on_a_line, 14.0),
    ),
    *(
        case(
            "10",
            f"{name} only: stays in OFFBOARD and keeps its bank",
            (OFFBOARD, about(0.0, 1.0)),
            *(wing.wing_without_position, setpoint),
        )
        for name, setpoint in (
            ("velocity", local(None, (14.0, 0.0, 0.0))),
            ("acceleration", local(None, None, (0.0, 1.0, 0.0))),
        )
    ),
    case("10 loss", "after the same 1.1 s", about(1.1, 0.1), field, "seconds", wing.wing_loss),
    case("10 loss", "AUTO:LOITER", HOLD, field, "mode", wing.wing_loss),
    case("10 loss", "at 80 m", about((80.0, 80.0), 0.8), field, "radius_m", wing.wing_loss),
    case("10 loss", "OFFBOARD by itself", between(0.0, 0.3), field, "back_s", wing.wing_loss),
    case("10", "NAV_LAND is accepted and disarms", (ACCEPTED, True), wing.landed_and_disarmed),
    case("10", "NAV_LAND descends in a circle", between(1.0, 9.0), wing.turns_while_landing),
]


@pytest.mark.parametrize(
    ("seen", "expected"),
    [
        *(RATES + SET_MESSAGE_INTERVAL + LINKS + PARAMETERS + START),
        *(MASKS + GLOBAL_FRAMES + STEPS + LOSS + PILOT + MISSIONS + GPS_LOSS + WING),
    ],
)
def test_the_simulator_does_what_px4_md_says(seen: Callable[[], Any], expected: Any) -> None:
    assert seen() == expected
