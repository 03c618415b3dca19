"""The online procedure without a vehicle: simulated scans and perfect tracking."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
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
@dataclass(slots=True, kw_only=True, eq=False)
class OfflineFlight:
    """A flight, or as much of it as was flown."""

    next: PlanRequest
    """The next request: where the vehicle is, what it knows by now, what it heads for."""
    left_ne_m: list[tuple[float, float]]
    """Targets that it has not reached."""
    legs: list[Leg] = field(default_factory=list)
    flown_m: list[float] = field(default_factory=list)
    """How far each leg was flown before the next took over."""
    plans: list[Planned] = field(default_factory=list)
    scans_nea_m: list[tuple[float, float, float]] = field(default_factory=list)
    """Where it scanned: the start is the first."""
    failure: NotPlanned | None = None
    """Why it ended before the target; None: it did not."""
    holds: int = 0
    """How often it had to stop at the end of a leg, for want of a successor."""
    flies: Flies = lambda _leg, _from_m, until_m, _goes_on: until_m
    """What looks about on the way."""
    _at_m: float = 0.0
    """How far the current leg is flown."""

    def route_nea_m(self, spacing_m: float) -> FloatArray:
        """What was flown, points so far apart or less.  -> (S, 3)."""
        pieces = [np.array([self.scans_nea_m[0]])]
        for leg, flown_m in zip(self.legs, self.flown_m, strict=True):
            count = max(math.ceil(flown_m / spacing_m), 1)
            pieces.append(leg.subpath.points_nea_m(np.linspace(0.0, flown_m, count + 1)[1:]))
        return np.concatenate(pieces)

    @property
    def known(self) -> KnownMap:
        """What its scans have shown."""
        return self.next.known

    def scan(self, truth: KnownMap, scanner: Scanner) -> None:
        """Scan from where the next request says."""
        request = self.next
        self.scans_nea_m.append(request.scan_nea_m)
        scan = scanner(truth, request.scan_nea_m, request.task.settings.scan_range_m)
        self.next = replace(
            request, plan_id=request.plan_id + 1, known=request.known.with_scan(scan)
        )

    def take(self, outcome: PlanOutcome) -> None:
        """Fly on with an answer, to where the next scan is made."""
        assert not isinstance(outcome, Backtrack)  # it is never asked for
        request, task = self.next, self.next.task
        if isinstance(outcome, NotPlanned):
            self.failure = outcome
            if request.from_rest:
                self.next = replace(request, attempt=request.attempt + 1)
            else:
                self._hold_at_end()
            return
        self.failure = None
        self.next = replace(
            request, attempt=0, route_ne_m=outcome.route_ne_m, progress=outcome.progress
        )
        if not request.from_rest:
            self.flown_m[-1] = self.legs[-1].successor_at_m(task)
            if not self._fly(self.flown_m[-1], goes_on=True):
                return
        leg = Leg.of(outcome, len(self.legs) + 1)
        self.plans.append(outcome)
        self.legs.append(leg)
        self.flown_m.append(leg.subpath.length_m)
        self._at_m = 0.0
        if leg.reaches_target:
            if self._fly(leg.subpath.length_m):
                self.left_ne_m.pop(0)
                self._stop()
                target = self.left_ne_m[0] if self.left_ne_m else request.target_ne_m
                self.next = replace(
                    self.next, target_ne_m=target, route_ne_m=(), progress=NO_PROGRESS
                )
        elif not leg.wants_successor(leg.subpath.length_m, task):
            self._hold_at_end()
        elif self._fly(leg.scan_at_m(task)):
            self.next = replace(
                self.next,
                scan_nea_m=leg.subpath.pose(leg.scan_at_m(task)).point_nea_m,
                start=leg.subpath.pose(leg.successor_at_m(task)),
                from_rest=False,
                rest=leg.rest(task),
            )

    def _fly(self, until_m: float, *, goes_on: bool = False) -> bool:
        """Fly on along the leg.  -> whether it came so far; else it has stopped, and holds."""
        self._at_m = self.flies(self.legs[-1], self._at_m, until_m, goes_on)
        if self._at_m >= until_m:
            return True
        self.holds += 1
        self.flown_m[-1] = self._at_m
        self._stop()
        return False

    def _hold_at_end(self) -> None:
        if self._fly(self.legs[-1].subpath.length_m):
            self.holds += 1
            self._stop()

    def _stop(self) -> None:
        """It stands where it is."""
        here = self.legs[-1].subpath.pose(self._at_m).point_nea_m
        self.next = replace(
            self.next, scan_nea_m=here, start=hover_pose(here), from_rest=True, rest=None
        )


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
    request = PlanRequest(
        plan_id=0,
        seed=seed,
        task=task,
        known=blank,
        scan_nea_m=start_nea_m,
        start=hover_pose(start_nea_m),
        from_rest=True,
        target_ne_m=targets_ne_m[0],
    )
    flight = OfflineFlight(next=request, left_ne_m=list(targets_ne_m))
    flight.flies = flies or flight.flies
    most_legs = most_legs or usual_most_legs(task, start_nea_m, targets_ne_m)
    while flight.left_ne_m and flight.next.attempt < _MAX_ATTEMPTS:
        if len(flight.legs) >= most_legs:
            flight.failure = flight.failure or NotPlanned(
                plan_id=flight.next.plan_id, refusal=Refusal.TOO_MANY_LEGS
            )
            break
        flight.scan(truth, scanner)
        flight.take(planner(flight.next))
    return flight


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
