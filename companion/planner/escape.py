"""Escape: the shortest way out of a place where no certificate can begin.

If a threat appears around a hovering or loitering vehicle, or it holds beside a slope, no curve
from there keeps the required clearance.  The escape path is straight, proven not to come nearer to
terrain and zones than the vehicle already is, and clear of all at its end.  For a plane distances
are those of its loiter circle.
"""

import math
from dataclasses import replace
from itertools import islice

import numpy as np

from companion.geodesy import FloatArray
from companion.path.certificate import Certificate, certify
from companion.path.proof import Surroundings
from companion.path.subpath import Subpath, straight
from companion.planner.request import NotPlanned, Planned, PlanRequest, Refusal
from companion.planner.searches import straight_plan
from companion.world.columns import distance_to_terrain_m, distances_to_terrain_m
from companion.world.known_map import KnownMap
from companion.world.zones import Zone, gaps_m, packed

_BEARINGS = 72  # directions of ways, 5 degrees apart: a way out of a circle is 0.1 % too long
_NEAR, _LENGTHS, _LONGER = 0.4, 24, 12
"""Of R, within which all ground is usually seen; lengths of ways up to there, and lengths beyond,
up to where subpaths end: a zone may be as large."""
_STEEP = (0.0, 0.95, -0.95)  # of the climb or dive angle
_CERTIFIED = 200  # ways that are proven, the shortest first: 1 ms each
_DEEPER = 3.0  # metres of way that count as much as one metre deeper into a zone
_SLACK_M = 0.5  # so much nearer than the vehicle is a way may come: a proof needs a little to spare
_WORTH_M = 1.0  # a place that is less deep in a zone by less than this is no better
_TOUCHING_M = 0.5  # nearer to a zone than this counts as inside
_ROUNDING_M = 1e-3  # a subpath may begin where another just keeps its distance
_PROVABLE = 1.002  # of the required clearance: what a proof needs more than the bound itself
_SAMPLES = 64  # points of a way, to find where the terrain is far enough away
_NO_GROUND_M = -1e4  # altitude AMSL of ground that no proof meets: no ground on earth is as low


def escape(request: PlanRequest) -> Planned | NotPlanned | None:
    """A straight way out of where no certificate can begin, or why there is none; None: it can."""
    task, start, around = request.task, request.start.position_nea_m, request.around
    least_m = task.required_clearance_m
    least_m = least_m * _PROVABLE if request.from_rest else least_m - _ROUNDING_M
    now_m = distance_to_terrain_m(around, start, least_m)
    zones = tuple(zone for zone in task.zones if _gaps_m(request, zone) < least_m)
    if now_m >= least_m and not zones:
        return None
    if request.from_rest and (found := _shortest(request, zones, now_m)) is not None:
        return straight_plan(request, *found)
    refusal = Refusal.START_NEAR_TERRAIN
    if zones:
        refusal = Refusal.START_IN_KEEP_OUT
    elif task.settings.is_near:
        refusal = Refusal.START_NEAR_THINGS
    elif distance_to_terrain_m(around, start, least_m, seen_only=True) >= least_m:
        refusal = Refusal.START_NEAR_UNKNOWN
    return NotPlanned(plan_id=request.plan_id, refusal=refusal)


def _shortest(
    request: PlanRequest, zones: tuple[Zone, ...], now_m: float
) -> tuple[Subpath, Certificate] | None:
    """The shortest straight escape path and its certificate; None: there is none.

    zones: that are too near, or around the vehicle; now_m: distance to the known terrain.

    Proven: no nearer to the terrain than the vehicle is now, and with the whole clearance from
    where it first has that; no nearer to a zone that it is clear of than now.  Out of those that
    it is in, a way that first leads deeper is only taken if it is much shorter; and out of one that
    is too large, a way as far towards its edge as can be seen.  The certificate is that about the
    terrain.
    """
    start, known, around = request.start.position_nea_m, request.known, request.around
    required_m = request.task.required_clearance_m
    inside = tuple(zone for zone in zones if _gaps_m(request, zone) < _TOUCHING_M)
    others = tuple(zone for zone in request.task.zones if zone not in inside)
    gap_m = float(_gaps_m(request, *others))
    air = replace(known, upper_m=np.full(known.upper_m.shape, _NO_GROUND_M))
    off_zones = _kept(request, air, others, max(gap_m - _SLACK_M, 0.5 * gap_m))
    clear = _kept(request, known, (), required_m)
    ground = clear if now_m >= required_m else _kept(request, known, (), max(now_m, 1.0) - _SLACK_M)
    ends = _ends_nea_m(request, inside, others)
    least_m = required_m * _PROVABLE
    seen = (end for end in ends if distance_to_terrain_m(around, end, least_m) >= least_m)
    for end in islice(seen, _CERTIFIED):
        whole = straight(start, end)
        if others and not certify(whole, off_zones, from_rest=True).proven:
            continue
        along = start + np.linspace(0.0, 1.0, _SAMPLES + 1)[:, None] * (end - start)
        short = distances_to_terrain_m(around, along, required_m) < required_m
        if short.any():  # the rest is proven at full speed, as it does not begin there at rest
            split = along[min(int(np.flatnonzero(short)[-1]) + 1, _SAMPLES)]
            rest = straight(split, end)
            if not (certify(rest, clear, from_rest=False).proven or rest.length_m <= 1.0):
                continue
        certificate = certify(whole, ground, from_rest=True)
        if certificate.proven:
            return whole, certificate
    return None


