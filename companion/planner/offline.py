"""The online procedure without a vehicle: simulated scans and perfect tracking."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import final

import numpy as np

from companion.geodesy import FloatArray
from companion.planner.procedure import Leg, hover_pose
from companion.planner.progress import NO_PROGRESS
from companion.planner.request import (
    Backtrack,
    NotPlanned,
    Planned,
    PlanOutcome,
    PlanRequest,
    Refusal,
)
from companion.planner.settings import Task
from companion.world.known_map import KnownMap, Scan
from companion.world.simulated_scan import simulated_scan

_MIN_MOST_LEGS = 60
_TIMES_AS_MANY = 6  # legs as a straight way of legs of full length has
_MAX_ATTEMPTS = 4  # from one place, each with a wider search


Scanner = Callable[[KnownMap, tuple[float, float, float], float], Scan]
"""What is seen of the truth from a point (north, east, altitude) with a range, metres."""
Flies = Callable[[Leg, float, float, bool], float]
"""Told of each part of a leg that is flown: from and to which length, and whether it goes on there.
-> where it stopped, if that was before."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class OfflineFlight:
    """All legs, the points where they were planned from, and what was known in the end."""

    legs: tuple[Leg, ...]
    flown_m: tuple[float, ...]
    """How far each leg was flown before the next took over."""
    plans: tuple[Planned, ...]
    scans_nea_m: tuple[tuple[float, float, float], ...]
    known: KnownMap
    failure: NotPlanned | None
    """Why it ended before the target; None: it did not."""
    holds: int
    """How often it had to stop at the end of a leg, for want of a successor."""

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
    start_nea_m: tuple[float, float, float],
    targets_ne_m: tuple[tuple[float, float], ...],
    seed: int,
    planner: Callable[[PlanRequest], PlanOutcome],
    scanner: Scanner = simulated_scan,
    flies: Flies | None = None,
    most_legs: int | None = None,
) -> OfflineFlight:
    """Scan, plan, go on to p_prog, until the last target is reached or nothing can be planned.

    most_legs: it gives up after so many, with `TOO_MANY_LEGS`; None: six times as many as a
    straight way has, or 60 if that is more.  From one place it plans up to four times, each time
    with a wider search.  flies: what looks about on the way.

    As in flight: the vehicle stops at each target, and a leg without a successor is flown to its
    end, where the vehicle stops, scans and plans again.
    """
    if most_legs is None:
        most_legs = usual_most_legs(task, start_nea_m, targets_ne_m)
    flight = _Flight(task, blank, start_nea_m, targets_ne_m, most_legs, flies)
    while not flight.is_over:
        flight.scan(truth, scanner)
        flight.take(planner(flight.request(seed)))
    return flight.result()


def usual_most_legs(
    task: Task,
    start_nea_m: tuple[float, float, float],
    targets_ne_m: tuple[tuple[float, float], ...],
) -> int:
    """The default limit of the number of legs of a flight."""
    places = [start_nea_m[:2], *targets_ne_m]
    leg_m = max(task.end_radius_m - task.tail_m, 0.1 * task.settings.scan_range_m)
    legs = sum(math.ceil(math.dist(a, b) / leg_m) for a, b in pairwise(places))
    return max(_MIN_MOST_LEGS, _TIMES_AS_MANY * legs)


