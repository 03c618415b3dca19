"""A companion of a simulated PX4 that knows nothing but MAVLink: it sends bytes and reads bytes."""

import math
import struct
from collections.abc import Callable
from typing import Any, Final, final

from over_the_wire import QUIET, Heard, Link, Vector
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.world import VehicleKind

NAN: Final = math.nan
LATITUDE_DEG, LONGITUDE_DEG, GROUND_AMSL_M = 47.397742, 8.545594, 488.0
NORTH_M_PER_DEG, EAST_M_PER_DEG = 111_191.0, 75_470.0
OFFBOARD, POSCTL, ALTCTL = 0x00060000, 0x00030000, 0x00020000
TAKEOFF, HOLD, MISSION, RETURN, LAND = 0x02040000, 0x03040000, 0x04040000, 0x05040000, 0x06040000
Aim = Callable[[float], Any]
"""The setpoint of a time in seconds, as a message."""
Seen = dict[str, Any]
"""What an experiment saw, by name."""


def local(
    position: Vector | None = None,
    velocity: Vector | None = None,
    acceleration: Vector | None = None,
    *,
    yaw: float | None = None,
    yaw_rate: float | None = None,
    mask: int | None = None,
    frame: int = 1,
    target: tuple[int, int] = (1, 1),
) -> Any:
    """SET_POSITION_TARGET_LOCAL_NED; what is None is masked, unless a mask is given."""
    wanted = (0 if position else 0x7) | (0 if velocity else 0x38) | (0 if acceleration else 0x1C0)
    wanted |= (0x400 if yaw is None else 0) | (0x800 if yaw_rate is None else 0)
    zero = (0.0, 0.0, 0.0)
    return mavlink.MAVLink_set_position_target_local_ned_message(
        0,
        *target,
        frame,
        wanted if mask is None else mask,
        *(position or zero),
        *(velocity or zero),
        *(acceleration or zero),
        yaw or 0.0,
        yaw_rate or 0.0,
    )


def place(north_m: float, east_m: float) -> tuple[float, float]:
    """Latitude and longitude of a point of the local frame, in degrees."""
    return LATITUDE_DEG + north_m / NORTH_M_PER_DEG, LONGITUDE_DEG + east_m / EAST_M_PER_DEG


def worldwide(
    north_m: float,
    east_m: float,
    altitude_m: float,
    velocity: Vector = (0.0, 0.0, 0.0),
    *,
    mask: int = 0xDF8,
    frame: int = 5,
) -> Any:
    """SET_POSITION_TARGET_GLOBAL_INT."""
    degrees = (round(value * 1e7) for value in place(north_m, east_m))
    return mavlink.MAVLink_set_position_target_global_int_message(
        0, 1, 1, frame, mask, *degrees, altitude_m, *velocity, 0.0, 0.0, 0.0, 0.0, 0.0
    )


@final
class Companion(Link):
    """A PX4 and one client."""

    def __init__(self, kind: VehicleKind = "copter", *, links: int = 1) -> None:
        super().__init__(kind, "px4", (LATITUDE_DEG, LONGITUDE_DEG, GROUND_AMSL_M), links=links)

    def set_parameter(self, name: str, value: float) -> None:
        """PARAM_SET, whole numbers bytewise."""
        whole = isinstance(value, int)
        bits = struct.unpack("<f", struct.pack("<i", value))[0] if whole else value
        kind = 6 if whole else 9
        self.send(mavlink.MAVLink_param_set_message(1, 1, name.encode(), bits, kind))

    def parameter(self, name: str) -> float | None:
        """PARAM_REQUEST_READ; None if it does not answer."""
        since_s = self.now_s
        self.send(mavlink.MAVLink_param_request_read_message(1, 1, name.encode(), -1))
        self.run(0.1)
        found = [m for m in self.of("PARAM_VALUE", since_s) if m.param_id == name]
        if not found:
            return None
        value: float = found[-1].param_value
        if found[-1].param_type == 6:
            value = struct.unpack("<i", struct.pack("<f", value))[0]
        return value

    def of(self, kind: str, since_s: float = 0.0) -> list[Any]:
        return [heard.message for heard in self.times(kind, since_s)]

    def times(self, kind: str, since_s: float = 0.0) -> list[Heard]:
        """After this time."""
        return [heard for heard in self.all(kind) if heard.at_s > since_s]

    def modes(self, since_s: float = 0.0) -> list[tuple[float, int]]:
        """Changes of the mode, by CURRENT_MODE."""
        found = list[tuple[float, int]]()
        for heard in self.times("CURRENT_MODE", since_s):
            mode = heard.message.custom_mode
            if not found or found[-1][1] != mode:
                found.append((heard.at_s, mode))
        return found

    @property
    def mode(self) -> int:
        return int(self.last("CURRENT_MODE").custom_mode)

    @property
    def status(self) -> int:
        """system_status of the newest heartbeat."""
        return int(self.last("HEARTBEAT").system_status)

    @property
    def position(self) -> Vector:
        here = self.last("LOCAL_POSITION_NED")
        return here.x, here.y, here.z

    @property
    def velocity(self) -> Vector:
        here = self.last("LOCAL_POSITION_NED")
        return here.vx, here.vy, here.vz

    @property
    def speed(self) -> float:
        return math.hypot(*self.velocity[:2])

    # --- common beginnings --------------------------------------------------------------------

    def booted(self, **parameters: float) -> "Companion":
        """On the ground and armable, with only the needed messages switched on."""
        self.run(1.0)
        for number in QUIET:
            self.command(511, number, -1)
        self.command(511, 436, 50_000)
        self.command(511, 30, 100_000)
        for name, value in parameters.items():
            self.set_parameter(name, value)
        self.run(6.0)
        return self

    def flying(self, height_m: float = 15.0) -> "Companion":
        """Up there in OFFBOARD, above the origin."""
        self.aim = lambda _: local((0.0, 0.0, -height_m), yaw=0.0)
        self.run(0.5)
        self.set_mode(OFFBOARD)
        self.command(400, 1)
        self.run(8.0 + height_m / 2.0)
        return self
