"""One plan: the next subpath from the known map at p_scan, or a refusal with its reason.

Guidance, search, proof: the best candidate that is proven safe is taken (verify, then commit).  It
is weighed against a way out in a straight line, if the vehicle is at rest, and against a stop.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import final

import numpy as np

from companion.objective import rows_of
from companion.planner import rules
from companion.planner.backtrack import backtrack
from companion.planner.cost_grid import Belief, Place
from companion.planner.field import cost_to_go
from companion.planner.price import Prices
from companion.planner.procedure import hover_pose
from companion.planner.progress import BELIEVED, Progress
from companion.planner.request import NotPlanned, Planned, PlanOutcome, PlanRequest, Refusal
from companion.planner.searches import Searches
from companion.planner.way_out import blocked_at, escape, way_out
from companion.world.columns import distance_to_terrain_m, sees_anything

_MUCH_DEARER = 0.5  # of the cost of R: then it is planned more slowly, too
_OWED, _OWED_NEAR = 1.0, 0.25
"""Of R: what may be owed (`planner.progress`), if a stop costs no more; the second near things.

Chosen on 13 worlds of 20261128 (`walls`, `gathered`, `copter`: mean J 56.7, 51.1 and 52.1 with
0.25, 1 and 2), and on forests (218 and 240 s with 0.25 and 1 for seed 3001)."""
_MOST_OWED = 2.0 * math.pi
"""Of R: a way all round what is in sight.  Who owes more, standing, has found no way on there."""
_FEW = 0.005  # of the cells in sight: when a scan shows no more than that, nothing new was seen


def plan(request: PlanRequest, stop: Callable[[], bool] = lambda: False) -> PlanOutcome:
    """Search for the next subpath until one is proven safe.

    Or the way back, if that is asked for.
    stop: asked every few hundred evaluations; in real time it tells that time is up, and then the
    best so far is taken, if it can be proven.
    """
    if request.flown is not None:
        return backtrack(request.flown, request.task, request.known, request.plan_id)
    if (refusal := _impossible(request)) is None:
        if (escaped := escape(request)) is not None:
            if isinstance(escaped, Planned):  # who was in debt still is
                return replace(escaped, progress=request.progress)
            return escaped
        refusal = _unreachable(request)
    if refusal is not None:
        return NotPlanned(plan_id=request.plan_id, refusal=refusal)
    searches = Searches(request, stop)
    outcome = _Plan(request, searches).outcome()
    return replace(outcome, stopped_after=searches.stopped_after)


def _impossible(request: PlanRequest) -> Refusal | None:
    """Why the request itself, or its start, is invalid; None if it is not."""
    task, limits, settings = request.task, request.task.limits, request.task.settings
    (low, high), range_m = task.band_amsl_m, settings.scan_range_m
    numbers = *request.scan_nea_m, *request.target_ne_m, *rows_of(request.start).ravel()
    positive = (
        *(high - low, settings.safety_distance_m, range_m, limits.turn_radius_m),
        *(limits.speed_m_s, limits.acceleration_m_s2),
        *(limits.climb_angle_rad, limits.dive_angle_rad),
    )
    if not (np.isfinite((*numbers, *positive)).all() and min(positive) > 0.0):
        return Refusal.NO_QUESTION
    if 2.0 * limits.turn_radius_m > range_m:
        return Refusal.NO_ROOM_TO_TURN
    bounds = limits.north_m, limits.east_m, limits.inner_band_amsl_m(task.error_m)
    start = zip(request.start.point_nea_m, bounds, strict=True)
    if not all(least <= at <= most for at, (least, most) in start):
        return Refusal.START_OUTSIDE
    if not sees_anything(request.known, request.scan_nea_m[:2], range_m):
        return Refusal.NOTHING_SEEN
    return None


def _unreachable(request: PlanRequest) -> Refusal | None:
    """Why the target is invalid; None if it is not."""
    task, target = request.task, "target"
    for broken, *_ in rules.of_target(task, request.target_ne_m, target):
        return Refusal.TARGET_IN_KEEP_OUT if broken == target else Refusal.TARGET_AT_EDGE
    highest = np.array([*request.target_ne_m, task.band_amsl_m[1]])
    required_m = task.required_clearance_m
    if distance_to_terrain_m(request.around, highest, required_m, seen_only=True) < required_m:
        return Refusal.TARGET_IN_TERRAIN
    return None


@final
class _Plan:
    """One plan in progress."""

    def __init__(self, request: PlanRequest, searches: Searches) -> None:
        self._request, self._searches, self._settings = request, searches, request.task.settings
        self._range_m, is_near = self._settings.scan_range_m, self._settings.is_near
        self._allowed_m = (_OWED_NEAR if is_near else _OWED) * self._range_m  # what may be owed
        self._allowed_m = max(request.task.stop_m, self._allowed_m)
        self._guide(request.progress)

    # --- guidance

    def _guide(self, before: Progress) -> None:
        """Ask guidance for the way, without guesses where they were found wrong."""
        left_m = self._left_m(Belief.GUESSED)
        believes = left_m < before.believed_below_m
        if believes:
            if before.believed_below_m < math.inf:
                before = Progress(seen=before.seen)
            before = self._at(before, left_m)
            believes = before.doubt_m <= BELIEVED * self._range_m
            if not believes:
                before = before.disbelieving(left_m, self._request.known.cell_m)
        if not believes:
            left_m = self._left_m(Belief.BOUNDED)
            if self._prices.field.is_barred:  # perhaps by what is hidden only: it is looked at
                left_m = self._left_m(Belief.FREE)
            before = self._at(before, left_m)
        self._progress = before
        self._searches.guided_by(self._prices)

    def _left_m(self, belief: Belief) -> float:
        """Of the way to the target, by guidance."""
        request, scan_ne_m = self._request, self._request.scan_nea_m[:2]
        field = cost_to_go(
            request.around, request.task, scan_ne_m, request.target_ne_m, belief=belief
        )
        self._prices = Prices(request.task, field)
        return self._prices.promised_m(request.start.point_nea_m)

    def _at(self, before: Progress, left_m: float) -> Progress:
        """Whether the mission gets on, from where so much is left."""
        known = self._request.known
        few_cells = _FEW * math.pi * (self._range_m / known.cell_m) ** 2
        seen = int(np.count_nonzero(known.seen))
        return before.at(left_m, known.cell_m, seen=seen, few=few_cells)

    # --- what is flown

    def outcome(self) -> Planned | NotPlanned:
        """The best subpath that is proven, or why there is none."""
        request, searches, is_near = self._request, self._searches, self._settings.is_near
        field, here_nea_m = self._prices.field, request.start.point_nea_m
        if not is_near:  # where a near thing stands is told too widely
            ends_ne_m = here_nea_m[:2], request.target_ne_m
            closed = blocked_at(request.known, request.task, field, ends_ne_m)
            if closed is not None:
                return self._refused(Refusal.NO_WAY, closed)
        best = self._searched()
        if request.from_rest and (best is None or self._goes_round(best)):
            owes = self._progress.owed_m > self._allowed_m
            out = way_out(
                request, self._prices, searches.straight, looks=best is None, strays=not owes
            )
            if out is None and owes and field.is_barred and not is_near:
                return self._refused(Refusal.NO_WAY, field.route_ne_m[0])
            price_m = math.inf if best is None else self._prices.price_m(best)
            if out is not None and out[1] <= price_m + (self._progress.owed_m if owes else 0.0):
                best, price_m = out[0], out[1] - request.task.stop_m
            dearer_m = price_m - self._prices.promised_m(here_nea_m)
            believes = not is_near and self._progress.believed_below_m == math.inf
            if dearer_m > self._allowed_m and believes and not searches.is_cut:
                left_m = self._prices.promised_m(here_nea_m)  # guesses promise what cannot be flown
                self._guide(self._progress.disbelieving(left_m, request.known.cell_m))
                return self.outcome()
        if best is None:
            return self._refused(Refusal.OUT_OF_TIME if searches.is_cut else Refusal.NOTHING_SAFE)
        if request.rest is not None and (self._goes_round(best) or self._is_better_to_stop(best)):
            return self._refused(Refusal.BETTER_TO_STOP)
        owed_m = self._owed_m(best)
        most_m = max(_MOST_OWED * self._range_m, self._allowed_m, self._progress.owed_m)
        if request.from_rest and owed_m > most_m and not (is_near or best.reaches_target):
            return self._refused(Refusal.NO_WAY_PROVEN)
        progress = self._progress.after(owed_m, self._prices.after_m(best))
        evaluations, tries = searches.evaluations, searches.tries
        return replace(best, evaluations=evaluations, tries=tries, progress=progress)

    def _searched(self) -> Planned | None:
        """The best of all speeds; slower ones count where nothing, or only a long way, is found."""
        best: Planned | None = None
        enough_m = math.inf  # from rest among near things a slow leg may beat a long way round
        if self._settings.is_near and self._request.from_rest:
            enough_m = _MUCH_DEARER * self._range_m
        for speed_m_s in self._searches.speeds_m_s:
            if best is None or self._prices.excess_m(best) > enough_m:
                best = self._prices.cheaper(best, self._searches.at_speed(speed_m_s))
        return best

    def _owed_m(self, planned: Planned) -> float:
        """What the mission owes with this subpath; a straight piece only if more is left then."""
        if not planned.is_escape:
            return self._progress.owing(self._prices.excess_m(planned), self._range_m)
        here_nea_m, end_nea_m = planned.subpath.control_nea_m[[0, -1]].tolist()
        more_m = self._prices.promised_m(end_nea_m) - self._prices.promised_m(here_nea_m)
        stop_m = self._request.task.stop_m if more_m > 0.0 else 0.0
        return self._progress.owed_m + max(more_m, 0.0) + stop_m

    def _goes_round(self, planned: Planned) -> bool:
        """Whether the mission would owe more than a stop costs."""
        return not planned.reaches_target and self._owed_m(planned) > self._allowed_m

    def _is_better_to_stop(self, best: Planned) -> bool:
        """Whether it costs less to stop at the end of the current leg and continue from there.

        That plan uses the same map and end circle, and may leave in any direction.
        """
        if (rest := self._request.rest) is None:
            return False
        stop_m, price_m = rest.length_m + self._request.task.stop_m, self._prices.price_m(best)
        if price_m <= stop_m + self._prices.promised_m(rest.end_nea_m):
            return False
        leaving = self._searches.leaving(hover_pose(rest.end_nea_m))
        return leaving is not None and self._prices.price_m(leaving) + stop_m < price_m

    def _refused(self, refusal: Refusal, place_ne_m: Place | None = None) -> NotPlanned:
        searches = self._searches
        return NotPlanned(
            plan_id=self._request.plan_id,
            refusal=refusal,
            broken=() if refusal is Refusal.BETTER_TO_STOP else searches.broken,
            evaluations=searches.evaluations,
            tries=searches.tries,
            place_ne_m=place_ne_m,
        )
