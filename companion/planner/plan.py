"""One plan: the next subpath from the known map at p_scan, or a refusal with its reason.

Guidance, search, proof: the best candidate that is proven safe is taken (verify, then commit).  It
is weighed against a way out in a straight line, if the vehicle is at rest, and against a stop.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from companion.objective import rows_of
from companion.planner import rules
from companion.planner.backtrack import backtrack
from companion.planner.cost_grid import Belief
from companion.planner.field import cost_to_go
from companion.planner.price import Prices
from companion.planner.progress import BELIEVED, Progress
from companion.planner.request import NotPlanned, Planned, PlanOutcome, PlanRequest, Refusal
from companion.planner.searches import Searches
from companion.planner.way_out import blocked_at, escape, way_out
from companion.world.columns import distance_to_terrain_m, sees_anything

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
    answer = _impossible(request) or escape(request) or _unreachable(request)
    if answer is not None:
        return answer
    searches = Searches(request, stop)
    return replace(
        _best_proven(request, request.progress, searches),
        evaluations=searches.evaluations,
        tries=searches.tries,
        stopped_after=searches.stopped_after,
    )


def _impossible(request: PlanRequest) -> NotPlanned | None:
    """Why the request itself, or its start, is invalid; None if it is not."""
    task, limits, (low, high) = request.task, request.task.limits, request.task.band_amsl_m
    numbers = *request.scan_nea_m, *request.target_ne_m, *rows_of(request.start).ravel()
    if not np.isfinite(numbers).all() or low >= high:
        return request.refused(Refusal.NO_QUESTION)
    bounds = limits.north_m, limits.east_m, limits.inner_band_amsl_m(task.error_m)
    start = zip(request.start.point_nea_m, bounds, strict=True)
    if not all(least <= at <= most for at, (least, most) in start):
        return request.refused(Refusal.START_OUTSIDE)
    if not sees_anything(request.known, request.scan_nea_m[:2], task.settings.scan_range_m):
        return request.refused(Refusal.NOTHING_SEEN)
    return None


def _unreachable(request: PlanRequest) -> NotPlanned | None:
    """Why the target is invalid; None if it is not."""
    task, target = request.task, "target"
    for broken, *_ in rules.of_target(task, request.target_ne_m, target):
        in_zone = broken == target
        return request.refused(Refusal.TARGET_IN_KEEP_OUT if in_zone else Refusal.TARGET_AT_EDGE)
    highest = np.array([*request.target_ne_m, task.band_amsl_m[1]])
    required_m = task.required_clearance_m
    if distance_to_terrain_m(request.around, highest, required_m, seen_only=True) < required_m:
        return request.refused(Refusal.TARGET_IN_TERRAIN)
    return None


def _best_proven(
    request: PlanRequest, before: Progress, searches: Searches
) -> Planned | NotPlanned:
    """The best subpath that is proven, or why there is none; before: as of the last plan."""
    task, here_nea_m = request.task, request.start.point_nea_m
    is_near = task.settings.is_near
    prices = _guidance(request, before)
    field, progress, allowed_m = prices.field, prices.progress, prices.allowed_m
    if not is_near:  # where a near thing stands is told too widely
        ends_ne_m = here_nea_m[:2], request.target_ne_m
        closed = blocked_at(request.known, task, field, ends_ne_m)
        if closed is not None:
            return request.refused(Refusal.NO_WAY, place_ne_m=closed)
    best = searches.best(prices)
    # standing, against a straight piece
    if request.from_rest and (best is None or prices.goes_round(best)):
        owes = progress.owed_m > allowed_m
        out = way_out(request, searches, looks=best is None, strays=not owes)
        if out is None and owes and field.is_barred and not is_near:
            return request.refused(Refusal.NO_WAY, searches.broken, field.route_ne_m[0])
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
        why = Refusal.OUT_OF_TIME if searches.is_cut else Refusal.NOTHING_SAFE
        return request.refused(why, searches.broken)
    # in flight, against a stop
    rest = request.rest
    if rest is not None and (prices.goes_round(best) or searches.stops_for_less(best, rest)):
        turns = is_near and prices.leads_away(here_nea_m, rest.end_nea_m)
        return request.refused(Refusal.BETTER_TO_TURN if turns else Refusal.BETTER_TO_STOP)
    most_m = max(_MOST_OWED * task.settings.scan_range_m, allowed_m, progress.owed_m)
    owes_much = prices.owed_m(best) > most_m and not (is_near or best.reaches_target)
    if request.from_rest and owes_much:
        return request.refused(Refusal.NO_WAY_PROVEN, searches.broken)
    return prices.with_progress(best)


def _guidance(request: PlanRequest, before: Progress) -> Prices:
    """What the way to the target costs, without guesses where they were found wrong."""
    task, known, range_m = request.task, request.known, request.task.settings.scan_range_m
    few_cells = _FEW * math.pi * (range_m / known.cell_m) ** 2
    seen = int(np.count_nonzero(known.seen))

    def prices_by(belief: Belief) -> tuple[Prices, float]:
        """The prices, and what is left to fly by them."""
        scan_ne_m = request.scan_nea_m[:2]
        field = cost_to_go(request.around, task, scan_ne_m, request.target_ne_m, belief=belief)
        prices = Prices(task, field)
        return prices, prices.promised_m(request.start.point_nea_m)

    prices, left_m = prices_by(Belief.GUESSED)
    if left_m < before.believed_below_m:
        if before.believed_below_m < math.inf:
            before = Progress(seen=before.seen)
        before = before.at(left_m, known.cell_m, seen=seen, few=few_cells)
        if before.doubt_m <= BELIEVED * range_m:
            return replace(prices, progress=before)
        before = before.disbelieving(left_m, known.cell_m)
    prices, left_m = prices_by(Belief.BOUNDED)
    if prices.field.is_barred:  # perhaps by what is hidden only: it is looked at
        prices, left_m = prices_by(Belief.FREE)
    before = before.at(left_m, known.cell_m, seen=seen, few=few_cells)
    return replace(prices, progress=before)
