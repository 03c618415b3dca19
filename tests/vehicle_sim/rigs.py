"""Autopilots alone over level ground, told by values: what tracking is measured with."""

import cmath
import copy
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, Self

import numpy as np
from harness import (
    COPTER_HOME,
    GUIDED,
    NAN,
    OFFBOARD,
    PLACE,
    PLANE_HOME,
    PLANE_TAKEOFF,
    STRONG,
    ZERO,
    Vector,
    copied,
    limits,
    placed,
)

from vehicle_sim.autopilot.core import Boot
from vehicle_sim.autopilot.factory import PERSONALITIES
from vehicle_sim.autopilot.px4plane import SIH_AIRPLANE
from vehicle_sim.autopilot.values import Ack, Command, Reply, Sender, SendMessage, Setpoint, Text
from vehicle_sim.dynamics.copter import Copter, Limits
from vehicle_sim.dynamics.plane import Plane
from vehicle_sim.faults import GpsConditions
from vehicle_sim.geodesy import LocalFrame
from vehicle_sim.plans import PlanItem, PlanKind, Plans
from vehicle_sim.sensors.gps import ARDUCOPTER, ARDUPLANE, PX4, Gps
from vehicle_sim.world import VehicleKind

STEP_US, STEP_S = 10_000, 0.01
_ASKER = Sender(system=1, component=191)
PX4_GPS: Final = GpsConditions(lag_s=0.0)


class Rig:
    """An autopilot of any kind over level ground; a vehicle's own adds how it gets into the air."""

    def __init__(
        self,
        personality: tuple[str, VehicleKind],
        vehicle: Any,
        parameters: Mapping[str, float],
        gps: Gps,
        conditions: GpsConditions | None = None,
        *,
        seed: int = 1,
    ) -> None:
        self.vehicle, self.plans = vehicle, Plans()
        self.ground_amsl_m = vehicle.altitude_amsl_m
        kind, rng = PERSONALITIES[personality], np.random.default_rng(seed)
        self.autopilot: Any = kind.make(Boot(kind.firmware, vehicle, parameters, self.plans, rng))
        self.gps, self.gps_conditions = gps, conditions or GpsConditions()
        self.now_us = 0
        self.said: list[tuple[float, Reply]] = []
        """With the time in seconds."""

    def copy(self) -> Self:
        return copy.deepcopy(self)

    @property
    def now_s(self) -> float:
        return self.now_us * 1e-6

    @property
    def height_m(self) -> float:
        """Above the ground, truly."""
        return float(self.vehicle.altitude_amsl_m - self.ground_amsl_m)

    @property
    def speed_m_s(self) -> float:
        """Over the ground, truly."""
        return math.hypot(*self.vehicle.velocity_neu_m_s[:2])

    @property
    def ned_m(self) -> Vector:
        """Where it believes to be, in the frame that its setpoints are in."""
        return self.autopilot.local_ned_m() or ZERO

    @property
    def ne_m(self) -> tuple[float, float]:
        """The same without the height."""
        return self.ned_m[:2]

    @property
    def mode(self) -> str:
        return str(self.autopilot.mode.name)

    @property
    def armed(self) -> bool:
        return bool(self.autopilot.armed)

    @property
    def landed(self) -> bool:
        return bool(self.autopilot.landed)

    @property
    def status(self) -> Any:
        return self.autopilot.status()

    @property
    def texts(self) -> list[str]:
        return [reply.text for _, reply in self.said if isinstance(reply, Text)]

    def when(self, text: str) -> list[float]:
        """The times at which this was said."""
        return [at for at, reply in self.said if isinstance(reply, Text) and reply.text == text]

    def reached(self) -> list[tuple[float, int]]:
        """When MISSION_ITEM_REACHED was said, and of which item."""
        told = ((at, reply) for at, reply in self.said if isinstance(reply, SendMessage))
        return [(at, reply.message.seq) for at, reply in told]

    # --- time ---------------------------------------------------------------------------------

    def take(self, replies: Sequence[Reply]) -> Sequence[Reply]:
        self.said.extend((self.now_s, reply) for reply in replies)
        return replies

    def step(self) -> None:
        self.now_us += STEP_US
        fix = self.gps.step(self.now_us, self.vehicle, self.gps_conditions)
        self.take(self.autopilot.step(self.now_us, STEP_S, self.ground_amsl_m, fix))

    def run(self, seconds: float, each: Callable[[], object] | None = None) -> Self:
        """Fly on, with something to do before each step."""
        for _ in range(round(seconds / STEP_S)):
            if each is not None:
                each()
            self.step()
        return self

    def until(self, reached: Callable[[], bool], within_s: float = 300.0) -> float:
        """Fly until this is so; returns how long it took, in seconds."""
        start_us = self.now_us
        while not reached():
            assert self.now_us - start_us < within_s * 1e6, "it never came to that"
            self.step()
        return (self.now_us - start_us) * 1e-6

    # --- orders -------------------------------------------------------------------------------

    def answers(
        self, number: int, *p: float, frame: int | None = None, target_component: int = 1
    ) -> list[int]:
        """What a command is answered at once: PX4 does not answer everything."""
        parameters: Any = (*p, *(0.0,) * (7 - len(p)))
        command = Command(_ASKER, target_component, number, parameters, frame)
        acks = [r for r in self.take(self.autopilot.on_command(command)) if isinstance(r, Ack)]
        assert all((ack.to, ack.command) == (_ASKER, number) for ack in acks)
        return [ack.result for ack in acks]

    def command(self, number: int, *p: float, **fields: Any) -> int:
        (answer,) = self.answers(number, *p, **fields)
        return answer

    def set_mode(self, *mode: float) -> int:
        """The result of DO_SET_MODE; PX4's second answer, as the first is always yes."""
        result = self.command(176, 1.0, *mode)
        if self.autopilot.firmware.family == "px4":
            assert result == 0
            self.step()
            result = [r.result for _, r in self.said if isinstance(r, Ack)][-1]
        return result

    def aim(
        self,
        position: Vector | None = None,
        velocity: Vector | None = None,
        acceleration: Vector | None = None,
        yaw_rad: float | None = None,
        *,
        mask: int | None = None,
        frame: int = 1,
        is_global: bool = False,
    ) -> None:
        """A setpoint; what is None is masked, unless a mask is given."""
        given = zip(
            (0x007, 0x038, 0x1C0, 0x400), (position, velocity, acceleration, yaw_rad), strict=True
        )
        masked = 0x800 | sum(bit for bit, what in given if what is None)
        setpoint = Setpoint(
            is_global=is_global,
            frame=frame,
            type_mask=masked if mask is None else mask,
            position=position or ZERO,
            velocity_ned_m_s=velocity or ZERO,
            acceleration_ned_m_s2=acceleration or ZERO,
            yaw_rad=yaw_rad or 0.0,
        )
        self.take(self.autopilot.on_setpoint(setpoint))

    def stream(self, seconds: float, *vectors: Any, rate_hz: float = 20.0, **fields: Any) -> Self:
        """The same setpoint again and again."""
        every = round(1.0 / rate_hz / STEP_S)
        for index in range(round(seconds / STEP_S)):
            if index % every == 0:
                self.aim(*vectors, **fields)
            self.step()
        return self

    def plan(self, kind: PlanKind, *items: PlanItem) -> None:
        self.plans[kind] = items
        self.autopilot.on_plan(kind)


