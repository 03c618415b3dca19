"""What a vehicle touches, and whether it survives that: by its speed in all axes.

The one place that judges it, for all vehicles and autopilots, and in the air without one.
"""

import math
from collections.abc import Callable
from typing import Final, NamedTuple, final

import numpy as np

from vehicle_sim.dynamics import Vehicle
from vehicle_sim.geodesy import FloatArray, LocalFrame
from vehicle_sim.scene import Scene

CRASH_M_S: Final = 3.0
"""No faster into the ground: landing gear need not stand more than 3.05 m/s, 10 ft/s (CS 23.473,
STANAG 4671 USAR.473).  A copter has no wheels: sideways as fast, it tips over."""
RUNWAY_SLOPE: Final = 0.1
"""Where a plane may land faster than CRASH_M_S: five times the slope that a runway may have (2 %,
ICAO Annex 14, 3.1.13).  What is steeper is a hillside."""
_THINGS: Final = "a tree, wall, building or wire"
LOOK_US: Final = 100_000
"""Between looks at the ground below, of who is far from it."""
_LOW_M: Final = 20.0
"""Nobody sinks from here to the ground within a step."""
_OFF_GROUND_M: Final = 0.3
"""Above the ground by this much a plane has taken off: what comes then is a landing, or none."""
_SLOPE_M: Final = 0.5
"""The ground's slope is that between points so far to either side."""
_NEAR_M: Final = 3.0
"""Nearer to a thing than this, its distance is looked at in every step."""
_ALONG_M: Final = 0.01
"""Between the places along a step that are looked at when it may have flown through a thing."""
Velocity = tuple[float, float, float]
"""North, east, up, in m/s."""


@final
class Crash(NamedTuple):
    """Where, when, how fast and into what: the local frame, metres AMSL, vehicle time."""

    t_s: float
    north_m: float
    east_m: float
    altitude_amsl_m: float
    speed_m_s: float
    """In all axes, when it touched."""
    into: str
    """"the ground", or "a tree, wall, building or wire"."""


def is_crash(velocity_neu_m_s: Velocity, slope: complex, *, rolls: bool, lands: bool) -> bool:
    """Whether nobody survives this contact with ground of this slope, north + east j.

    `rolls`: a plane on its wheels may be fast along a runway.  Without `lands` it is on them
    already, or has not really left the ground.
    """
    if math.hypot(*velocity_neu_m_s) <= CRASH_M_S:
        return False
    if not rolls:
        return True
    north_m_s, east_m_s, up_m_s = velocity_neu_m_s
    closing_m_s = north_m_s * slope.real + east_m_s * slope.imag - up_m_s
    into_m_s = closing_m_s / math.hypot(1.0, abs(slope))  # along the ground's normal
    return into_m_s > CRASH_M_S or (lands and abs(slope) > RUNWAY_SLOPE)


