"""What a timeline has a person at a ground station do: orders to companion or autopilot, a fence.

The station is system 255, and on a link of its own: what it is answered is not heard by anybody.
"""

import math
from collections.abc import Sequence
from typing import Any, Final

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot.values import Sender
from vehicle_sim.dynamics import Vehicle
from vehicle_sim.geodesy import LocalFrame
from vehicle_sim.plans import CIRCLE_OUT, PlanItem

STATION: Final = Sender(system=255, component=190)
_GLOBAL_INT: Final = mavlink.MAV_FRAME_GLOBAL_INT


def command(values: Sequence[float], system: int, component: int) -> Any:
    """COMMAND_LONG with this MAV_CMD and its first three parameters."""
    number, *parameters = values
    return mavlink.MAVLink_command_long_message(
        system, component, round(number), 0, *parameters, *[0.0] * (7 - len(parameters))
    )


def target(values: Sequence[float], vehicle: Vehicle, system: int, component: int) -> Any:
    """DO_REPOSITION to so far north and east of where the vehicle is, at its height."""
    place = (*_beside(vehicle, values[0], values[1]), vehicle.altitude_amsl_m)
    number, usual = mavlink.MAV_CMD_DO_REPOSITION, (0, 0, -1.0, 0.0, 0.0, math.nan)
    return mavlink.MAVLink_command_int_message(
        system, component, _GLOBAL_INT, number, *usual, *place
    )


def new_fence(vehicle: Vehicle, radius_m: float, ahead_m: float) -> PlanItem:
    """A circle to stay out of, so far ahead of the vehicle (true course) or about it."""
    north, east, _ = vehicle.velocity_neu_m_s
    share = ahead_m / max(math.hypot(north, east), 1e-6)
    x, y = _beside(vehicle, share * north, share * east)
    return PlanItem(frame=0, command=CIRCLE_OUT, parameters=(radius_m, 0.0, 0.0, 0.0), x=x, y=y)


def _beside(vehicle: Vehicle, north_m: float, east_m: float) -> tuple[int, int]:
    """Latitude and longitude, 1e-7 degrees."""
    here = LocalFrame(latitude_deg=vehicle.latitude_deg, longitude_deg=vehicle.longitude_deg)
    latitude_deg, longitude_deg = here.to_geographic(north_m, east_m)
    return round(latitude_deg * 1e7), round(longitude_deg * 1e7)