class ArduCopter(Rig):
    """An ArduCopter, or the law `ideal`, which is without drag."""

    def __init__(
        self,
        *,
        ground_amsl_m: float = COPTER_HOME[2],
        airframe: Limits = limits(60.0, 30.0, 10.0, 8.0),  # noqa: B008
        drag: bool = True,
        **parameters: float,
    ) -> None:
        # of the recorded airframe: 10.05 m/s at 28.7 degrees of tilt, 15.4 m/s at 45
        drags = {"drag_1_s": 0.340, "drag_1_m": 0.0193} if drag else {}
        place = placed((*COPTER_HOME[:2], ground_amsl_m))
        copter = Copter(**place, limits=airframe, **drags)
        gps = Gps(ARDUCOPTER, np.random.default_rng(1))
        super().__init__(("ardupilot" if drag else "ideal", "copter"), copter, parameters, gps)

    def take_off(self, height_m: float) -> int:
        return self.command(22, 0, 0, 0, 0, 0, 0, height_m)

    def airborne(self, height_m: float = 30.0) -> "ArduCopter":
        """Boot, take off in GUIDED and hover."""
        self.run(42.5)
        assert [self.set_mode(GUIDED), self.command(400, 1), self.take_off(height_m)] == [0, 0, 0]
        self.until(lambda: self.status.landed_state == 2, within_s=1000.0)
        return self.run(3.0)


@copied
def hovering(lean_deg: float = 45.0, height_m: float = 30.0, **parameters: float) -> ArduCopter:
    """An ArduCopter in GUIDED above home."""
    return ArduCopter(ANGLE_MAX=lean_deg * 100.0, **parameters).airborne(height_m)


