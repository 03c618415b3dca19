"""What is to be thought of the values of parameters; `parameter_rules` says of which.

Each takes a value in SI (angles in degrees) and the case, and returns a verdict, or None if the
value will do.  Sources: ardupilot.md (0, 3, 5, 7), px4.md (1, 4, 5, 6, 7, 10).
"""

import math
from typing import Final

from companion.mavlink.judgement import Case, Judge, Verdict, note, refused, to_set

_GRAVITY_M_S2: Final = 9.81
_SHORTEST_TIMEOUT_S: Final = 0.5
"""A stream of 5 to 10 Hz on a link that loses some must not trip it."""
_USUAL_TIMEOUT_S: Final = 1.0
_EASY: Final = 1.5
"""A circle to hold on is no tighter than this times the tightest, or there is no bank for wind."""
_WIND_M_S: Final = 5.0
"""Head wind that nobody is told of: a moderate breeze."""
_CORNERS: Final = 0.6
"""Share of WPNAV_ACCEL that ArduCopter follows a curve with; at 0.8 it was 14 m off."""
_ALL_THE_SAME: Final = 1e-6


def _up_to_tenths(value: float) -> float:
    return math.ceil(value * 10.0 - _ALL_THE_SAME) / 10.0


# --- when the setpoints end -----------------------------------------------------------------------


def _begins_to_brake_s(case: Case, braking: str, jerk: str, usual: tuple[float, float]) -> float:
    """From the time-out until it is as if it braked at once with its whole acceleration.

    0.25 s to notice, and half the time in which the acceleration builds up (jerk-limited): 0.5 s
    with ArduCopter's defaults, which is what was measured (ardupilot.md 3, "Stream stops").
    """
    acceleration = max(case.value(braking, usual[0]), 0.1)
    return 0.25 + 0.5 * acceleration / max(case.value(jerk, usual[1]), 0.1)


def _timeout(value: float, slack_s: float, case: Case, what: str) -> Verdict | None:
    """A time-out of the stream: short enough for the certified reach, long enough for a radio."""
    dead_man_s = case.mission.task.limits.dead_man_s
    shortest_s = max(_SHORTEST_TIMEOUT_S, 3.0 * case.mission.task.settings.position_period_s)
    longest_s = math.floor((dead_man_s - slack_s + _ALL_THE_SAME) * 10.0) / 10.0
    if longest_s < shortest_s:
        return refused(
            f"{what}; with {shortest_s:g} s, the least for a radio, that is "
            f"{shortest_s + slack_s:.1f} s, and vehicle.dead_man_s = {dead_man_s:g}",
            f"Set vehicle.dead_man_s to {_up_to_tenths(shortest_s + slack_s):g} or more",
        )
    if value > dead_man_s - slack_s + _ALL_THE_SAME:
        rule = (
            f"{what} for {value + slack_s:.1f} s, longer than vehicle.dead_man_s = {dead_man_s:g}"
        )
        return to_set(longest_s, rule)
    if value < shortest_s - _ALL_THE_SAME:
        rule = f"shorter than the {shortest_s:g} s in which a radio may lose setpoints"
        return to_set(min(_USUAL_TIMEOUT_S, longest_s), rule)
    return None


def guid_timeout(value: float, case: Case) -> Verdict | None:
    """ArduCopter's GUID_TIMEOUT, at least 0.1 s (ardupilot.md 3)."""
    slack_s = _begins_to_brake_s(case, "WPNAV_ACCEL", "PSC_JERK_XY", (2.5, 5.0))
    return _timeout(max(value, 0.1), slack_s, case, "after the last setpoint the vehicle flies on")


def offboard_timeout(value: float, case: Case) -> Verdict | None:
    """PX4's COM_OF_LOSS_T; the mode changes 0.12 s after it (px4.md 6)."""
    slack_s = 0.12 + _begins_to_brake_s(case, "MPC_ACC_HOR", "MPC_JERK_AUTO", (3.0, 4.0))
    return _timeout(value, slack_s, case, "after the last setpoint the vehicle flies on")


def offboard_timeout_of_a_plane(value: float, case: Case) -> Verdict | None:
    """PX4's COM_OF_LOSS_T; then it circles where it is (px4.md 10)."""
    return _timeout(value, 0.5, case, "after the last setpoint the plane flies straight on")


def brakes(value: float, case: Case) -> Verdict | None:
    """An acceleration, against the one that the certified reach is computed with."""
    planned = case.mission.task.limits.acceleration_m_s2
    if value >= planned - _ALL_THE_SAME:
        return None
    return refused(
        f"it brakes with {value:g} m/s2, and the mission counts on {planned:g}",
        f"Raise it, or set vehicle.acceleration_m_s2 to {value:g} or less",
    )


