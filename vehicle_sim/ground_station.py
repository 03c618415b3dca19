"""What a timeline has a person at a ground station do: orders to companion or autopilot, a fence.

The station is system 255, and on a link of its own: what it is answered is not heard by anybody.
"""

import math
from collections.abc import Sequence
from typing import Any, Final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot.values import Sender
from vehicle_sim.dynamics.copter import Copter
from vehicle_sim.dynamics.plane import Plane
from vehicle_sim.geodesy import LocalFrame
from vehicle_sim.plans import PlanItem

STATION: Final = Sender(system=255, component=190)
_REPOSITION, _CIRCLE_OUT = 192, 5004
_GLOBAL_INT = 5
_AUTOPILOT = 1


def said(
    name: str, values: Sequence[float], system: int, companion: int, vehicle: Copter | Plane
) -> tuple[bool, Any]:
    """Whether it is for the autopilot, and what a `ground_command` or `ground_target` says.

    Values: MAV_CMD, its first three parameters, and 1 if it is for the autopilot: COMMAND_LONG.
    Or how far north and east of where the vehicle is: DO_REPOSITION.
    """
    if name == "ground_target":
        latitude, longitude = _beside(vehicle, *values[:2])
        return False, mavlink.MAVLink_command_int_message(
            system, companion, _GLOBAL_INT, _REPOSITION, 0, 0, -1.0, 0.0, 0.0, math.nan,
            latitude, longitude, vehicle.altitude_amsl_m,
        )  # fmt: skip
    (number, *parameters), to_autopilot = values[:4], any(values[4:])
    to = (system, _AUTOPILOT if to_autopilot else companion)
    message = mavlink.MAVLink_command_long_message(*to, round(number), 0, *parameters, *[0.0] * 4)
    return to_autopilot, message


def new_fence(vehicle: Copter | Plane, radius_m: float, ahead_m: float) -> PlanItem:
    """A circle to stay out of, so far ahead of the vehicle (true course) or about it."""
    north, east = vehicle.velocity_north_m_s, vehicle.velocity_east_m_s
    share = ahead_m / max(math.hypot(north, east), 1e-6)
    x, y = _beside(vehicle, share * north, share * east)
    return PlanItem(frame=0, command=_CIRCLE_OUT, parameters=(radius_m, 0.0, 0.0, 0.0), x=x, y=y)


def _beside(vehicle: Copter | Plane, north_m: float, east_m: float) -> tuple[int, int]:
    """Latitude and longitude, 1e-7 degrees."""
    here = LocalFrame(latitude_deg=vehicle.latitude_deg, longitude_deg=vehicle.longitude_deg)
    latitude_deg, longitude_deg = here.to_geographic(north_m, east_m)
    return round(latitude_deg * 1e7), round(longitude_deg * 1e7)
