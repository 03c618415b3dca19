"""The online procedure without a vehicle: simulated scans, or a sensor on board; perfect tracking.

The vehicle is where its reference point is, and so is the sensor.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import final

import numpy as np

from companion.geodesy import FloatArray
from companion.path.envelope import stopping_m
from companion.planner.procedure import (
    Leg,
    Reference,
    Vector,
    advance,
    hover_pose,
    is_at_end,
    paced_s_m,
)
from companion.planner.progress import NO_PROGRESS
from companion.planner.recheck import meets_near_things
from companion.planner.request import NotPlanned, Planned, PlanOutcome, PlanRequest, Refusal
from companion.planner.settings import Task
from companion.world.known_map import KnownMap, Scan
from companion.world.near_map import NearMap, NearSensor, top_amsl_m
from companion.world.simulated_scan import simulated_scan
from companion.world.simulated_sweep import NearScene

_TIMES_AS_MANY, _MIN_MOST_LEGS = 6, 60  # far beyond any mission that has arrived
_MAX_ATTEMPTS = 4  # from one place, each with a wider search
_ROUNDING = 1e-6  # of a sweep
_LOOKS_FIRST_S = 2.0  # a vehicle that takes off has looked about for longer than that

Scanner = Callable[[KnownMap, Vector, float], Scan]
"""What is seen of the truth from a point (north, east, altitude) with a range, metres."""


@final
@dataclass(slots=True, kw_only=True, eq=False)
class OfflineFlight:
    """A flight, or as much of it as was flown."""

    next: PlanRequest
    """The next request: where the vehicle is, what it knows by now, what it heads for."""
    left_ne_m: list[tuple[float, float]]  # targets that it has not reached
    on_board: "OnBoard | None" = None
    legs: list[Leg] = field(default_factory=list)
    flown_m: list[float] = field(default_factory=list)  # how far each leg was flown
    plans: list[Planned] = field(default_factory=list)
    scans_nea_m: list[Vector] = field(default_factory=list)
    """Where it scanned: the start is the first."""
    failure: NotPlanned | None = None  # why it ended before the target; None: it did not
    holds: int = 0  # how often it had to stop, for want of a successor or for what it saw
    seconds: float = 0.0  # an estimate of how long it took, from the first leg on, with its stops

    @property
    def known(self) -> KnownMap:
        """What its scans have shown."""
        return self.next.known

    def route_nea_m(self, spacing_m: float) -> FloatArray:
        """What was flown, points so far apart or less.  -> (S, 3)."""
        pieces = [np.array([self.scans_nea_m[0]])]
        for leg, flown_m in zip(self.legs, self.flown_m, strict=True):
            count = max(math.ceil(flown_m / spacing_m), 1)
            pieces.append(leg.subpath.points_nea_m(np.linspace(0.0, flown_m, count + 1)[1:]))
        return np.concatenate(pieces)

    def scan(self, truth: KnownMap, scanner: Scanner) -> None:
        """Scan from where the next request says."""
        ask, task, settings = self.next, self.next.task, self.next.task.settings
        if self.on_board is None:
            scan = scanner(truth, ask.scan_nea_m, settings.scan_range_m)
            self.seconds += task.stop_m / task.limits.speed_m_s if ask.from_rest else 0.0
        else:
            rests_s = settings.scan_time_s + settings.planning_time_s if ask.from_rest else 0.0
            looks_s = rests_s if self.scans_nea_m else max(rests_s, _LOOKS_FIRST_S)
            scan = self.on_board.scan(ask.scan_nea_m, looks_s)
            self.seconds += rests_s if self.scans_nea_m else 0.0
        self.scans_nea_m.append(ask.scan_nea_m)
        self.next = replace(ask, plan_id=ask.plan_id + 1, known=ask.known.with_scan(scan))

    def take(self, outcome: PlanOutcome) -> None:
        """Fly on with an answer, to where the next scan is made."""
        ask, task, self.failure = self.next, self.next.task, None
        if not isinstance(outcome, Planned):
            assert isinstance(outcome, NotPlanned)  # the way back is never asked for
            self.failure = outcome
            if ask.from_rest:
                self.next = replace(ask, attempt=ask.attempt + 1)
            else:
                self.fly(math.inf)
            return
        route, progress = outcome.route_ne_m, outcome.progress
        self.next = replace(ask, attempt=0, route_ne_m=route, progress=progress)
        if not (ask.from_rest or self.fly(self.legs[-1].successor_at_m(task), goes_on=True)):
            return
        leg = Leg.of(outcome, len(self.legs) + 1)
        self.plans.append(outcome)
        self.legs.append(leg)
        self.flown_m.append(0.0)
        scan_at_m = leg.scan_at_m(task) if leg.wants_successor(math.inf, task) else math.inf
        if self.fly(scan_at_m):
            self.next = replace(
                self.next,
                scan_nea_m=leg.subpath.pose(scan_at_m).point_nea_m,
                start=leg.subpath.pose(leg.successor_at_m(task)),
                from_rest=False,
                rest=leg.rest(task),
            )

    def fly(self, until_m: float, *, goes_on: bool = False) -> bool:
        """Fly on along the leg to a length, or to its end.  -> whether it is under way there.

        Else it has stopped, at the end or for what it saw.  goes_on: the next leg begins there.
        """
        leg, from_m, length_m = self.legs[-1], self.flown_m[-1], self.legs[-1].subpath.length_m
        end_m = until_m = min(until_m, length_m)
        if self.on_board is None:
            took_s = (end_m - from_m) * paced_s_m(leg.subpath, leg.motion(self.next.task))
        else:
            end_m, took_s = self.on_board.flies(leg, from_m, until_m, goes_on=goes_on)
        self.seconds += took_s
        self.flown_m[-1] = end_m
        is_under_way = end_m == until_m and (goes_on or until_m < length_m)
        if not is_under_way:
            self._stop(leg.subpath.pose(end_m).point_nea_m, at_end=end_m == length_m)
        return is_under_way

    def _stop(self, here_nea_m: Vector, *, at_end: bool) -> None:
        """It stands; at a target it turns to the next one."""
        ask = replace(self.next, scan_nea_m=here_nea_m, start=hover_pose(here_nea_m))
        if at_end and self.legs[-1].reaches_target:
            target_ne_m = (self.left_ne_m[1:] or self.left_ne_m)[0]
            ask = replace(ask, target_ne_m=target_ne_m, route_ne_m=(), progress=NO_PROGRESS)
            self.left_ne_m.pop(0)
        else:
            self.holds += 1
        self.next = replace(ask, from_rest=True, rest=None)


def fly_offline(
    task: Task,
    *,
    blank: KnownMap,
    truth: KnownMap,
    start_nea_m: Vector,
    targets_ne_m: tuple[tuple[float, float], ...],
    seed: int,
    planner: Callable[[PlanRequest], PlanOutcome],
    scanner: Scanner = simulated_scan,
    on_board: "OnBoard | None" = None,
    most_legs: int | None = None,
) -> OfflineFlight:
    """Scan, plan, go on to p_prog, until the last target is reached or nothing can be planned.

    As in flight: the vehicle stops at each target, and a leg without a successor is flown to its
    end, where the vehicle stops, scans and plans again.  It gives up after four plans in one place,
    each with a wider search, or after most_legs (None: `usual_most_legs`), with `TOO_MANY_LEGS`.
    """
    ask = PlanRequest(
        plan_id=0,
        seed=seed,
        task=task,
        known=blank,
        scan_nea_m=start_nea_m,
        start=hover_pose(start_nea_m),
        from_rest=True,
        target_ne_m=targets_ne_m[0],
    )
    flight = OfflineFlight(next=ask, left_ne_m=list(targets_ne_m), on_board=on_board)
    most_legs = most_legs or usual_most_legs(task, start_nea_m, targets_ne_m)
    while flight.left_ne_m and flight.next.attempt < _MAX_ATTEMPTS:
        if len(flight.legs) >= most_legs:
            if not flight.next.from_rest:
                flight.fly(math.inf)
            flight.failure = flight.failure or NotPlanned(
                plan_id=flight.next.plan_id, refusal=Refusal.TOO_MANY_LEGS
            )
            break
        flight.scan(truth, scanner)
        flight.take(planner(flight.next))
    return flight


def usual_most_legs(
    task: Task, start_nea_m: Vector, targets_ne_m: tuple[tuple[float, float], ...]
) -> int:
    """Six times as many as a straight way has, or 60 if that is more."""
    places = [start_nea_m[:2], *targets_ne_m]
    leg_m = max(task.end_radius_m - task.tail_m, 0.1 * task.settings.scan_range_m)
    legs = sum(math.ceil(math.dist(a, b) / leg_m) for a, b in pairwise(places))
    return max(_MIN_MOST_LEGS, _TIMES_AS_MANY * legs)


@final
class OnBoard:
    """A near sensor and its map: what sees in place of a scanner, and on the way."""

    def __init__(self, sensor: NearSensor, scene: NearScene, task: Task, blank: KnownMap) -> None:
        """blank: `guess_m` tells how high the ground is, which the sensor does not see."""
        assert blank.guess_m is not None
        self.near = NearMap(blank.bare(), sensor.free_for_s(task.limits.navigation_error_m))
        self._sensor, self._scene, self._task, self._ground_m = sensor, scene, task, blank.guess_m
        self._top_m = top_amsl_m(task.limits.ceiling_amsl_m, sensor.range_m)
        self._now_s = self._heading_rad = 0.0
        self._reference = Reference()

    def scan(self, at_nea_m: Vector, looks_s: float) -> Scan:
        """What it has come to know since the last time; at rest it looks about first, so long."""
        self.look((at_nea_m[0], at_nea_m[1]), self._heading_rad, 0.0, seconds=looks_s)
        return self.near.scan(self._ground_m, self._top_m)

    def flies(
        self, leg: Leg, from_m: float, until_m: float, *, goes_on: bool
    ) -> tuple[float, float]:
        """Look about along a part of a leg.  goes_on: the next leg begins at until_m.

        -> until_m, or where it stopped for something, and the seconds that it took.
        """
        if from_m == 0.0:  # a new one: it goes on at the speed at which the last one was left
            self._reference = Reference(speed_m_s=self._reference.speed_m_s)
        task, step_s, began_s = self._task, 1.0 / self._scene.rate_hz, self._now_s
        kept_m = task.settings.safety_distance_m + task.limits.tracking_error_m
        motion, slow = leg.motion(task), leg.slows_to_m_s(task)
        while self._reference.length_m < until_m and not is_at_end(self._reference, leg):
            here = leg.subpath.pose(self._reference.length_m).position_nea_m
            self._reference = advance(
                self._reference, leg, step_s, here, motion, goes_on=goes_on, slows_to_m_s=slow
            )
            at_m, speed_m_s = self._reference.length_m, self._reference.speed_m_s
            pose = leg.subpath.pose(at_m)
            self._heading_rad = math.atan2(pose.tangent_nea[1], pose.tangent_nea[0])
            self.look(pose.point_nea_m[:2], self._heading_rad, speed_m_s, seconds=step_s)
            if meets_near_things(leg, at_m, self.near, kept_m):
                self._now_s += speed_m_s / task.limits.acceleration_m_s2
                self._reference = Reference()
                stop_m = min(at_m + stopping_m(motion, speed_m_s), np.nextafter(until_m, 0.0))
                return float(stop_m), self._now_s - began_s
        if until_m == leg.subpath.length_m and not goes_on:
            self._reference = Reference()
        return until_m, self._now_s - began_s

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
            self.near.add(sweep)
