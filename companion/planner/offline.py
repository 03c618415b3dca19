"""The online procedure without a vehicle: simulated scans and perfect tracking."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import final

from companion.planner.plan import plan
from companion.planner.procedure import Leg, hover_pose
from companion.planner.request import NotPlanned, Planned, PlanOutcome, PlanRequest, WayBack
from companion.planner.settings import Task
from companion.world.known_map import KnownMap
from companion.world.simulated_scan import simulated_scan

_MOST_LEGS = 60
_MOST_ATTEMPTS = 4  # from one place, each with a wider search


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
    """Why it ended before the target."""
    holds: int
    """How often it had to stop at the end of a leg, for want of a successor."""


def fly_offline(
    task: Task,
    *,
    blank: KnownMap,
    truth: KnownMap,
    start_nea_m: tuple[float, float, float],
    targets_ne_m: tuple[tuple[float, float], ...],
    seed: int,
    planner: Callable[[PlanRequest], PlanOutcome] = plan,
) -> OfflineFlight:
    """Scan, plan, go on to p_prog, until the last target is reached or nothing can be planned.

    As in flight: at a target that is not the last the vehicle stops and begins again, and a leg
    that has no successor is flown to its end, where the vehicle stops, looks and plans anew.
    """
    flight = _Flight(task, blank, start_nea_m, targets_ne_m)
    while not flight.is_over:
        flight.scan(truth)
        flight.take(planner(flight.request(seed)))
    return flight.result()


@final
class _Flight:
    """An offline flight under way."""

    def __init__(
        self,
        task: Task,
        blank: KnownMap,
        start_nea_m: tuple[float, float, float],
        targets_ne_m: tuple[tuple[float, float], ...],
    ) -> None:
        self._task, self._known, self._left = task, blank, list(targets_ne_m)
        self._pose, self._scan_nea_m, self._from_rest = hover_pose(start_nea_m), start_nea_m, True
        self._route: tuple[tuple[float, float], ...] = ()
        self._attempt = self._holds = self._stops = self._requests = 0
        self._failure: NotPlanned | None = None
        self._legs: list[Leg] = []
        self._flown_m: list[float] = []
        self._plans: list[Planned] = []
        self._scans: list[tuple[float, float, float]] = []

    @property
    def is_over(self) -> bool:
        return not self._left or len(self._legs) == _MOST_LEGS or self._attempt == _MOST_ATTEMPTS

    def scan(self, truth: KnownMap) -> None:
        range_m = self._task.settings.scan_range_m
        self._scans.append(self._scan_nea_m)
        self._known = self._known.with_scan(simulated_scan(truth, self._scan_nea_m, range_m))

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
            stops=self._stops,
            overrun=self._plans[-1].overrun if self._plans else 0.0,
            attempt=self._attempt,
        )

    def take(self, outcome: PlanOutcome) -> None:
        assert not isinstance(outcome, WayBack)  # it is never asked for
        if isinstance(outcome, NotPlanned):
            self._failure = outcome
            if self._from_rest:
                self._attempt += 1
            else:
                self._hold_at_end()
            return
        self._failure, self._attempt, self._route = None, 0, outcome.route_ne_m
        if self._legs and not self._from_rest:
            self._flown_m[-1] = self._legs[-1].successor_at_m(self._task)
        leg = Leg.of(outcome, len(self._legs) + 1)
        self._plans.append(outcome)
        self._legs.append(leg)
        self._flown_m.append(leg.subpath.length_m)
        if leg.reaches_target:
            self._left.pop(0)
            self._stops = 0
            self._route = ()
            self._stop_at_end()
        elif not leg.can_be_left(self._task):
            self._hold_at_end()
        else:
            self._scan_nea_m = leg.subpath.pose(leg.scan_at_m(self._task)).point_nea_m
            self._pose = leg.subpath.pose(leg.successor_at_m(self._task))
            self._from_rest = False

    def _hold_at_end(self) -> None:
        self._holds += 1
        self._stops += 1
        self._stop_at_end()

    def _stop_at_end(self) -> None:
        end = self._legs[-1].subpath
        self._scan_nea_m = end.pose(end.length_m).point_nea_m
        self._pose, self._from_rest = hover_pose(self._scan_nea_m), True

    def result(self) -> OfflineFlight:
        return OfflineFlight(
            legs=tuple(self._legs),
            flown_m=tuple(self._flown_m),
            plans=tuple(self._plans),
            scans_nea_m=tuple(self._scans),
            known=self._known,
            failure=self._failure,
            holds=self._holds,
        )