@final
class _Flight:
    """An offline flight under way."""

    def __init__(
        self,
        task: Task,
        blank: KnownMap,
        start_nea_m: tuple[float, float, float],
        targets_ne_m: tuple[tuple[float, float], ...],
        most_legs: int,
        flies: Flies | None,
    ) -> None:
        self._most_legs, self._flies, self._at_m = most_legs, flies, 0.0
        self._task, self._known, self._left = task, blank, list(targets_ne_m)
        self._pose, self._scan_nea_m, self._from_rest = hover_pose(start_nea_m), start_nea_m, True
        self._route: tuple[tuple[float, float], ...] = ()
        self._progress = NO_PROGRESS
        self._attempt = self._holds = self._requests = 0
        self._failure: NotPlanned | None = None
        self._legs: list[Leg] = []
        self._flown_m: list[float] = []
        self._plans: list[Planned] = []
        self._scans: list[tuple[float, float, float]] = []

    @property
    def is_over(self) -> bool:
        spent = len(self._legs) >= self._most_legs or self._attempt == _MAX_ATTEMPTS
        return not self._left or spent

    def scan(self, truth: KnownMap, scanner: Scanner) -> None:
        range_m = self._task.settings.scan_range_m
        self._scans.append(self._scan_nea_m)
        self._known = self._known.with_scan(scanner(truth, self._scan_nea_m, range_m))

    def request(self, seed: int) -> PlanRequest:
        self._requests += 1
        return PlanRequest(
            plan_id=self._requests,
            seed=seed,
            task=self._task,
            known=self._known,
            scan_nea_m=self._scan_nea_m,
            start=self._pose,
            from_rest=self._from_rest,
            target_ne_m=self._left[0],
            route_ne_m=self._route,
            progress=self._progress,
            rest=None if self._from_rest else self._legs[-1].rest(self._task),
            attempt=self._attempt,
        )

    def take(self, outcome: PlanOutcome) -> None:
        assert not isinstance(outcome, Backtrack)  # it is never asked for
        if isinstance(outcome, NotPlanned):
            self._failure = outcome
            if self._from_rest:
                self._attempt += 1
            else:
                self._hold_at_end()
            return
        self._failure, self._attempt, self._route = None, 0, outcome.route_ne_m
        self._progress = outcome.progress
        if self._legs and not self._from_rest:
            self._flown_m[-1] = self._legs[-1].successor_at_m(self._task)
            if not self._fly(self._flown_m[-1], goes_on=True):
                return
        leg = Leg.of(outcome, len(self._legs) + 1)
        self._plans.append(outcome)
        self._legs.append(leg)
        self._flown_m.append(leg.subpath.length_m)
        self._at_m = 0.0
        if leg.reaches_target:
            if self._fly(leg.subpath.length_m):
                self._left.pop(0)
                self._route, self._progress = (), NO_PROGRESS
                self._stop_at_m(leg.subpath.length_m)
        elif not leg.wants_successor(leg.subpath.length_m, self._task):
            self._hold_at_end()
        elif self._fly(leg.scan_at_m(self._task)):
            self._scan_nea_m = leg.subpath.pose(leg.scan_at_m(self._task)).point_nea_m
            self._pose = leg.subpath.pose(leg.successor_at_m(self._task))
            self._from_rest = False

    def _fly(self, until_m: float, *, goes_on: bool = False) -> bool:
        """Fly on along the leg.  -> whether it came so far; else it has stopped, and holds."""
        leg, from_m = self._legs[-1], self._at_m
        self._at_m = until_m if self._flies is None else self._flies(leg, from_m, until_m, goes_on)
        if self._at_m >= until_m:
            return True
        self._holds += 1
        self._flown_m[-1] = self._at_m
        self._stop_at_m(self._at_m)
        return False

    def _hold_at_end(self) -> None:
        if self._fly(end_m := self._legs[-1].subpath.length_m):
            self._holds += 1
            self._stop_at_m(end_m)

    def _stop_at_m(self, length_m: float) -> None:
        self._scan_nea_m = self._legs[-1].subpath.pose(length_m).point_nea_m
        self._pose, self._from_rest = hover_pose(self._scan_nea_m), True

    def result(self) -> OfflineFlight:
        failure = self._failure
        if self._left and failure is None:
            failure = NotPlanned(plan_id=self._requests, refusal=Refusal.TOO_MANY_LEGS)
        return OfflineFlight(
            legs=tuple(self._legs),
            flown_m=tuple(self._flown_m),
            plans=tuple(self._plans),
            scans_nea_m=tuple(self._scans),
            known=self._known,
            failure=failure,
            holds=self._holds,
        )
