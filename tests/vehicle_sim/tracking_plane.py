"""Flies an ArduPlane without wire and server: for tests, and for tables of how well it follows."""

import copy
import functools
import math
from collections.abc import Callable

import harness
import numpy as np
from harness import STEP_S

from vehicle_sim.autopilot.factory import PERSONALITIES
from vehicle_sim.autopilot.values import Result, SendMessage
from vehicle_sim.dynamics.plane import Plane
from vehicle_sim.geodesy import LocalFrame
from vehicle_sim.plans import Plans
from vehicle_sim.sensors.gps import ARDUPLANE, Gps

LATITUDE_DEG, LONGITUDE_DEG, GROUND_M = -35.3632621, 149.1652370, 584.09
REPOSITION, CHANGE_SPEED, CHANGE_HEADING = 192, 43000, 43002
GUIDED, TAKEOFF = 15, 13
RADIUS_MOST_M = 600.0
"""Of an osculating circle: the route has straight places."""
AGE_STEPS = 15
"""A client knows where the vehicle was 0.15 s ago: telemetry at 10 Hz, and its own time."""


class Rig(harness.Rig):
    """A plane over flat ground at home, with its autopilot and its receiver."""

    def __init__(self, parameters: dict[str, float] | None = None, *, heading_deg: float = 0.0):
        self.plane = Plane(
            latitude_deg=LATITUDE_DEG,
            longitude_deg=LONGITUDE_DEG,
            altitude_amsl_m=GROUND_M,
            heading_rad=math.radians(heading_deg),
        )
        self.plans = Plans()
        rng = np.random.default_rng(1)
        autopilot = PERSONALITIES["ardupilot", "plane"].boot(
            self.plane, parameters or {}, self.plans, rng
        )
        super().__init__(autopilot, GROUND_M, Gps(ARDUPLANE, rng))
        self.frame = LocalFrame(latitude_deg=LATITUDE_DEG, longitude_deg=LONGITUDE_DEG)

    def set_mode(self, mode: int) -> Result:
        return self.command(176, 1.0, mode)

    def reposition(
        self, north_m: float, east_m: float, up_m: float, radius_m: float = 0.0, ccw: float = 0.0
    ) -> Result:
        latitude_deg, longitude_deg = self.frame.to_geographic(north_m, east_m)
        return self.command(
            REPOSITION, -1.0, 1.0, radius_m, ccw, latitude_deg, longitude_deg, up_m, frame=3
        )

    def into_the_air(self, height_m: float = 80.0) -> None:
        """Take off by TAKEOFF, then GUIDED, on the way to this height above home."""
        if self.now_s < 24.0:
            self.run(24.0 - self.now_s)
        assert self.set_mode(TAKEOFF) is Result.ACCEPTED
        assert self.command(400, 1.0) is Result.ACCEPTED
        self.run_until(lambda: self.height_m > 48.0)
        assert self.reposition(0.0, 0.0, height_m) is Result.ACCEPTED

    @property
    def ne_m(self) -> tuple[float, float]:
        return self.frame.to_local(self.plane.latitude_deg, self.plane.longitude_deg)

    def reached(self) -> list[float]:
        """When MISSION_ITEM_REACHED was said."""
        return [time_s for time_s, reply in self.said if isinstance(reply, SendMessage)]


class Weave:
    """A route whose heading is a sine of the way: metres north and east, by metres along it."""

    def __init__(self, lateral_m_s2: float, *, speed_m_s: float = 21.0, swing_deg: float = 25.0):
        swing_rad = math.radians(swing_deg)
        # curvature at most swing * 2 pi / wavelength = lateral / speed^2
        self.wavelength_m = swing_rad * math.tau * speed_m_s**2 / lateral_m_s2
        self.along_m = np.arange(0.0, 6000.0, 1.0)
        self.heading_rad = swing_rad * np.sin(math.tau * self.along_m / self.wavelength_m)
        self.curvature_1_m = np.gradient(self.heading_rad)
        self.north_m = np.concatenate(([0.0], np.cumsum(np.cos(self.heading_rad))[:-1]))
        self.east_m = np.concatenate(([0.0], np.cumsum(np.sin(self.heading_rad))[:-1]))

    def nearest(self, ne_m: tuple[float, float], about: int) -> tuple[int, float]:
        """Index of the point nearest to this one, not far from the last, and its distance."""
        low, high = max(about - 100, 0), about + 300
        distances_m = np.hypot(self.north_m[low:high] - ne_m[0], self.east_m[low:high] - ne_m[1])
        k = int(np.argmin(distances_m))
        return low + k, float(distances_m[k])

    def point(self, k: int) -> tuple[float, float]:
        return float(self.north_m[k]), float(self.east_m[k])


Law = Callable[[Rig, Weave, int], object]
"""Sends what it takes, with the index of the nearest point."""


def look_ahead(ahead_m: float, radius_m: float) -> Law:
    """DO_REPOSITION to a point ahead on the route."""

    def send(rig: Rig, route: Weave, nearest: int) -> object:
        return rig.reposition(*route.point(nearest + round(ahead_m)), 80.0, radius_m)

    return send


def osculating(ahead_s: float, smaller_m: float = 17.0) -> Law:
    """DO_REPOSITION to the centre of curvature of the route some seconds ahead."""

    def send(rig: Rig, route: Weave, nearest: int) -> object:
        k = nearest + round(ahead_s * rig.speed_m_s)
        curvature = float(route.curvature_1_m[k])
        radius_m = min(1.0 / max(abs(curvature), 1e-6), RADIUS_MOST_M)
        side = math.copysign(1.0, curvature)
        north, east = route.point(k)
        heading = float(route.heading_rad[k])
        north -= side * radius_m * math.sin(heading)
        east += side * radius_m * math.cos(heading)
        ccw = 1.0 if side < 0.0 else 0.0
        return rig.reposition(north, east, 80.0, max(radius_m - smaller_m, 2.0), ccw)

    return send


