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
from companion.planner import procedure
from companion.planner.procedure import Leg, Reference, Vector, hover_pose
from companion.planner.progress import NO_PROGRESS
from companion.planner.request import NotPlanned, Planned, PlanOutcome, PlanRequest, Refusal
from companion.planner.settings import Place, Task
from companion.world.known_map import KnownMap, Scan
from companion.world.near_map import NearMap, NearSensor, top_amsl_m
from companion.world.simulated import NearScene, simulated_scan

_TIMES_AS_MANY, _MIN_MOST_LEGS = 6, 150  # missions have arrived after 76, among walls
_MAX_ATTEMPTS = 4  # from one place, each with a wider search
_ROUNDING = 1e-6  # of a sweep
_LOOKS_FIRST_S = 2.0  # a vehicle that takes off has looked about for longer than that

Scanner = Callable[[KnownMap, Vector, float], Scan]
"""What is seen of the truth from a point (north, east, altitude) with a range, metres."""


@final
@dataclass(slots=True, kw_only=True, eq=False)
class OfflineFlight:
    """A flight, or as much of it as was flown."""

    known: KnownMap
    """What its scans have shown."""
    legs: list[Leg] = field(default_factory=list)
    flown_m: list[float] = field(default_factory=list)  # how far each leg was flown
    plans: list[Planned] = field(default_factory=list)
    scans_nea_m: list[Vector] = field(default_factory=list)
    """Where it scanned: the start is the first."""
    failure: NotPlanned | None = None  # why it ended before the target; None: it did not
    holds: int = 0  # how often it had to stop, for want of a successor or for what it saw
    seconds: float = 0.0  # an estimate of how long it took, from the first leg on, with its stops

    def route_nea_m(self, spacing_m: float) -> FloatArray:
        """What was flown, points so far apart or less.  -> (S, 3)."""
        pieces = [np.array([self.scans_nea_m[0]])]
        for leg, flown_m in zip(self.legs, self.flown_m, strict=True):
            count = max(math.ceil(flown_m / spacing_m), 1)
            pieces.append(leg.subpath.points_nea_m(np.linspace(0.0, flown_m, count + 1)[1:]))
        return np.concatenate(pieces)


