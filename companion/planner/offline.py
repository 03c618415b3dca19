"""The online procedure without a vehicle: simulated scans, or a sensor on board; perfect tracking.

The vehicle is where its reference point is, and so is the sensor.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Final, final

import numpy as np

from companion.geodesy import FloatArray
from companion.path.envelope import stopping_m
from companion.planner import procedure
from companion.planner.procedure import Leg, Reference, Vector, hover_pose
from companion.planner.progress import NO_PROGRESS, SLACK
from companion.planner.request import NotPlanned, Planned, PlanOutcome, PlanRequest, Refusal
from companion.planner.settings import Place, Task
from companion.world.known_map import KnownMap, Scan
from companion.world.near_map import NearMap, NearSensor, top_amsl_m
from companion.world.simulated import NearScene

_TIMES_AS_MANY, _MIN_MOST_LEGS = 6, 150  # missions have arrived after 76, among walls
_MAX_ATTEMPTS = 4  # from one place, each with a wider search
_ROUNDING = 1e-6  # of a sweep
_LOOKS_FIRST_S = 2.0  # a vehicle that takes off has looked about for longer than that


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
    sensor: "TerrainRadar | OnBoard",
    *,
    blank: KnownMap,
    start_nea_m: Vector,
    targets_ne_m: tuple[Place, ...],
    seed: int,
    planner: Callable[[PlanRequest], PlanOutcome],
    most_legs: int | None = None,
) -> OfflineFlight:
    """Scan, plan, go on to p_prog, until the last target is reached or nothing can be planned.

    As in flight: the vehicle stops at each target, and a leg without a successor is flown to its
    end, where the vehicle stops, scans and plans again.  It gives up after four plans in one place,
    each with a wider search, or after most_legs (None: `usual_most_legs`), with `TOO_MANY_LEGS`.
    """
    flight, left_ne_m = OfflineFlight(known=blank), [*targets_ne_m]
    most_legs = most_legs or usual_most_legs(task, start_nea_m, targets_ne_m)
    ask = PlanRequest(
        plan_id=0, seed=seed, task=task, known=blank, scan_nea_m=start_nea_m,
        start=hover_pose(start_nea_m), from_rest=True, target_ne_m=left_ne_m[0],
    )  # fmt: skip

    def flies(until_m: float, next_leg: Leg | None = None, *, asks: bool = False) -> bool:
        """Fly on along the leg to a length, or to its end.  -> whether it is under way there.

        Else it has stopped, at the end or for what it saw.  next_leg: it begins there.
        asks: only to where the next leg is asked for.
        """
        leg = flight.legs[-1]
        until_m = min(until_m, leg.subpath.length_m)
        flown_m, took_s, is_under_way = sensor.flies(leg, until_m, next_leg, asks=asks)
        flight.flown_m[-1], flight.seconds = flown_m, flight.seconds + took_s
        return is_under_way

    def asks() -> bool:
        """Fly on to where the next leg is asked for.  -> whether it is under way there."""
        nonlocal ask
        if not flies(math.inf, asks=True):
            return False
        leg, at = flight.legs[-1], sensor.reference
        leg = flight.legs[-1] = replace(leg, p_prog=leg.leaves(at))
        scan_nea_m = leg.subpath.pose(at.length_m).point_nea_m
        prog = leg.subpath.pose(leg.successor_at_m)
        ask = replace(ask, scan_nea_m=scan_nea_m, start=prog, from_rest=False, rest=leg.rest)
        return True

    while left_ne_m and ask.attempt < _MAX_ATTEMPTS:
        if len(flight.legs) < most_legs:
            scan, rests_s = sensor.scan(ask.scan_nea_m, at_rest=ask.from_rest)
            flight.seconds += rests_s
            flight.scans_nea_m.append(ask.scan_nea_m)
            flight.known = ask.known.with_scan(scan)
            ask = replace(ask, plan_id=ask.plan_id + 1, known=flight.known)
            outcome = planner(ask)
        else:
            outcome = ask.refused(Refusal.TOO_MANY_LEGS)
        flight.failure = None
        if isinstance(outcome, Planned):  # to p_prog of the leg under way, then until it is asked
            ask = replace(ask, attempt=0, progress=outcome.progress)
            leg = Leg.of(outcome, len(flight.legs) + 1, task)
            if ask.from_rest or flies(flight.legs[-1].successor_at_m, leg):
                flight.plans.append(outcome)
                flight.legs.append(leg)
                flight.flown_m.append(0.0)
                if asks():
                    continue
        else:
            assert isinstance(outcome, NotPlanned)  # the way back is never asked for
            flight.failure = outcome
            if ask.from_rest:
                ask = replace(ask, attempt=ask.attempt + 1)
                continue
            if outcome.refusal is Refusal.BETTER_TO_TURN:
                assert isinstance(sensor, OnBoard)
                flight.flown_m[-1], took_s = sensor.stops(flight.legs[-1])
                flight.seconds += took_s
            else:
                until_m = flight.legs[-1].successor_at_m if sensor.asks_again else math.inf
                if flies(until_m) and asks():
                    continue
        # it has stopped: at a target, at the end of a leg, or for what it saw
        leg, end_m = flight.legs[-1], flight.flown_m[-1]
        position = leg.subpath.pose(end_m).point_nea_m
        ask = replace(
            ask, scan_nea_m=position, start=hover_pose(position), from_rest=True, rest=None
        )
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
    if task.settings.is_near:
        leg_m = SLACK * task.settings.scan_range_m
    ways = pairwise([start_nea_m[:2], *targets_ne_m])
    legs = sum(math.ceil(math.dist(*way) / leg_m) for way in ways)
    return max(_MIN_MOST_LEGS, _TIMES_AS_MANY * legs)


@final
class TerrainRadar:
    """It is asked at p_scan, and sees nothing on the way."""

    asks_again: Final = False

    def __init__(self, task: Task, scanned: Callable[[Vector], Scan]) -> None:
        """scanned: what is seen from a point (north, east, altitude), metres."""
        self._task, self._scanned = task, scanned
        self.reference = Reference()
        """Of the leg that is flown."""

    def scan(self, at_nea_m: Vector, *, at_rest: bool) -> tuple[Scan, float]:
        """What it sees, and the seconds of a rest that it took."""
        rests_s = self._task.stop_m / self._task.limits.speed_m_s if at_rest else 0.0
        return self._scanned(at_nea_m), rests_s

    def flies(
        self, leg: Leg, until_m: float, next_leg: Leg | None, *, asks: bool
    ) -> tuple[float, float, bool]:
        """As `OnBoard.flies`: at the pace of the leg, and nothing is stopped for."""
        if asks and leg.can_be_left and not leg.reaches_target:
            until_m = leg.scan_at_m
        flown_m, length_m = until_m - self.reference.length_m, leg.subpath.length_m
        is_under_way = next_leg is not None or until_m < length_m
        goes_on = next_leg is None and is_under_way
        self.reference = Reference(length_m=until_m) if goes_on else Reference()
        return until_m, flown_m * procedure.paced_s_m(leg.subpath, leg.motion), is_under_way


@final
class OnBoard:
    """A near sensor and its map: it sees on the way, too."""

    asks_again: Final = True
    """Where a leg has no successor yet: each sweep shows more."""

    def __init__(self, sensor: NearSensor, scene: NearScene, task: Task, blank: KnownMap) -> None:
        """blank: `guess_m` tells how high the ground is, which the sensor does not see."""
        assert blank.guess_m is not None
        self.near = NearMap(blank.bare(), sensor.free_for_s(task.limits.navigation_error_m))
        self._sensor, self._scene, self._task, self._ground_m = sensor, scene, task, blank.guess_m
        self._top_m = top_amsl_m(task.limits.ceiling_amsl_m, sensor.range_m)
        self._now_s = self._heading_rad = 0.0
        self.reference = Reference()
        """Of the leg that is flown."""

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
        self, leg: Leg, until_m: float, next_leg: Leg | None, *, asks: bool
    ) -> tuple[float, float, bool]:
        """Look about along a part of a leg.  next_leg: it begins at until_m.

        asks: to where the next leg is asked for.
        -> where it comes to, the seconds that it took, and whether it is under way there: else it
        has stopped, at the end or for something.
        """
        task, step_s, began_s = self._task, 1.0 / self._scene.rate_hz, self._now_s
        kept_m = task.settings.safety_distance_m + task.limits.tracking_error_m
        motion, slows_m_s = leg.motion, math.inf
        end_m = leg.subpath.length_m - procedure.ARRIVED_M
        while self.reference.length_m < min(until_m, end_m):
            if asks and leg.wants_successor(self.reference):
                return self.reference.length_m, self._now_s - began_s, True
            position = leg.subpath.pose(self.reference.length_m).position_nea_m
            if next_leg is not None:
                room_m = until_m - self.reference.length_m
                slows_m_s = procedure.entering_m_s(next_leg, motion, room_m)
            self.reference = procedure.advance(
                self.reference, leg, step_s, position, goes_on=False, slows_to_m_s=slows_m_s
            )
            at_m, speed_m_s = self.reference.length_m, self.reference.speed_m_s
            pose = leg.subpath.pose(at_m)
            self._heading_rad = math.atan2(pose.tangent_nea[1], pose.tangent_nea[0])
            self.look(pose.point_nea_m[:2], self._heading_rad, speed_m_s, seconds=step_s)
            if leg.meets(self.near, at_m, kept_m):
                stop_m, _ = self.stops(leg)
                return stop_m, self._now_s - began_s, False
        took_s, reference = self._now_s - began_s, self.reference
        if next_leg is not None:
            on_it_m = max(reference.length_m - until_m, 0.0)
            self.reference = replace(reference, length_m=on_it_m)  # on the next leg
            return until_m, took_s, True
        if reference.length_m < end_m:
            return reference.length_m, took_s, True
        self.reference = Reference()
        return leg.subpath.length_m, took_s, False

    def stops(self, leg: Leg) -> tuple[float, float]:
        """Stop on a leg at once.  -> where it comes to, and the seconds that it took."""
        at, self.reference = self.reference, Reference()
        stops_s = at.speed_m_s / self._task.limits.acceleration_m_s2
        self._now_s += stops_s
        stop_m = at.length_m + stopping_m(leg.motion, at.speed_m_s)
        return min(stop_m, float(np.nextafter(leg.subpath.length_m, 0.0))), stops_s

    def look(
        self, place_ne_m: Place, heading_rad: float, speed_m_s: float, *, seconds: float
    ) -> None:
        """Look about at a place for a while."""
        period_s = 1.0 / self._scene.rate_hz
        for _ in range(math.ceil(seconds / period_s - _ROUNDING)):
            self._now_s += period_s
            sweep = self._scene.sweep(self._sensor, self._now_s, place_ne_m, heading_rad, speed_m_s)
            self.near.add(sweep)