def heading_towards(ahead_m: float, lateral_m_s2: float = 6.0) -> Law:
    """GUIDED_CHANGE_HEADING, course over ground, towards a point ahead."""

    def send(rig: Rig, route: Weave, nearest: int) -> object:
        north, east = route.point(nearest + round(ahead_m))
        here_n, here_e = rig.ne_m
        course_deg = math.degrees(math.atan2(east - here_e, north - here_n)) % 360.0
        return rig.command(CHANGE_HEADING, 0.0, course_deg, lateral_m_s2, frame=3)

    return send


@functools.cache
def _flying(settle_s: float, parameters: tuple[tuple[str, float], ...]) -> Rig:
    rig = Rig(dict(parameters))
    rig.into_the_air()
    rig.run(settle_s)
    return rig


def flying(parameters: dict[str, float] | None = None, *, settle_s: float = 30.0) -> Rig:
    """A copy of one that has been in the air for so long."""
    return copy.deepcopy(_flying(settle_s, tuple((parameters or {}).items())))


@functools.cache
def _before_the_route() -> Rig:
    """400 m south of home, where routes begin."""
    rig = flying({"AIRSPEED_CRUISE": 20.0}, settle_s=0.0)
    rig.reposition(-900.0, 0.0, 80.0, 10.0)
    rig.run_until(lambda: rig.ne_m[0] < -800.0)
    rig.reposition(-200.0, 0.0, 80.0, 10.0)
    rig.run_until(lambda: rig.ne_m[0] > -410.0)
    return rig


def off_path_m(law: Law, lateral_m_s2: float, *, hz: float = 4.0) -> tuple[float, float]:
    """Distance from the route, rms and most, at an airspeed of 20 m/s; the first 400 m apart."""
    rig, route = copy.deepcopy(_before_the_route()), Weave(lateral_m_s2)
    route.north_m -= 400.0
    known = nearest = 0
    errors_m = list[float]()
    every = round(1.0 / hz / STEP_S)
    for k in range(10_000):
        if k % every == AGE_STEPS % every:
            law(rig, route, known)
        if k % every == 0:
            known, _ = route.nearest(rig.ne_m, nearest)
        rig.step()
        if k % 10 == 0:
            nearest, distance_m = route.nearest(rig.ne_m, nearest)
            if nearest > 400:
                errors_m.append(distance_m)
    return float(np.sqrt(np.mean(np.square(errors_m)))), max(errors_m)


TABLE: tuple[tuple[str, Law, float, float, tuple[float, float]], ...] = (
    ("reposition 115 m ahead, radius 10 m", look_ahead(115.0, 10.0), 1.0, 4.0, (3.0, 4.4)),
    ("reposition 60 m ahead, radius 10 m", look_ahead(60.0, 10.0), 2.0, 4.0, (31.0, 40.0)),
    ("reposition 80 m ahead, radius 10 m", look_ahead(80.0, 10.0), 2.0, 4.0, (24.0, 35.0)),
    ("reposition 100 m ahead, radius 10 m", look_ahead(100.0, 10.0), 2.0, 4.0, (7.5, 13.9)),
    ("reposition 115 m ahead, radius 10 m", look_ahead(115.0, 10.0), 2.0, 4.0, (6.0, 8.8)),
    ("reposition 115 m ahead, radius 2 m", look_ahead(115.0, 2.0), 2.0, 4.0, (6.0, 8.8)),
    ("reposition 130 m ahead, radius 10 m", look_ahead(130.0, 10.0), 2.0, 4.0, (7.9, 12.5)),
    ("reposition 130 m ahead, radius 10 m", look_ahead(130.0, 10.0), 2.0, 10.0, (8.2, 12.8)),
    ("reposition 160 m ahead, radius 10 m", look_ahead(160.0, 10.0), 2.0, 4.0, (11.6, 18.7)),
    ("reposition 160 m ahead, radius 10 m", look_ahead(160.0, 10.0), 2.0, 1.0, (10.6, 16.6)),
    ("reposition 200 m ahead, usual radius", look_ahead(200.0, 0.0), 2.0, 4.0, (16.6, 28.0)),
    ("reposition 300 m ahead, usual radius", look_ahead(300.0, 0.0), 2.0, 4.0, (25.0, 48.0)),
    ("osculating circle 2 s ahead", osculating(2.0), 2.0, 4.0, (5.0, 12.0)),
    ("heading to a point 60 m ahead", heading_towards(60.0), 2.0, 4.0, (11.0, 16.0)),
    ("reposition 110 m ahead, radius 10 m", look_ahead(110.0, 10.0), 3.5, 4.0, (9.5, 14.3)),
    ("reposition 130 m ahead, radius 10 m", look_ahead(130.0, 10.0), 3.5, 4.0, (12.1, 19.6)),
    ("osculating circle 2 s ahead", osculating(2.0), 3.5, 4.0, (8.7, 12.0)),
)
"""ardupilot.md 7, "Following a weaving route at 21 m/s": law, lateral acceleration of the route in
m/s2, Hz, and what the real one was off the path, rms and most in m.  That "80 m" of the row
"60 m, radius 10 / 80 m" is a look-ahead is read from its figures."""