class ArduPlane(Rig):
    """An ArduPlane over flat ground at home."""

    def __init__(self, **parameters: float) -> None:
        self.frame = LocalFrame(**placed(PLANE_HOME, height=False))
        plane, gps = Plane(**placed(PLANE_HOME)), Gps(ARDUPLANE, np.random.default_rng(1))
        super().__init__(("ardupilot", "plane"), plane, parameters, gps)

    @property
    def ne_m(self) -> tuple[float, float]:
        """Where it is, truly."""
        return self.frame.to_local(self.vehicle.latitude_deg, self.vehicle.longitude_deg)

    def reposition(
        self, north_m: float, east_m: float, up_m: float, radius_m: float = 0.0, ccw: float = 0.0
    ) -> int:
        place = (*self.frame.to_geographic(north_m, east_m), up_m)
        return self.command(192, -1.0, 1.0, radius_m, ccw, *place, frame=3)

    def take_off(self) -> Self:
        """By TAKEOFF, then GUIDED, on the way to 80 m above home."""
        self.run(24.0)
        assert [self.set_mode(PLANE_TAKEOFF), self.command(400, 1.0)] == [0, 0]
        self.until(lambda: self.height_m > 48.0)
        assert self.reposition(0.0, 0.0, 80.0) == 0
        return self


@copied
def circling(settle_s: float = 30.0, **parameters: float) -> ArduPlane:
    return ArduPlane(**parameters).take_off().run(settle_s)


class Px4Rig(Rig):
    """A PX4 vehicle in still air; COM_OBL_RC_ACT 5 is Hold."""

    def __init__(self, kind: VehicleKind, vehicle: Any, seed: int, **parameters: float) -> None:
        gps = Gps(PX4, np.random.default_rng(seed + 1000))
        given = {"COM_OBL_RC_ACT": 5.0, **parameters}
        super().__init__(("px4", kind), vehicle, given, gps, PX4_GPS, seed=seed)

    @property
    def ned_m(self) -> Vector:
        """Where it last believed to be."""
        north_m, east_m, down_m = self.autopilot.local_m
        return north_m, east_m, down_m

    def place(self, north_m: float, east_m: float, height_m: float) -> Vector:
        """Latitude, longitude and altitude AMSL of a point of the local frame."""
        place = self.autopilot.frame.place(north_m, east_m, 0.0)
        return place.latitude_deg, place.longitude_deg, PLACE[2] + height_m


class Px4Copter(Px4Rig):
    def __init__(self, seed: int = 1, **parameters: float) -> None:
        copter = Copter(**placed(PLACE), limits=STRONG)
        super().__init__("copter", copter, seed, **{"SIH_KDV": 0.25} | parameters)

    def take_off(self, height_m: float = 20.0, seconds: float = 16.0) -> Self:
        """Boot, OFFBOARD, arm, climb above the origin."""
        up = (0.0, 0.0, -height_m)
        self.run(5.0).stream(2.5, up)
        self.command(176, 1.0, *OFFBOARD)
        self.stream(0.2, up)
        self.command(400, 1.0)
        return self.stream(seconds, up)


class Px4Plane(Px4Rig):
    def __init__(self, seed: int = 1, **parameters: float) -> None:
        super().__init__("plane", Plane(**placed(PLACE), limits=SIH_AIRPLANE), seed, **parameters)

    def take_off(self, north_m: float = 300.0, height_m: float = 50.0) -> Self:
        """As in the recorded flight: NAV_TAKEOFF, arm, until Hold."""
        self.run(6.0)
        self.command(22, 0, 0, NAN, NAN, *self.place(north_m, 0.0, height_m), frame=5)
        self.run(0.5)
        self.command(400, 1.0)
        self.until(lambda: self.mode == "Hold", 60.0)
        return self


@copied
def _taken_off(**parameters: float) -> Px4Plane:
    return Px4Plane(**parameters).take_off()


def cruising(
    north_m: float = 0.0,
    east_m: float = 0.0,
    height_m: float = 68.0,
    heading_rad: float = 0.0,
    **parameters: float,
) -> Px4Plane:
    """A PX4 aeroplane that has long been on its way, put there."""
    rig = _taken_off(**parameters)
    plane, speed_m_s = rig.vehicle, SIH_AIRPLANE.airspeed_max_m_s
    plane.stand(PLACE[2])
    plane.stands = False
    place = rig.place(north_m, east_m, height_m)
    plane.latitude_deg, plane.longitude_deg, plane.altitude_amsl_m = place
    plane.heading_rad, plane.roll_rad, plane.airspeed_m_s = heading_rad, 0.0, speed_m_s
    plane.velocity_m_s = cmath.rect(speed_m_s, heading_rad)
    rig.step()
    return rig
