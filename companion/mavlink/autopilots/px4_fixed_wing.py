"""PX4 fixed wing: a point of the path and the tangent there, in OFFBOARD.  Measured: px4.md 10.

It always flies at FW_AIRSPD_TRIM.  Setpoints are not acknowledged, and there is no position target
echo in OFFBOARD.  It starts rolling as soon as it is armed.
"""

import math
from dataclasses import replace
from typing import Final

from companion.mavlink import rules
from companion.mavlink.autopilots import messages, px4
from companion.mavlink.autopilots.common import Autopilot
from companion.mavlink.autopilots.messages import To
from companion.mavlink.dialect import Message, wire
from companion.mavlink.rules import Case, Finding, Rule
from companion.mission.events import Setpoint, TakeOff, Vector
from companion.mission.vehicle_traits import TakeoffSequence, VehicleTraits
from companion.path.envelope import PLANE

_RUNWAY_M = 300.0
"""The take-off target is this far ahead, so that it ends in AUTO.LOITER (px4.md 10)."""
_BESIDE_M = 30.0
"""It circles its last point tightly, and when the setpoints end it goes over to a circle about
where it is, up to 44 m beside it in wind of 5 m/s (px4.md 10, `scripts/bench kills`).  The rest is
within the tube, and what preflight asks NAV_LOITER_RAD to be less than the mission's circle.
steady_m is of its altitude: in gusts it is up to 9 m high, and in Hold rises as much again."""


def _hold_about(at_nea_m: Vector, to: To) -> list[Message]:
    """DO_REPOSITION with the switch to AUTO.LOITER, on the circle that it has set."""
    return messages.reposition(to, at_nea_m, switch=True, radius_m=0.0, yaw_rad=px4.KEEP_YAW)


def _take_off(command: TakeOff, here_nea_m: Vector, heading_rad: float, to: To) -> list[Message]:
    """NAV_TAKEOFF to a point 300 m ahead at an altitude AMSL; ends in AUTO.LOITER about it.

    Without a point it stays in AUTO.TAKEOFF.
    """
    north_m, east_m, _ = here_nea_m
    if not math.isfinite(heading_rad):
        return []
    ahead = (
        north_m + _RUNWAY_M * math.cos(heading_rad),
        east_m + _RUNWAY_M * math.sin(heading_rad),
        command.altitude_amsl_m,
    )
    return px4.take_off(to, ahead)


def _setpoint(setpoint: Setpoint, to: To, _loiter_radius_m: float) -> list[Message] | None:
    """A point of the path and the tangent there; to stay, the point alone, to be circled.

    Never an acceleration: its sign is wrong there (px4.md 1, item 7).
    """
    mask = messages.POSITION if setpoint.stay else messages.POSITION_VELOCITY
    return messages.position_target(setpoint, to, type_mask=mask)


_ONLY_SPEED: Final = rules.at_least(  # px4.md 10
    lambda limits: 1.05 * limits.speed_m_s,
    "it always flies this airspeed, and the mission counts on {needed:g} m/s or less",
    "Set vehicle.speed_m_s to {value:g}",
    most=True,
)


def _timeout(value: float, case: Case) -> Finding | None:
    """0.5 s after it, it circles where it is (px4.md 10)."""
    return rules.timeout(value, 0.5, case, "the plane flies straight on")


_RULES: Final = (
    Rule("COM_OF_LOSS_T", _timeout, "how long it flies on without setpoints"),
    Rule("FW_AIRSPD_TRIM", _ONLY_SPEED, "the airspeed that it flies"),
    Rule("FW_AIRSPD_MIN", rules.slowest),
    Rule("FW_AIRSPD_MAX", rules.fastest),
    # circles are held within 0.4 m (px4.md 10)
    Rule("NAV_LOITER_RAD", rules.circles(5.0, "FW_R_LIM"), "the circles that it holds on"),
    Rule("FW_R_LIM", rules.bank),
    Rule("FW_T_CLMB_R_SP", rules.plane_climbs),
    Rule("FW_T_SINK_R_SP", rules.plane_sinks),
    *px4.RULES,
)

PX4_FIXED_WING = Autopilot(
    firmware=px4.FIRMWARE,
    traits=VehicleTraits(
        name="PX4 fixed wing",
        kind="plane",
        take_off=TakeoffSequence.CLIMB_THEN_ARM,
        lead_s=1.5,
        needs_setpoints_before_offboard=True,
        handling=replace(PLANE, name="PX4 fixed wing", steady_m=15.0, beside_m=_BESIDE_M),
    ),
    rules=_RULES,
    parameters_for=lambda limits: {
        "FW_AIRSPD_TRIM": limits.speed_m_s,
        "FW_AIRSPD_MAX": 1.3 * limits.speed_m_s,
    },
    modes=px4.MODES,
    streams_hz=px4.STREAMS_HZ,
    intermittent=px4.INTERMITTENT,
    requested_once=px4.REQUESTED_ONCE,
    decoders={wire.MAVLINK_MSG_ID_ESTIMATOR_STATUS: px4.estimator},
    take_off=_take_off,
    setpoint=_setpoint,
    hold_about=_hold_about,
)
