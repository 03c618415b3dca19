"""An offline flight among near things: what a sensor on board sees on the way, and when.

The vehicle tracks its reference point perfectly, so that is where the sensor is.
"""

import math
from collections.abc import Iterator
from typing import final

import numpy as np

from companion.path.envelope import stopping_m
from companion.planner.offline import OfflineFlight
from companion.planner.procedure import Leg, Reference, advance, is_at_end
from companion.planner.recheck import meets_near_things
from companion.planner.settings import Task
from companion.world.known_map import KnownMap, Scan
from companion.world.lattice import Window
from companion.world.near_map import NearMap, NearSensor, both, top_amsl_m
from companion.world.simulated_sweep import NearScene

_ROUNDING = 1e-6  # of a sweep
_LOOKS_FIRST_S = 2.0
"""At the start: a vehicle that takes off has looked about for longer than that."""


@final
class OnBoard:
    """A near sensor and its map: `scan` and `flies` are what `fly_offline` asks for."""

    def __init__(self, sensor: NearSensor, scene: NearScene, task: Task, blank: KnownMap) -> None:
        """blank: `guess_m` tells how high the ground is, which the sensor does not see."""
        assert blank.guess_m is not None
        self.near = NearMap(blank.bare(), sensor.free_for_s(task.limits.navigation_error_m))
        self._sensor, self._scene, self._task, self._ground_m = sensor, scene, task, blank.guess_m
        self._top_m = top_amsl_m(task.limits.ceiling_amsl_m, sensor.range_m)
        self._now_s = 0.0
        self.began_s: float | None = None
        """When the first leg was begun."""
        self._changed: Window | None = None
        self._reference, self._heading_rad, self._rests = Reference(), 0.0, True

    @property
    def flown_s(self) -> float:
        """How long the flight has taken."""
        return 0.0 if self.began_s is None else self._now_s - self.began_s

    def scan(self, _truth: KnownMap, at_nea_m: tuple[float, float, float], _range_m: float) -> Scan:
        """What it has come to know since the last time; at rest it looks about first."""
        if self._rests:
            looks_s = resting_s(self._task)
            looks_s = max(looks_s, _LOOKS_FIRST_S) if self.began_s is None else looks_s
            self.look((at_nea_m[0], at_nea_m[1]), self._heading_rad, 0.0, seconds=looks_s)
        changed, self._changed = self._changed, None
        return self.near.scan(changed, self._ground_m, self._top_m)

    def flies(self, leg: Leg, from_m: float, until_m: float, goes_on: bool) -> float:
        """Look about along a part of a leg.  -> until_m, or where it stopped for something."""
        if self.began_s is None:
            self.began_s = self._now_s
        if from_m == 0.0:  # a new one: it goes on at the speed at which the last one was left
            self._reference = Reference(speed_m_s=self._reference.speed_m_s)
        task, length_m = self._task, leg.subpath.length_m
        kept_m = task.settings.safety_distance_m + task.limits.tracking_error_m
        self._rests = until_m == length_m and not goes_on
        step_s = 1.0 / self._scene.rate_hz
        for reference in along(leg, task, self._reference, until_m, step_s, goes_on=goes_on):
            self._reference, at_m = reference, reference.length_m
            pose = leg.subpath.pose(at_m)
            self._heading_rad = math.atan2(pose.tangent_nea[1], pose.tangent_nea[0])
            self.look(pose.point_nea_m[:2], self._heading_rad, reference.speed_m_s, seconds=step_s)
            if meets_near_things(leg, at_m, self.near, kept_m):
                stop_m = at_m + stopping_m(task.envelope, reference.speed_m_s)
                self._now_s += reference.speed_m_s / task.limits.acceleration_m_s2
                self._reference, self._rests = Reference(), True
                return float(min(stop_m, np.nextafter(until_m, 0.0)))
        if self._rests:
            self._reference = Reference()
        return until_m

    def look(
        self,
        place_ne_m: tuple[float, float],
        heading_rad: float,
        speed_m_s: float,
        *,
        seconds: float,
    ) -> None:
        """Look about at a place for a while."""
        period_s = 1.0 / self._scene.rate_hz
        for _ in range(math.ceil(seconds / period_s - _ROUNDING)):
            self._now_s += period_s
            sweep = self._scene.sweep(self._sensor, self._now_s, place_ne_m, heading_rad, speed_m_s)
            self._changed = both(self._changed, self.near.add(sweep))


def resting_s(task: Task) -> float:
    """How long it stands at rest for each scan and plan."""
    return task.settings.scan_time_s + task.settings.planning_time_s


def along(
    leg: Leg,
    task: Task,
    reference: Reference,
    until_m: float,
    step_s: float,
    *,
    goes_on: bool,
) -> Iterator[Reference]:
    """The reference point of a copter that tracks it perfectly, step by step, to a length."""
    slows_to_m_s = leg.slows_to_m_s(task)
    while reference.length_m < until_m and not is_at_end(reference, leg):
        here = leg.subpath.pose(reference.length_m).position_nea_m
        reference = advance(
            reference,
            leg,
            step_s,
            here,
            task.envelope,
            goes_on=goes_on,
            slows_to_m_s=slows_to_m_s,
        )
        yield reference


def flight_time_s(flight: OfflineFlight, task: Task, step_s: float = 0.1) -> float:
    """How long an offline flight takes: speeding up, slowing down, and at rest for each plan.

    A plane flies at V all the time.
    """
    if not task.limits.hovers:
        return sum(flight.flown_m) / task.limits.speed_m_s
    seconds, reference, rests = 0.0, Reference(), len(flight.scans_nea_m) - 1
    for leg, flown_m in zip(flight.legs, flight.flown_m, strict=True):
        scan_m, length_m = leg.scan_at_m(task), leg.subpath.length_m
        rests -= leg.wants_successor(length_m, task) and flown_m > scan_m
        goes_on = length_m > flown_m >= leg.successor_at_m(task)
        for until_m, onwards in ((min(scan_m, flown_m), False), (flown_m, goes_on)):
            steps = list(along(leg, task, reference, until_m, step_s, goes_on=onwards))
            seconds, reference = seconds + step_s * len(steps), (steps or [reference])[-1]
        reference = Reference(speed_m_s=reference.speed_m_s if goes_on else 0.0)
    return seconds + rests * resting_s(task)