def brakes_and_turns(value: float, case: Case) -> Verdict | None:
    """ArduCopter's WPNAV_ACCEL limits how curves are followed, too."""
    refusal = brakes(value, case)
    if refusal is not None:
        return refusal
    limits = case.mission.task.limits
    turn_m_s2 = limits.speed_m_s**2 / limits.turn_radius_m
    if turn_m_s2 <= _CORNERS * value + _ALL_THE_SAME:
        return None
    return note(
        f"the mission's tightest turns take {turn_m_s2:.1f} m/s2: beyond {_CORNERS * value:.1f} it "
        "leaves the path by more than 10 m",
        f"Set vehicle.turn_radius_m to {math.ceil(limits.speed_m_s**2 / (_CORNERS * value))}",
    )


# --- speeds, tilt and turns -----------------------------------------------------------------------


def tilt(value: float, case: Case) -> Verdict | None:
    """Without drag, tilt is acceleration; how much drag there is nobody knows."""
    limits = case.mission.task.limits
    turn_m_s2 = limits.speed_m_s**2 / limits.turn_radius_m
    needed_m_s2 = max(limits.acceleration_m_s2, turn_m_s2)
    has_m_s2 = _GRAVITY_M_S2 * math.tan(math.radians(min(max(value, 0.0), 80.0)))
    if has_m_s2 >= needed_m_s2:
        return None
    degrees = math.degrees(math.atan(needed_m_s2 / _GRAVITY_M_S2))
    return refused(
        f"{value:g} deg of tilt give {has_m_s2:.1f} m/s2, and the mission's speed, turn radius "
        f"and acceleration ask for {needed_m_s2:.1f}",
        f"Allow {math.ceil(degrees)} deg or more, or fly slower and wider turns",
    )


def tilt_and_drag(value: float, case: Case) -> Verdict | None:
    """Of ArduCopter's own airframe: 10.2 m/s at 30 deg, 15.5 m/s at 45 deg (ardupilot.md 3)."""
    refusal = tilt(value, case)
    if refusal is not None:
        return refusal
    held_m_s = 15.5 * math.tan(math.radians(min(value, 80.0))) ** 0.762
    speed = case.mission.task.limits.speed_m_s
    if speed <= held_m_s - _WIND_M_S:
        return None
    return note(
        f"a usual quadcopter holds {held_m_s:.0f} m/s through the air at {value:g} deg of tilt: "
        f"{max(held_m_s - speed, 0.0):.0f} m/s more than the mission's speed, for head wind",
        "See that yours has less drag, allow more tilt, or fly slower",
    )


def speed_of_corrections(value: float, case: Case) -> Verdict | None:
    """WPNAV_SPEED does not limit velocities that are asked for (ardupilot.md 3)."""
    if value >= case.mission.task.limits.speed_m_s:
        return None
    return note(f"corrections and the autopilot's own return are no faster than {value:g} m/s")


def speed_of_offboard(value: float, case: Case) -> Verdict | None:
    """At MPC_XY_VEL_MAX it falls behind without recovery (px4.md 5)."""
    speed = case.mission.task.limits.speed_m_s
    if speed <= 0.8 * value + _ALL_THE_SAME:
        return None
    if speed <= 0.85 * value + _ALL_THE_SAME:
        return note(
            f"vehicle.speed_m_s = {speed:g} leaves less than 20 % to catch up with",
            f"Better {0.8 * value:.1f} m/s or less",
        )
    return refused(
        f"vehicle.speed_m_s = {speed:g} is more than 85 % of it: nothing is left to catch up with",
        f"Raise it to {math.ceil(speed / 0.8)} or more, or fly {0.8 * value:.1f} m/s or less",
    )


def take_off_speed(value: float, case: Case) -> Verdict | None:
    """The machine waits twice as long for a take-off as it plans with."""
    planned = case.mission.task.limits.climb_rate_m_s
    if value >= planned - _ALL_THE_SAME:
        return None
    rule = f"it climbs with {value:g} m/s at take-off, and the mission counts on {planned:g}"
    if 2.0 * value < planned:
        return refused(rule, f"Raise it, or set vehicle.climb_rate_m_s to {value:g}")
    return note(rule)


def _vertical(value: float, planned: float, verb: str, alternative: str) -> Verdict | None:
    if value >= planned - _ALL_THE_SAME:
        return None
    return refused(
        f"it {verb} with {value:g} m/s at most, and the mission asks for {planned:.1f}",
        f"Raise it to {_up_to_tenths(planned):g}, or {alternative}",
    )