def fly_offline(
    task: Task,
    *,
    blank: KnownMap,
    truth: KnownMap,
    start_nea_m: Vector,
    targets_ne_m: tuple[Place, ...],
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
    flight, left_ne_m, settings = OfflineFlight(known=blank), [*targets_ne_m], task.settings
    most_legs = most_legs or usual_most_legs(task, start_nea_m, targets_ne_m)

    def flies(until_m: float, *, goes_on: bool = False) -> bool:
        """Fly on along the leg to a length, or to its end.  -> whether it is under way there.

        Else it has stopped, at the end or for what it saw.  goes_on: the next leg begins there.
        """
        leg, from_m = flight.legs[-1], flight.flown_m[-1]
        end_m = until_m = min(until_m, leg.subpath.length_m)
        took_s = (end_m - from_m) * procedure.paced_s_m(leg.subpath, leg.motion)
        if on_board is not None:
            end_m, took_s = on_board.flies(leg, from_m, until_m, goes_on=goes_on)
        flight.seconds += took_s
        flight.flown_m[-1] = end_m
        return end_m == until_m and (goes_on or until_m < leg.subpath.length_m)

    ask = PlanRequest(
        plan_id=0, seed=seed, task=task, known=blank, scan_nea_m=start_nea_m,
        start=hover_pose(start_nea_m), from_rest=True, target_ne_m=left_ne_m[0],
    )  # fmt: skip
    while left_ne_m and ask.attempt < _MAX_ATTEMPTS:
        if len(flight.legs) < most_legs:
            if on_board is None:
                scan = scanner(truth, ask.scan_nea_m, settings.scan_range_m)
                rests_s = task.stop_m / task.limits.speed_m_s
            else:
                scan, rests_s = on_board.scan(ask.scan_nea_m, at_rest=ask.from_rest)
            flight.seconds += rests_s if ask.from_rest else 0.0
            flight.scans_nea_m.append(ask.scan_nea_m)
            flight.known = ask.known.with_scan(scan)
            ask = replace(ask, plan_id=ask.plan_id + 1, known=flight.known)
            outcome = planner(ask)
        else:
            outcome = NotPlanned(plan_id=ask.plan_id, refusal=Refusal.TOO_MANY_LEGS)
        flight.failure = None
        if isinstance(outcome, Planned):  # to p_prog of the leg under way, then to the next p_scan
            ask = replace(ask, attempt=0, progress=outcome.progress)
            if ask.from_rest or flies(flight.legs[-1].successor_at_m, goes_on=True):
                leg = Leg.of(outcome, len(flight.legs) + 1, task)
                flight.plans.append(outcome)
                flight.legs.append(leg)
                flight.flown_m.append(0.0)
                scan_at_m = leg.scan_at_m if leg.wants_successor(math.inf) else math.inf
                if flies(scan_at_m):
                    scan_nea_m = leg.subpath.pose(scan_at_m).point_nea_m
                    prog = leg.subpath.pose(leg.successor_at_m)
                    ask = replace(
                        ask, scan_nea_m=scan_nea_m, start=prog, from_rest=False, rest=leg.rest
                    )
                    continue
        else:
            assert isinstance(outcome, NotPlanned)  # the way back is never asked for
            flight.failure = outcome
            if ask.from_rest:
                ask = replace(ask, attempt=ask.attempt + 1)
                continue
            flies(math.inf)
        # it has stopped: at a target, at the end of a leg, or for what it saw
        leg, end_m = flight.legs[-1], flight.flown_m[-1]
        here = leg.subpath.pose(end_m).point_nea_m
        ask = replace(ask, scan_nea_m=here, start=hover_pose(here), from_rest=True, rest=None)
        if leg.reaches_target and end_m == leg.subpath.length_m:
            left_ne_m.pop(0)
            if left_ne_m:
                ask = replace(ask, target_ne_m=left_ne_m[0], progress=NO_PROGRESS)
        else:
            flight.holds += 1
    return flight


def usual_most_legs(task: Task, start_nea_m: Vector, targets_ne_m: tuple[Place, ...]) -> int:
    """Six times as many as a straight way has, or 150 if that is more."""
    leg_m = max(task.end_radius_m - task.tail_m, 0.1 * task.settings.scan_range_m)
    ways = pairwise([start_nea_m[:2], *targets_ne_m])
    legs = sum(math.ceil(math.dist(*way) / leg_m) for way in ways)
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

    def scan(self, at_nea_m: Vector, *, at_rest: bool) -> tuple[Scan, float]:
        """What it has come to know since the last time, and the seconds of a rest that it took.

        At rest it looks about first: as long as a scan and a plan take, longer before it sets out.
        """
        settings, sets_out = self._task.settings, self._now_s == 0.0
        rests_s = settings.scan_time_s + settings.planning_time_s if at_rest else 0.0
        looks_s = max(rests_s, _LOOKS_FIRST_S) if sets_out else rests_s
        self.look(at_nea_m[:2], self._heading_rad, 0.0, seconds=looks_s)
        return self.near.scan(self._ground_m, self._top_m), 0.0 if sets_out else rests_s

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
        motion, slow = leg.motion, leg.slows_to_m_s
        while self._reference.length_m < until_m and not procedure.is_at_end(self._reference, leg):
            here = leg.subpath.pose(self._reference.length_m).position_nea_m
            self._reference = procedure.advance(
                self._reference, leg, step_s, here, goes_on=goes_on, slows_to_m_s=slow
            )
            at_m, speed_m_s = self._reference.length_m, self._reference.speed_m_s
            pose = leg.subpath.pose(at_m)
            self._heading_rad = math.atan2(pose.tangent_nea[1], pose.tangent_nea[0])
            self.look(pose.point_nea_m[:2], self._heading_rad, speed_m_s, seconds=step_s)
            if leg.meets(self.near, at_m, kept_m):
                self._now_s += speed_m_s / task.limits.acceleration_m_s2
                self._reference = Reference()
                stop_m = min(at_m + stopping_m(motion, speed_m_s), np.nextafter(until_m, 0.0))
                return float(stop_m), self._now_s - began_s
        if until_m == leg.subpath.length_m and not goes_on:
            self._reference = Reference()
        return until_m, self._now_s - began_s

    def look(
        self, place_ne_m: Place, heading_rad: float, speed_m_s: float, *, seconds: float
    ) -> None:
        """Look about at a place for a while."""
        period_s = 1.0 / self._scene.rate_hz
        for _ in range(math.ceil(seconds / period_s - _ROUNDING)):
            self._now_s += period_s
            sweep = self._scene.sweep(self._sensor, self._now_s, place_ne_m, heading_rad, speed_m_s)
            self.near.add(sweep)