@final
class Contact:
    """One vehicle, the ground below it and the things about it.

    `prepare` comes before each step of the vehicle and `settle` after it; `look` from time to time.
    on_crash: told of each contact that nobody survives.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        scene: Scene,
        frame: LocalFrame,
        *,
        rolls: bool,
        on_crash: Callable[[Crash], None],
    ) -> None:
        self._vehicle, self._frame = vehicle, frame
        self._height_m, self.scene = scene.terrain.height_at_amsl_m, scene
        self._rolls, self._on_crash = rolls, on_crash
        self.local_m = frame.to_local(vehicle.latitude_deg, vehicle.longitude_deg)
        self.ground_amsl_m = self._height_m(*self.local_m)
        """Height of the ground below, as of the last look."""
        self._stood, self._on_thing, self._took_off = True, False, False
        """Whether it stood before the step, and touched a thing; and has been well above ground."""
        self.nearest_m = self._near_m = math.inf
        """To a tree, wall, building or wire: the least of the whole flight; and the least since
        the last look."""
        self._unwatched_m = 0.0
        """It has to fly so far before it may be near anything."""
        self._measured_us = 0
        self._passed = self._passed_before = 0j
        """The slope along the way between the last two looks, and between those before."""
        self._before: Velocity | None = None
        """Its velocity before the step; None: it is far above the ground."""

    def place_nea_m(self) -> FloatArray:
        """North, east of the local frame, and AMSL, now.  -> (3,)."""
        vehicle = self._vehicle
        local_m = self._frame.to_local(vehicle.latitude_deg, vehicle.longitude_deg)
        return np.array([*local_m, vehicle.altitude_amsl_m])

    def look(self, now_us: int) -> float | None:
        """See the ground below.  -> How near it has come to anything since the last look."""
        self._measure(now_us)
        if self.scene.empty:
            return None
        position = np.array([*self.local_m, self._vehicle.altitude_amsl_m])
        near_m = min(self._near_m, float(self.scene.distance_m(position)[0]))
        self.nearest_m, self._near_m = min(self.nearest_m, near_m), math.inf
        return near_m

    def prepare(self, now_us: int) -> None:
        """Before a step: who is low has to know the ground as it is now."""
        above_m = self._vehicle.altitude_amsl_m - self.ground_amsl_m
        self._before, self._stood = None, self._vehicle.stands
        if above_m < _LOW_M:
            self._before = way = self._vehicle.velocity_neu_m_s
            is_far = above_m >= math.hypot(*way) * LOOK_US * 1e-6
            if not (self._stood or is_far or self._measured_us == now_us):
                self._measure(now_us)

    def settle(self, now_us: int, dt_s: float) -> None:
        """After it: whether it touches anything, and survives that."""
        if self._before is not None:
            self._touch_ground(self._before, now_us)
        if not self.scene.empty:
            self._touch_things(now_us, dt_s)

    def _measure(self, now_us: int) -> None:
        """Where it is in the world, how high the ground is there, and how it has risen."""
        before, before_amsl_m, vehicle = complex(*self.local_m), self.ground_amsl_m, self._vehicle
        self.local_m = self._frame.to_local(vehicle.latitude_deg, vehicle.longitude_deg)
        self.ground_amsl_m = self._height_m(*self.local_m)
        way_m, rise_m = complex(*self.local_m) - before, self.ground_amsl_m - before_amsl_m
        self._passed_before, self._measured_us = self._passed, now_us
        # as steep as the rise over the way, along it
        self._passed = rise_m / way_m.conjugate() if abs(way_m) > 1e-3 else 0j

    def _touch_ground(self, way: Velocity, now_us: int) -> None:
        above_m = self._vehicle.altitude_amsl_m - self.ground_amsl_m
        if above_m > 0.0:
            self._took_off = self._took_off or above_m > _OFF_GROUND_M
            return
        if self._stood:
            if self._measured_us != now_us or not any(way):
                return
            north_m_s, east_m_s, _ = way  # it rolls: along the ground, as that was
            rises_m_s = north_m_s * self._passed_before.real + east_m_s * self._passed_before.imag
            way = north_m_s, east_m_s, rises_m_s
        lands, self._took_off = self._took_off, False
        # by the slope about here, or by that of the way here, whichever is worse: a step up
        slopes = (self._slope(), self._passed)
        if any(is_crash(way, slope, rolls=self._rolls, lands=lands) for slope in slopes):
            self._vehicle.stand(self.ground_amsl_m)
            self._crash(way, "the ground", now_us)

    def _slope(self) -> complex:
        (north_m, east_m), height_m = self.local_m, self._height_m
        north = height_m(north_m + _SLOPE_M, east_m) - height_m(north_m - _SLOPE_M, east_m)
        east = height_m(north_m, east_m + _SLOPE_M) - height_m(north_m, east_m - _SLOPE_M)
        return complex(north, east) / (2.0 * _SLOPE_M)

    def _touch_things(self, now_us: int, dt_s: float) -> None:
        way = self._vehicle.velocity_neu_m_s
        step_m = math.hypot(*way) * dt_s
        self._unwatched_m -= step_m
        if self._unwatched_m > 0.0:
            return
        position = self.place_nea_m()
        near_m = float(self.scene.distance_m(position)[0])
        self._unwatched_m = near_m - _NEAR_M
        if 0.0 < near_m < step_m:  # it may have flown through
            share = np.linspace(0.0, 1.0, math.ceil(step_m / _ALONG_M) + 1)[:, None]
            near_m = float(self.scene.distance_m(position - share * dt_s * np.array(way)).min())
        self._near_m = min(self._near_m, near_m)
        touches, self._on_thing = self._on_thing, near_m == 0.0
        if self._on_thing and not touches and any(way):
            if self._vehicle.altitude_amsl_m <= self.ground_amsl_m:
                self._vehicle.stand(self.ground_amsl_m)
            else:
                self._vehicle.hit()
            self._crash(way, _THINGS, now_us)

    def _crash(self, way: Velocity, into: str, now_us: int) -> None:
        north_m, east_m, altitude_m = self.place_nea_m().tolist()
        self._on_crash(Crash(now_us * 1e-6, north_m, east_m, altitude_m, math.hypot(*way), into))