def climbs(value: float, case: Case) -> Verdict | None:
    """Highest climb rate of a copter."""
    limits = case.mission.task.limits
    planned = min(limits.climb_rate_m_s, limits.speed_m_s)
    return _vertical(value, planned, "climbs", f"set vehicle.climb_rate_m_s to {value:g}")


def sinks(value: float, case: Case) -> Verdict | None:
    """Highest sink rate of a copter."""
    limits = case.mission.task.limits
    planned = min(limits.climb_rate_m_s, limits.speed_m_s * math.sin(limits.dive_angle_rad))
    return _vertical(value, planned, "sinks", f"set vehicle.climb_rate_m_s to {value:g}")


def plane_climbs(value: float, case: Case) -> Verdict | None:
    """Climb rate of a plane, which flies every climb at its speed."""
    limits = case.mission.task.limits
    planned = limits.speed_m_s * math.sin(limits.climb_angle_rad)
    return _vertical(value, planned, "climbs", "set a smaller vehicle.climb_angle_deg")


def plane_sinks(value: float, case: Case) -> Verdict | None:
    """Sink rate of a plane."""
    limits = case.mission.task.limits
    planned = limits.speed_m_s * math.sin(limits.dive_angle_rad)
    return _vertical(value, planned, "sinks", "set a smaller vehicle.dive_angle_deg")


def slowest(value: float, case: Case) -> Verdict | None:
    """Least airspeed."""
    speed = case.mission.task.limits.speed_m_s
    if speed >= value - _ALL_THE_SAME:
        return None
    rule = f"vehicle.speed_m_s = {speed:g} is slower than it may fly"
    return refused(rule, f"Fly {value:g} m/s or faster")


def fastest(value: float, case: Case) -> Verdict | None:
    """Highest airspeed."""
    speed = case.mission.task.limits.speed_m_s
    if speed <= value + _ALL_THE_SAME:
        return None
    rule = f"vehicle.speed_m_s = {speed:g} is faster than it may fly"
    return refused(rule, f"Fly {value:g} m/s or slower")


def cruise_note(value: float, case: Case) -> Verdict | None:
    """The speed of the autopilot's own modes."""
    speed = case.mission.task.limits.speed_m_s
    if abs(value - speed) <= 0.05 * speed:
        return None
    return note(f"on its own (return, loiter) it flies {value:g} m/s, the mission {speed:g}")


def only_speed(value: float, case: Case) -> Verdict | None:
    """PX4's fixed wing flies this, whatever it is asked for (px4.md 10)."""
    speed = case.mission.task.limits.speed_m_s
    if value > 1.05 * speed:
        return refused(
            f"it always flies this airspeed, and the mission counts on {speed:g} m/s or less",
            f"Set vehicle.speed_m_s to {value:g}",
        )
    if value < 0.95 * speed:
        return note(f"it always flies this airspeed; the mission counts on {speed:g} m/s")
    return None


def _tightest_circle_m(speed_m_s: float, bank_deg: float) -> float:
    bank = math.radians(min(max(bank_deg, 1.0), 80.0))
    return speed_m_s**2 / (_GRAVITY_M_S2 * math.tan(bank))


def bank(value: float, case: Case) -> Verdict | None:
    """The bank limits how tightly it turns."""
    limits = case.mission.task.limits
    tightest_m = _tightest_circle_m(limits.speed_m_s, value)
    if tightest_m <= limits.turn_radius_m + _ALL_THE_SAME:
        return None
    return refused(
        f"with {value:g} deg of bank its tightest turn at {limits.speed_m_s:g} m/s has a radius of "
        f"{tightest_m:.0f} m, and the mission turns with {limits.turn_radius_m:g} m",
        f"Set vehicle.turn_radius_m to {math.ceil(tightest_m)} or more",
    )


def _loiter(value: float, case: Case, wider_m: float, bank: str) -> Verdict | None:
    """Whether its own circles fit into those that the planner keeps clear."""
    limits = case.mission.task.limits
    if limits.hovers or abs(value) + wider_m <= limits.loiter_radius_m + _ALL_THE_SAME:
        return None
    rule = (
        f"its circles are flown with {abs(value) + wider_m:g} m, and the mission keeps "
        f"vehicle.loiter_radius_m = {limits.loiter_radius_m:g} clear"
    )
    fits_m = math.floor(limits.loiter_radius_m - wider_m)
    if fits_m < _EASY * _tightest_circle_m(limits.speed_m_s, case.value(bank, 45.0)):
        return refused(rule, f"Set vehicle.loiter_radius_m to {abs(value) + wider_m:g} or more")
    return to_set(math.copysign(fits_m, value), rule)


