"""One plan: the next subpath from the known map at p_scan, or a refusal with its reason.

Guidance, search, proof: the best candidate that is proven safe is taken (verify, then commit).  It
is weighed against a way out in a straight line, if the vehicle is at rest, and against a stop.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
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
from companion.planner.request import NotPlanned, Planned, PlanOutcome, PlanRequest, Refusal, Rest
from companion.planner.searches import Searches
from companion.planner.way_out import blocked_at, escape, way_out
from companion.world.columns import distance_to_terrain_m, sees_anything

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
    if (refusal := _impossible(request)) is not None:
        return NotPlanned(plan_id=request.plan_id, refusal=refusal)
    if (escaped := escape(request)) is not None:
        return escaped
    if (refusal := _unreachable(request)) is not None:
        return NotPlanned(plan_id=request.plan_id, refusal=refusal)
    searches = Searches(request, stop)
    outcome = _best_proven(request, request.progress, searches)
    return replace(
        outcome,
        evaluations=searches.evaluations,
        tries=searches.tries,
        stopped_after=searches.stopped_after,
    )


def _impossible(request: PlanRequest) -> Refusal | None:
    """Why the request itself, or its start, is invalid; None if it is not."""
    task, limits, (low, high) = request.task, request.task.limits, request.task.band_amsl_m
    numbers = *request.scan_nea_m, *request.target_ne_m, *rows_of(request.start).ravel()
    if not np.isfinite(numbers).all() or low >= high:
        return Refusal.NO_QUESTION
    bounds = limits.north_m, limits.east_m, limits.inner_band_amsl_m(task.error_m)
    start = zip(request.start.point_nea_m, bounds, strict=True)
    if not all(least <= at <= most for at, (least, most) in start):
        return Refusal.START_OUTSIDE
    if not sees_anything(request.known, request.scan_nea_m[:2], task.settings.scan_range_m):
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


def _best_proven(
    request: PlanRequest, before: Progress, searches: Searches
) -> Planned | NotPlanned:
    """The best subpath that is proven, or why there is none; before: as of the last plan."""
    task, rest, here_nea_m = request.task, request.rest, request.start.point_nea_m
    is_near = task.settings.is_near
    guidance = _guidance(request, before)
    prices, progress, allowed_m = guidance.prices, guidance.progress, guidance.allowed_m
    searches.guided_by(prices)

    def refused(refusal: Refusal, place_ne_m: Place | None = None) -> NotPlanned:
        broken = () if refusal is Refusal.BETTER_TO_STOP else searches.broken
        return NotPlanned(
            plan_id=request.plan_id, refusal=refusal, broken=broken, place_ne_m=place_ne_m
        )

    if not is_near:  # where a near thing stands is told too widely
        ends_ne_m = here_nea_m[:2], request.target_ne_m
        closed = blocked_at(request.known, task, prices.field, ends_ne_m)
        if closed is not None:
            return refused(Refusal.NO_WAY, closed)
    best = searches.best()
    # standing, against a straight piece
    if request.from_rest and (best is None or guidance.goes_round(best)):
        owes = progress.owed_m > allowed_m
        out = way_out(request, prices, searches.straight, looks=best is None, strays=not owes)
        if out is None and owes and prices.field.is_barred and not is_near:
            return refused(Refusal.NO_WAY, prices.field.route_ne_m[0])
        price_m = math.inf if best is None else prices.price_m(best)
        if out is not None and out[1] <= price_m + (progress.owed_m if owes else 0.0):
            best, price_m = out[0], out[1] - task.stop_m
        promised_m = prices.promised_m(here_nea_m)
        believes = not is_near and progress.believed_below_m == math.inf
        if price_m - promised_m > allowed_m and believes and not searches.is_cut:
            # guesses promise what cannot be flown
            disbelieving = progress.disbelieving(promised_m, request.known.cell_m)
            return _best_proven(request, disbelieving, searches)
    if best is None:
        return refused(Refusal.OUT_OF_TIME if searches.is_cut else Refusal.NOTHING_SAFE)
    # in flight, against a stop
    if rest is not None and (guidance.goes_round(best) or _is_better_to_stop(rest, best, searches)):
        return refused(Refusal.BETTER_TO_STOP)
    owed_m = guidance.owed_m(best)
    most_m = max(_MOST_OWED * task.settings.scan_range_m, allowed_m, progress.owed_m)
    if request.from_rest and owed_m > most_m and not (is_near or best.reaches_target):
        return refused(Refusal.NO_WAY_PROVEN)
    return replace(best, progress=progress.after(owed_m, prices.after_m(best)))


def _is_better_to_stop(rest: Rest, best: Planned, searches: Searches) -> bool:
    """Whether it costs less to stop at the end of the current leg and continue from there.

    That plan uses the same map and end circle, and may leave in any direction.
    """
    prices = searches.prices
    stop_m, price_m = rest.length_m + prices.task.stop_m, prices.price_m(best)
    if price_m <= stop_m + prices.promised_m(rest.end_nea_m):
        return False
    leaving = searches.leaving(hover_pose(rest.end_nea_m))
    return leaving is not None and prices.price_m(leaving) + stop_m < price_m


# --- guidance


@final
@dataclass(frozen=True, slots=True)
class _Guidance:
    """What the way to the target costs, and whether the mission gets on."""

    prices: Prices
    progress: Progress

    @property
    def allowed_m(self) -> float:
        """What may be owed."""
        task = self.prices.task
        share = _OWED_NEAR if task.settings.is_near else _OWED
        return max(task.stop_m, share * task.settings.scan_range_m)

    def owed_m(self, planned: Planned) -> float:
        """What the mission owes with this subpath; a straight piece only if more is left then."""
        prices, task = self.prices, self.prices.task
        if not planned.is_escape:
            return self.progress.owing(prices.excess_m(planned), task.settings.scan_range_m)
        here_nea_m, end_nea_m = planned.subpath.control_nea_m[[0, -1]].tolist()
        more_m = prices.promised_m(end_nea_m) - prices.promised_m(here_nea_m)
        return self.progress.owed_m + max(more_m, 0.0) + (task.stop_m if more_m > 0.0 else 0.0)

    def goes_round(self, planned: Planned) -> bool:
        """Whether the mission would owe more than a stop costs."""
        return not planned.reaches_target and self.owed_m(planned) > self.allowed_m


def _guidance(request: PlanRequest, before: Progress) -> _Guidance:
    """Ask guidance for the way, without guesses where they were found wrong."""
    task, known, range_m = request.task, request.known, request.task.settings.scan_range_m
    few_cells = _FEW * math.pi * (range_m / known.cell_m) ** 2
    seen = int(np.count_nonzero(known.seen))

    def prices_by(belief: Belief) -> Prices:
        scan_ne_m = request.scan_nea_m[:2]
        field = cost_to_go(request.around, task, scan_ne_m, request.target_ne_m, belief=belief)
        return Prices(task, field)

    prices = prices_by(Belief.GUESSED)
    left_m = prices.promised_m(request.start.point_nea_m)
    if left_m < before.believed_below_m:
        if before.believed_below_m < math.inf:
            before = Progress(seen=before.seen)
        before = before.at(left_m, known.cell_m, seen=seen, few=few_cells)
        if before.doubt_m <= BELIEVED * range_m:
            return _Guidance(prices, before)
        before = before.disbelieving(left_m, known.cell_m)
    prices = prices_by(Belief.BOUNDED)
    if prices.field.is_barred:  # perhaps by what is hidden only: it is looked at
        prices = prices_by(Belief.FREE)
    left_m = prices.promised_m(request.start.point_nea_m)
    return _Guidance(prices, before.at(left_m, known.cell_m, seen=seen, few=few_cells))
