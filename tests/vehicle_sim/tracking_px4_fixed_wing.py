"""Flights of the simulated PX4 aeroplane along the curve of px4.md 10, and what they measure.

The curve is sine-generated (heading = 2.405 cos: a figure eight), least radius 100 m, 1511 m long.
The companion looks for the point nearest to where the autopilot believes to be, and sends one that
lies ``lead_m`` further on.
"""

import copy
import functools
import math
from typing import Any, Final, Literal, NamedTuple, final

import harness
import numpy as np

from vehicle_sim.autopilot.factory import PERSONALITIES
from vehicle_sim.autopilot.px4plane import SIH_AIRPLANE
from vehicle_sim.autopilot.values import Sender
from vehicle_sim.conditions import GpsConditions
from vehicle_sim.dynamics.plane import Plane
from vehicle_sim.plans import Plans
from vehicle_sim.sensors.gps import PX4, Gps

Kind = Literal["pos + vel", "pos + vel + acc", "pos + vel - acc", "position", "reposition"]

STEP_US: Final = 10_000
GROUND_AMSL_M: Final = 488.0
HOME_DEG: Final = (47.397742, 8.545594)
COMPANION: Final = Sender(system=1, component=191)
POSITION_ONLY, POSITION_VELOCITY, ALL_THREE = 0xDF8, 0xDC0, 0xC00
VELOCITY_ONLY: Final = 0xDC7
NAN: Final = math.nan

_SWING_RAD = 2.404825557695773
"""First zero of J0: the curve closes."""
LENGTH_M: Final = _SWING_RAD * math.tau * 100.0
_POINTS = 6044
_HEIGHT_M = 70.0
_START = 3022
"""Where flights begin: what DO_REPOSITION measures in 70 s depends on it (30 to 51 m rms)."""
_LEAD_IN_S, _RUN_S = 25.0, 70.0


@functools.cache
def _taken_off(*made_of: Any) -> dict[str, Any]:
    """What a vehicle consists of that has reached Hold."""
    seed, *parameters = made_of
    one = Rig(seed, **dict(parameters))
    one.take_off()
    return vars(one)


