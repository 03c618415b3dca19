"""PX4 fixed wing: a point of the path and the tangent there, in OFFBOARD.  Measured: px4.md 10.

It always flies at FW_AIRSPD_TRIM.  Setpoints are not acknowledged, and there is no position target
echo in OFFBOARD.  It starts rolling as soon as it is armed.
"""

import math

from companion.geodesy import LocalFrame
from companion.mavlink.autopilots import messages, px4
from companion.mavlink.autopilots.common import Autopilot, LaunchPose
from companion.mavlink.dialect import Message, wire
from companion.mavlink.parameter_rules import PX4_FIXED_WING_RULES
from companion.mission.events import Setpoint, TakeOff, Vector
from companion.mission.vehicle_traits import TakeoffSequence, VehicleTraits

_RUNWAY_M = 300.0
"""The take-off target is this far ahead, so that it ends in AUTO.LOITER (px4.md 10)."""


def _hold_about(at_nea_m: Vector, frame: LocalFrame, system_id: int) -> list[Message]:
    """DO_REPOSITION with the switch to AUTO.LOITER, on the circle that it has set."""
    place = messages.wire_place(at_nea_m, frame)
    if place is None:
        return []
    return [
        messages.reposition(
            system_id,
            place,
            at_nea_m[2],
            switch=True,
            radius_m=0.0,
            yaw_rad=px4.KEEP_YAW,
        )
    ]


def _take_off(
    command: TakeOff, here: LaunchPose, frame: LocalFrame, system_id: int
) -> list[Message]:
    """NAV_TAKEOFF to a point 300 m ahead at an altitude AMSL; ends in AUTO.LOITER about it.

    Without a point it stays in AUTO.TAKEOFF.
    """
    north_m, east_m, _ = here.position_nea_m
    if not all(map(math.isfinite, (north_m, east_m, here.heading_rad))):
        return []
    course_rad = here.heading_rad - frame.grid_north_rad(north_m, east_m)
    ahead = (
        north_m + _RUNWAY_M * math.cos(course_rad),
        east_m + _RUNWAY_M * math.sin(course_rad),
        command.altitude_amsl_m,
    )
    return px4.take_off(ahead, frame, system_id)


def _setpoint(
    setpoint: Setpoint, frame: LocalFrame, system_id: int, _loiter_radius_m: float
) -> list[Message] | None:
    """A point of the path and the tangent there; to stay, the point alone, to be circled.

    Never an acceleration: its sign is wrong there (px4.md 1, item 7).
    """
    mask = messages.POSITION if setpoint.stay else messages.POSITION_VELOCITY
    return messages.position_target(setpoint, frame, system_id, type_mask=mask)


PX4_FIXED_WING = Autopilot(
    traits=VehicleTraits(
        name="PX4 fixed wing",
        hovers=False,
        take_off=TakeoffSequence.CLIMB_THEN_ARM,
        lead_s=1.5,
        needs_setpoints_before_offboard=True,
    ),
    rules=PX4_FIXED_WING_RULES,
    modes=px4.MODES,
    streams_hz=px4.STREAMS_HZ,
    intermittent=px4.INTERMITTENT,
    requested_once=px4.REQUESTED_ONCE,
    decoders={wire.MAVLINK_MSG_ID_ESTIMATOR_STATUS: px4.estimator},
    take_off=_take_off,
    setpoint=_setpoint,
    hold_about=_hold_about,
)
