"""A companion of a simulated PX4 that knows nothing but MAVLink: it sends bytes and reads bytes."""

import copy
import math
import struct
from collections.abc import Callable
from typing import Any, Final, final

from over_the_wire import Heard, Link, Vector
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.simulation import STEP_US
from vehicle_sim.world import VehicleKind

NAN: Final = math.nan
LATITUDE_DEG, LONGITUDE_DEG, GROUND_AMSL_M = 47.397742, 8.545594, 488.0
NORTH_M_PER_DEG, EAST_M_PER_DEG = 111_191.0, 75_470.0
OFFBOARD, POSCTL, ALTCTL = 0x00060000, 0x00030000, 0x00020000
TAKEOFF, HOLD, MISSION, RETURN, LAND = 0x02040000, 0x03040000, 0x04040000, 0x05040000, 0x06040000
QUIET = (2, 4, 8, 29, 31, 33, 36, 74, 83, 85, 87, 105, 111, 132, 141, 147, 231, 241, 331, 360, 380)
EVENT = 410
Aim = Callable[[float], Any]
"""The setpoint of a time in seconds, as a message."""


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
    """One client of one vehicle.  ``aim`` is streamed at ``rate_hz`` while it is not None."""

    def __init__(self, kind: VehicleKind = "copter", *, links: int = 1) -> None:
        super().__init__(kind, "px4", (LATITUDE_DEG, LONGITUDE_DEG, GROUND_AMSL_M), links=links)
        self.aim: Aim | None = None
        self.rate_hz = 20.0
        self.aimed_s = NAN
        """When the newest of the stream was sent."""
        self.stick: float | None = None
        """A pilot, at 10 Hz: the forward stick, -1 to 1."""
        self.heartbeats: tuple[int, ...] = ()
        """MAV_TYPEs of which one is sent each second."""
        self._steps = 0

    def copy(self) -> "Companion":
        """The same again from here, with nothing heard yet."""
        self.heard.clear()
        return copy.deepcopy(self)

    # --- out ----------------------------------------------------------------------------------

    def command(self, number: int, *parameters: float) -> int | None:
        """COMMAND_LONG; the last result that came within 50 ms."""
        padded = (*parameters, *(0.0,) * (7 - len(parameters)))
        self.send(mavlink.MAVLink_command_long_message(1, 1, number, 0, *padded))
        return self._result(number)

    def command_at(
        self, number: int, point: Vector, *parameters: float, frame: int = 5
    ) -> int | None:
        """COMMAND_INT with a place: north and east of the origin, altitude."""
        degrees = (NAN, NAN) if math.isnan(point[0]) else place(*point[:2])
        x, y = (0 if math.isnan(value) else round(value * 1e7) for value in degrees)
        padded = (*parameters, *(0.0,) * (4 - len(parameters)))
        self.send(
            mavlink.MAVLink_command_int_message(1, 1, frame, number, 0, 0, *padded, x, y, point[2])
        )
        return self._result(number)

    def _result(self, number: int) -> int | None:
        since_s = self.now_s
        self.run(0.05)
        found = [m.result for m in self.of("COMMAND_ACK", since_s) if m.command == number]
        return found[-1] if found else None

    def set_mode(self, custom: int) -> int | None:
        return self.command(176, 1, custom >> 16 & 0xFF, custom >> 24)

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

    # --- time ---------------------------------------------------------------------------------

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 1e6 / STEP_US)):
            self.turn()

    def until(self, reached: Callable[[], bool], within_s: float) -> float:
        """Seconds until it is so; NaN: never."""
        start_s = self.now_s
        while self.now_s - start_s < within_s:
            self.turn()
            if reached():
                return self.now_s - start_s
        return NAN

    def turn(self) -> None:
        """A step, and before it what is due to be sent."""
        steps, now_s = self._steps, self.now_s
        if self.aim is not None and steps % round(100 / self.rate_hz) == 0:
            self.send(self.aim(now_s))
            self.aimed_s = now_s
        if self.stick is not None and steps % 10 == 0:
            x = round(1000 * self.stick)
            sticks = mavlink.MAVLink_manual_control_message(1, x, 0, 500, 0, 0)
            self.send(sticks, source=(255, 190))
        if steps % 100 == 0:
            for kind in self.heartbeats:
                self.send(mavlink.MAVLink_heartbeat_message(kind, 8, 0, 0, 4, 3))
        self._steps += 1
        self.step()

    # --- in -----------------------------------------------------------------------------------

    def of(self, kind: str, since_s: float = 0.0) -> list[Any]:
        return [heard.message for heard in self.times(kind, since_s)]

    def times(self, kind: str, since_s: float = 0.0) -> list[Heard]:
        """After this time."""
        return [heard for heard in self.all(kind) if heard.at_s > since_s]

    def events(self, since_s: float = 0.0) -> dict[int, float]:
        """Numbers without the component in the highest byte, and when they came first."""
        found = dict[int, float]()
        for heard in self.times(f"UNKNOWN_{EVENT}", since_s):
            payload = heard.frame[10:]
            found.setdefault(int.from_bytes(payload[:3], "little"), heard.at_s)
        return found

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