@final
class Rig(harness.Rig):
    """One PX4 aeroplane, without links: what goes in and what comes out."""

    def __init__(self, seed: int = 1, **parameters: float) -> None:
        self._made_of = seed, *parameters.items()
        self.plane = Plane(
            latitude_deg=HOME_DEG[0],
            longitude_deg=HOME_DEG[1],
            altitude_amsl_m=GROUND_AMSL_M,
            limits=SIH_AIRPLANE,
        )
        self.plans = Plans()
        rng = np.random.default_rng(seed)
        given = {"COM_OBL_RC_ACT": 5.0, **parameters}
        self.px4 = PERSONALITIES["px4", "plane"].boot(self.plane, given, self.plans, rng)
        gps = Gps(PX4, np.random.default_rng(seed + 1000))
        super().__init__(self.px4, GROUND_AMSL_M, gps, GpsConditions(fix_type=3, lag_s=0.0))

    def mode(self, main: int, sub: int = 0) -> int:
        """DO_SET_MODE."""
        return self.command(176, 1.0, float(main), float(sub))

    def send(
        self,
        mask: int,
        position: tuple[float, float, float] = (NAN, NAN, NAN),
        velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
        acceleration: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        """SET_POSITION_TARGET_LOCAL_NED, frame LOCAL_NED."""
        self.give(position, velocity, acceleration, mask=mask)

    def place(self, north_m: float, east_m: float, height_m: float) -> tuple[float, float, float]:
        """Latitude, longitude and altitude AMSL of a point of the local frame."""
        place = self.px4.frame.place(north_m, east_m, 0.0)
        return place.latitude_deg, place.longitude_deg, GROUND_AMSL_M + height_m

    def take_off(self, north_m: float = 300.0, height_m: float = 50.0) -> None:
        """As in the recorded flight: NAV_TAKEOFF, arm, until Hold."""
        self.run(6.0)
        self.command(22, 0, 0, NAN, NAN, *self.place(north_m, 0.0, height_m), frame=5)
        self.run(0.5)
        self.command(400, 1.0)
        for _ in range(6000):
            self.step()
            if self.px4.mode_name == "Hold":
                return

    def put(
        self,
        north_m: float,
        east_m: float,
        height_m: float,
        heading_rad: float,
        speed_m_s: float = SIH_AIRPLANE.airspeed_max_m_s,
    ) -> None:
        """Into the air, flying: the state of a plane that has long been on its way."""
        vars(self).update(copy.deepcopy(_taken_off(*self._made_of)))
        plane = self.plane
        plane.stand(GROUND_AMSL_M)
        plane.stands = False
        plane.latitude_deg, plane.longitude_deg, plane.altitude_amsl_m = self.place(
            north_m, east_m, height_m
        )
        plane.heading_rad, plane.roll_rad, plane.airspeed_m_s = heading_rad, 0.0, speed_m_s
        plane.velocity_north_m_s = speed_m_s * math.cos(heading_rad)
        plane.velocity_east_m_s = speed_m_s * math.sin(heading_rad)
        self.step()


@final
class Curve:
    """The figure eight: points, headings and curvatures by length."""

    def __init__(self) -> None:
        step_m = LENGTH_M / _POINTS
        middles = (np.arange(_POINTS) + 0.5) * math.tau / _POINTS
        heading = _SWING_RAD * np.cos(middles)
        ends = np.arange(_POINTS) * math.tau / _POINTS
        self.north = np.concatenate(([0.0], np.cumsum(np.cos(heading) * step_m)[:-1]))
        self.east = np.concatenate(([0.0], np.cumsum(np.sin(heading) * step_m)[:-1]))
        self.heading = _SWING_RAD * np.cos(ends)
        self.curvature = -_SWING_RAD * math.tau / LENGTH_M * np.sin(ends)
        self._step_m = step_m

    def nearest(self, north_m: float, east_m: float, near: int) -> tuple[int, float]:
        """Index of the nearest point within 100 m of another, and how far right of it that is."""
        indices = (near + np.arange(-400, 401)) % _POINTS
        away = np.hypot(self.north[indices] - north_m, self.east[indices] - east_m)
        best = int(indices[int(np.argmin(away))])
        heading = self.heading[best]
        off_n, off_e = north_m - self.north[best], east_m - self.east[best]
        return best, float(off_e * math.cos(heading) - off_n * math.sin(heading))

    def ahead(self, index: int, lead_m: float) -> int:
        """Index of the point so much further on."""
        return (index + round(lead_m / self._step_m)) % _POINTS


class Row(NamedTuple):
    """One line of the table of px4.md 10, and how near the simulator is to be."""

    name: str
    kind: Kind
    lead_m: float
    rate_hz: float
    rms_m: float
    most_m: float
    within_m: float
    """Of the rms."""


ROWS: Final = (
    Row("pos + vel, nearest point", "pos + vel", 0.0, 10.0, 3.8, 6.7, 0.6),
    Row("pos + vel, nearest point, 2.5 Hz", "pos + vel", 0.0, 2.5, 3.9, 8.0, 1.0),
    Row("pos + vel, lead 15 m", "pos + vel", 15.0, 10.0, 1.8, 4.1, 1.2),
    Row("pos + vel, lead 20 m", "pos + vel", 20.0, 10.0, 1.1, 3.8, 1.0),
    Row("pos + vel, lead 30 m", "pos + vel", 30.0, 10.0, 1.3, 6.9, 1.3),
    Row("pos + vel, lead 60 m", "pos + vel", 60.0, 10.0, 1.6, 3.0, 1.2),
    Row("pos + vel + acc", "pos + vel + acc", 0.0, 10.0, 7.9, 12.6, 1.2),
    Row("pos + vel - acc (negated)", "pos + vel - acc", 0.0, 10.0, 0.9, 2.2, 0.9),
    Row("pos only, lead 30 m", "position", 30.0, 10.0, 0.8, 1.5, 0.7),
    Row("pos only, lead 60 m", "position", 60.0, 10.0, 5.2, 7.1, 1.0),
    Row("pos only, lead 100 m", "position", 100.0, 10.0, 18.0, 24.5, 2.5),
    Row("DO_REPOSITION at 1 Hz, lead 130 m", "reposition", 130.0, 1.0, 53.0, 86.0, 20.0),
)
"""px4.md 10, "Curve of least radius 100 m", all of it."""


class Flown(NamedTuple):
    """What a flight measured."""

    rms_m: float
    most_m: float
    ground_speed_m_s: float


def fly(row: Row, *, seed: int = 1) -> Flown:
    """Fly a row: the last 70 of 95 s along the curve count."""
    rig, curve = Rig(seed), Curve()
    start = (float(curve.north[_START]), float(curve.east[_START]))
    rig.put(*start, _HEIGHT_M - 2.0, float(curve.heading[_START]))
    index, offsets, speeds = _START, list[float](), list[float]()
    every = round(100.0 / row.rate_hz)
    offboard = row.kind != "reposition"
    for i in range(round((_LEAD_IN_S + _RUN_S) * 100.0)):
        if i % 10 == 0:
            north_m, east_m, _ = rig.px4.local_m
            index, off_m = curve.nearest(north_m, east_m, index)
            if i >= _LEAD_IN_S * 100.0:
                offsets.append(off_m)
                speeds.append(rig.speed_m_s)
        if i % every == 0:
            _aim(rig, curve, curve.ahead(index, row.lead_m), row.kind)
        if i == 20 and offboard:
            rig.mode(6)
        rig.step()
    return Flown(
        rms_m=math.sqrt(sum(off * off for off in offsets) / len(offsets)),
        most_m=max(map(abs, offsets)),
        ground_speed_m_s=sum(speeds) / len(speeds),
    )


def _aim(rig: Rig, curve: Curve, index: int, kind: Kind) -> None:
    """Send the point of this index."""
    north_m, east_m = float(curve.north[index]), float(curve.east[index])
    if kind == "reposition":
        place = rig.place(north_m, east_m, _HEIGHT_M)
        rig.command(192, -1.0, 1.0, 0.0, NAN, *place, frame=5)
        return
    heading, bend = float(curve.heading[index]), float(curve.curvature[index])
    speed_m_s = 14.0  # asked for; the size of the velocity means nothing
    ahead_n, ahead_e = math.cos(heading), math.sin(heading)
    lateral = speed_m_s**2 * bend * (-1.0 if kind == "pos + vel - acc" else 1.0)
    masks = {"position": POSITION_ONLY, "pos + vel": POSITION_VELOCITY}
    rig.send(
        masks.get(kind, ALL_THREE),
        (north_m, east_m, -_HEIGHT_M),
        (speed_m_s * ahead_n, speed_m_s * ahead_e, 0.0),
        (-lateral * ahead_e, lateral * ahead_n, 0.0),
    )
