"""The differences that are known, and why they are there (reasons.py says what a reason is)."""

import math

from vehicle_sim.conformance.reasons import Reason
from vehicle_sim.conformance.rows import Row

_GPS_LOSS, _10MPS = "arducopter-gps-loss.tlog", "arducopter-guided-10mps.tlog"
_STREAM_FAULTS = "arducopter-guided-global-stream-faults.tlog"
_PLANE = "arduplane-guided-reposition.tlog"
_PX4_LOSS, _PX4_8MPS = "px4-gps-loss.tlog", "px4-offboard-8mps.tlog"
_PX4_SHORT, _PX4_WING = "px4-offboard-short.tlog", "px4-fixedwing-offboard.tlog"


def _reason(
    recordings: str, kind: str, names: str, why: str, *, shown: str = ".*", most: float = math.inf
) -> Reason:
    return Reason(recordings=recordings, kind=kind, names=names, why=why, shown=shown, most=most)


_EVERYWHERE = (
    _reason(
        "*.tlog",
        "parameter",
        "param_count and param_index",
        "the simulated autopilot has the parameters that do something or are asked for: some "
        "hundreds of the real one's 879 to 1399",
    ),
)

_LEARNT = "until the estimator is aligned the real heading is 13 deg off; the simulated is right"
_ARDUPILOT = (
    _reason(_GPS_LOSS, "motion", "0 s to 10 s", _LEARNT, shown=r"1[23]\..* of heading.*", most=1.4),
    _reason(_10MPS, "motion", "0 s to 10 s", _LEARNT, shown=r"1[23]\..* of heading.*", most=1.4),
    _reason(
        _GPS_LOSS,
        "echo",
        "coordinate_frame 1, type_mask 0xc07",
        "GUIDED holds for 30 ms before the take-off begins: the simulated one happens to speak in "
        "that time, the real one 50 ms later",
    ),
    _reason(
        _GPS_LOSS,
        "track",
        "240 s to 250 s",
        "2.1 m off at the end of a chase over 400 m; cause not found",
        most=1.2,
    ),
    _reason(
        _STREAM_FAULTS,
        "track",
        "220 s to 230 s",
        "when everything is ignored the real one stops 2 m earlier; cause not found",
        most=1.3,
    ),
    _reason(
        _STREAM_FAULTS,
        "track",
        "240 s to 250 s",
        "chasing at 15 m/s a target that is 70 m ahead, the real one swings 14 m wider; "
        "cause not found",
        most=1.6,
    ),
    _reason(
        _STREAM_FAULTS,
        "parameter",
        "MOT_THST_HOVER",
        "the throttle that the real one learnt to hover with: 0.376 in this flight, 0.390 in the "
        "two others; the simulated one always learns 0.390",
        most=4.0,
    ),
    _reason(
        _PLANE,
        "track",
        "0 s to 10 s",
        "before the first fix the real one adds up its noise from latitude and longitude 0: 34 m "
        "at 8 s; the simulated one says 0",
        most=2.5,
    ),
    _reason(
        _PLANE,
        "filling",
        "WIND",
        "there is no wind, and the simulated one knows it; the real one estimates a little",
        shown=r".*speed_z -?0\.0",
    ),
)