def ardupilot_loiter(value: float, case: Case) -> Verdict | None:
    """17 to 20 m larger than asked at 23 m/s (ardupilot.md 7)."""
    return _loiter(value, case, 20.0, "ROLL_LIMIT_DEG")


def px4_loiter(value: float, case: Case) -> Verdict | None:
    """Held within 0.4 m (px4.md 10)."""
    return _loiter(value, case, 5.0, "FW_R_LIM")


def take_off_height(value: float, case: Case) -> Verdict | None:
    """The autopilot's own take-off ends there; the companion climbs on."""
    limits, home_amsl_m = case.mission.task.limits, case.home_amsl_m
    if home_amsl_m is None:
        return None
    top_m = home_amsl_m + value
    if top_m > limits.ceiling_amsl_m:
        return refused(
            f"its take-off ends at {top_m:.0f} m AMSL, above the ceiling of "
            f"{limits.ceiling_amsl_m:g} m",
            f"Set it to {max(case.mission.take_off_amsl_m - home_amsl_m, 0.0):.0f}",
        )
    return None


# --- who else may take the vehicle ----------------------------------------------------------------


def takes_it_away(what: str) -> Judge:
    """For a failsafe that is off when it is 0."""

    def look(value: float, case: Case) -> Verdict | None:
        del case
        return note(what) if value else None

    return look


def off(what: str, remedy: str = "") -> Judge:
    """For something that ought not to be 0."""

    def look(value: float, case: Case) -> Verdict | None:
        del case
        return None if value else note(what, remedy)

    return look


def bit(bit: int, what: str, remedy: str = "") -> Judge:
    """For something that ought to have this bit."""

    def look(value: float, case: Case) -> Verdict | None:
        del case
        return None if int(value) & bit else note(what, remedy)

    return look


def guided_options(value: float, case: Case) -> Verdict | None:
    """GUID_OPTIONS: bits that change what setpoints mean."""
    del case
    if int(value) & (16 | 32):
        rule = "bits 4 and 5 let the vehicle drift off its setpoints' position or velocity"
        return refused(rule, f"Set it to {int(value) & ~(16 | 32)}")
    if int(value) & 64:
        return note("bit 6 flies positions as waypoints, which was not measured", "Clear bit 6")
    return None


def ground_station(value: float, case: Case) -> Verdict | None:
    """The companion speaks as the vehicle's system: its heartbeats must not count as a GCS's."""
    if value != case.value("MAV_SYSID", -1.0):
        return None
    return refused(
        "the companion has the vehicle's system id, so its heartbeats would hide the loss of the "
        "ground station",
        "Set it to the ground station's own, 255",
    )


def fence_action(value: float, case: Case) -> Verdict | None:
    """A fence that is on and does nothing."""
    if case.value("FENCE_ENABLE", 0.0) and not value:
        return note("the fence is on and only reports: nothing but the companion keeps to it")
    return None


def avoidance(value: float, case: Case) -> Verdict | None:
    """AVOID_ENABLE bit 1: proximity."""
    if case.mission.sends_obstacles and int(value) & 2:
        return note("its own avoidance will act on the OBSTACLE_DISTANCE that the companion sends")
    return None


def offboard_loss(value: float, case: Case) -> Verdict | None:
    """px4.md 6: without RC, Position, Altitude and Stabilized sink."""
    del case
    if value == 5:
        return None
    if value == 3:
        return note("when the stream stops it returns on a straight way that nobody has certified")
    if value == 4:
        return note("when the stream stops it lands, whatever is below")
    acts = {0: "sinks without RC", 1: "sinks without RC", 2: "falls off level without RC"}
    acts |= {6: "stops its motors", 7: "stops its motors"}
    return to_set(5.0, f"when the stream stops the vehicle {acts.get(int(value), 'does so')}")


def manual_loss(value: float, case: Case) -> Verdict | None:
    """COM_RCL_EXCEPT bit 2 exempts OFFBOARD (px4.md 6)."""
    if int(value) & 4 or case.value("COM_RC_IN_MODE", 0.0) == 4:
        return None
    return note(
        "bit 2 is not set: if the remote control is lost, PX4 takes OFFBOARD away",
        "Add 4 if the flight may go on without it",
    )


def px4_fence_action(value: float, case: Case) -> Verdict | None:
    """GF_ACTION (px4.md 7)."""
    del case
    if value == 4:
        return note("crossing its fence stops the motors")
    if value in (0, 1):
        return note("its fence only warns: nothing but the companion keeps to it")
    return None


def receivers(value: float, case: Case) -> Verdict | None:
    """SYS_HAS_GPS."""
    del case
    if value:
        return None
    return refused("the vehicle flies without GPS", "Set it to the number of its receivers")