def _ends_nea_m(
    request: PlanRequest, inside: tuple[Zone, ...], others: tuple[Zone, ...]
) -> FloatArray:
    """Places all round, within the band, to escape to, the best first.  -> (N, 3).

    Clear of zones, the shortest way first, what leads deeper into one counting more; else clear of
    those that the vehicle is not inside of, and less deep in the others.
    """
    task, start = request.task, request.start.position_nea_m
    near_m, required_m = _NEAR * task.settings.scan_range_m, task.required_clearance_m * _PROVABLE
    steps = np.linspace(near_m / _LENGTHS, near_m, _LENGTHS)
    longer = np.linspace(near_m, max(task.end_radius_m, near_m), _LONGER + 1)[1:]
    level_m, turn = np.append(steps, longer), np.linspace(0.0, math.tau, _BEARINGS, endpoint=False)
    away = level_m[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)[:, None]
    places = start[:2] + away  # (bearings, lengths, 2)
    may_end = _gaps_m(request, *others, at_ne_m=places) >= required_m
    gap_m, now_m = _gaps_m(request, *inside, at_ne_m=places), _gaps_m(request, *inside)
    if (may_end & (gap_m >= required_m)).any():
        may_end &= gap_m >= required_m
        rank_m = np.broadcast_to(level_m, gap_m.shape)
        for zone in inside:
            least_m = np.minimum.accumulate(_gaps_m(request, zone, at_ne_m=places), axis=1)
            rank_m = rank_m + _DEEPER * np.maximum(_gaps_m(request, zone) - least_m, 0.0)
    else:
        may_end &= gap_m > now_m + _WORTH_M
        rank_m = -gap_m
    climb, dive = task.limits.climb_angle_rad, task.limits.dive_angle_rad
    steep = np.tan([share * (climb if share > 0.0 else dive) for share in _STEEP])
    up_m = start[2] + level_m[:, None] * steep
    low, high = task.band_amsl_m
    which = np.nonzero(may_end[..., None] & (up_m >= low) & (up_m <= high))
    bearing, length, slope = which
    rank = rank_m[bearing, length] + level_m[length] * (np.hypot(1.0, steep[slope]) - 1.0)
    ends = np.column_stack([places[bearing, length], up_m[length, slope]])
    return np.asarray(ends[np.argsort(np.round(rank, 6), kind="stable")])


def _kept(
    request: PlanRequest, known: KnownMap, zones: tuple[Zone, ...], keep_m: float
) -> Surroundings:
    """What a way is to keep a distance from, the required one at most."""
    task = request.task
    keep_m = min(keep_m, task.required_clearance_m)
    return task.surroundings(
        known,
        request.start.point_nea_m[:2],
        task.settings.scan_range_m,
        clearance_m=keep_m,
        contact_m=min(task.envelope.contact_m, keep_m),
        zones=zones,
    )


def _gaps_m(request: PlanRequest, *zones: Zone, at_ne_m: FloatArray | None = None) -> FloatArray:
    """Distance of points, or of the vehicle, or of the circle about it, to the nearest of zones.

    (..., 2) -> (...).
    """
    at_ne_m = request.start.position_nea_m[:2] if at_ne_m is None else at_ne_m
    gaps = gaps_m(packed(zones), at_ne_m[..., 0], at_ne_m[..., 1])
    return np.asarray(gaps - request.task.limits.loiter_radius_m)