_LOG_NAME = "event 17980399"
_WHEN = "its arguments are the date and time of the recording"
_DISPLACED = (
    "after the GPS loss the real one lands where its estimate says 0.65 m below the "
    "origin, 3 s later "
    "than the simulated one: presumably a height error that remained"
)
_PX4 = (
    _reason(_PX4_LOSS, "event arguments", _LOG_NAME, _WHEN),
    _reason(_PX4_WING, "event arguments", _LOG_NAME, _WHEN),
    _reason(_PX4_SHORT, "event arguments", _LOG_NAME, _WHEN),
    _reason(_PX4_LOSS, "landed", "ON_GROUND", _DISPLACED, most=1.6),
    _reason(_PX4_LOSS, "estimator", "0x33f", _DISPLACED, most=2.2),
    _reason(_PX4_LOSS, "estimator", "0x37f", _DISPLACED, most=1.6),
    _reason(_PX4_LOSS, "event", r"event (26622124|32794487) \(levels 0x66\)", _DISPLACED, most=1.6),
    _reason(_PX4_LOSS, "count", "POSITION_TARGET_GLOBAL_INT", _DISPLACED, most=1.5),
    _reason(_PX4_LOSS, "target", "200 s to 210 s", _DISPLACED, shown=r"silent for \d s"),
    _reason(
        _PX4_8MPS,
        "estimator",
        "0x3[bf]f",
        "after disarming the flag of the height above ground is off in this flight (0x3bf) "
        "and on in "
        "the two others (0x3ff); cause not found",
    ),
    _reason(
        _PX4_8MPS,
        "estimator",
        "0x33f",
        "the flag of the height above ground goes off 3 s earlier in the simulated "
        "descent; cause not "
        "found",
        most=1.5,
    ),
    _reason(
        _PX4_8MPS,
        "filling",
        "ODOMETRY",
        "twenty messages on the ground until the client switches it off: the real one's noise "
        "shows, the simulated one stands still",
    ),
    _reason(
        _PX4_8MPS,
        "filling",
        "POSITION_TARGET_GLOBAL_INT",
        "the yaw that is held while landing shifts by 2 mrad in the real one",
        shown=r"yaw -?\d\S*",
    ),
    _reason(
        _PX4_SHORT,
        "estimator",
        "0x3[37]f",
        "the height above ground fails for 2 s after take-off in two flights of three: not here",
    ),
    _reason(
        _PX4_SHORT,
        "count",
        "POSITION_TARGET_GLOBAL_INT",
        "sent until it has disarmed, which the simulated one does 0.6 s later",
        most=3.0,
    ),
    _reason(
        _PX4_SHORT,
        "filling",
        "HIGHRES_IMU",
        "commonest mask 63 at 50 Hz, 7167 in the flights at 5 Hz; presumably few messages "
        "have news of "
        "the slow sensors",
        shown="fields_updated 7167",
    ),
    _reason(
        _PX4_SHORT,
        "filling",
        "ODOMETRY",
        "the real estimator resets ten times until it flies, the simulated one only at boot; its "
        "covariance is not modelled",
    ),
    _reason(
        _PX4_SHORT,
        "motion",
        "(40|50) s to (50|60) s",
        "after the fall back to Hold the heading settles 12 deg to the left of the last "
        "setpoint in the "
        "real one, 9 deg to the right in the simulated one; cause not found",
        shown=r"2\d\..* of heading.*",
        most=1.1,
    ),
    _reason(
        _PX4_SHORT,
        "motion",
        "60 s to 70 s",
        "on the ground the real one lies with a roll of 4.7 deg: as its simulator let it down",
        shown=r"4\..* of tilt.*",
        most=2.6,
    ),
    _reason(
        _PX4_WING,
        "parameter",
        "CAL_BARO0_OFF",
        "the offset that this flight's barometer had been calibrated to; 0 in the other flights",
    ),
    _reason(
        _PX4_WING,
        "estimator",
        "0x(3ff|37f)",
        "on the ground the real one says that it stands still (0x80) while it still rolls out",
    ),
    _reason(
        _PX4_WING,
        "filling",
        "VIBRATION",
        "an accelerometer of the real one had clipped twice before the recording began",
        shown="clipping_0 0",
    ),
    _reason(
        _PX4_WING,
        "filling",
        "WIND_COV",
        "there is no wind, and the simulated one knows it; the real one estimates a little",
    ),
    _reason(
        _PX4_WING,
        "count",
        "OPEN_DRONE_ID_(LOCATION|SYSTEM)",
        "one of each, on its way when the client switched them off",
        shown="0",
    ),
)

REASONS: tuple[Reason, ...] = (*_EVERYWHERE, *_ARDUPILOT, *_PX4)


def reason_for(recording: str, row: Row) -> str | None:
    """Why this row does not agree; None if nobody knows."""
    found = (r.why for r in REASONS if r.explains(recording, row))
    return next(found, None)
