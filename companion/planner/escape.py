"""Escape: the shortest way out of a place where no certificate can begin.

If a threat appears around a hovering or loitering vehicle, or it holds beside a slope, no curve
from there keeps the required clearance.  The escape path is straight, proven not to come nearer to
the terrain than the vehicle already is, clear of every other threat, and clear of all at its end.
For a plane distances are those of its loiter circle.
"""

import math
from dataclasses import dataclass, replace
from itertools import islice
from typing import final

import numpy as np

from companion.geodesy import FloatArray
from companion.path.certificate import Certificate, Prover, certify, pack_surroundings
from companion.path.proof import Surroundings
from companion.path.subpath import Subpath, straight
from companion.planner.request import PlanRequest
from companion.world.columns import distance_to_terrain_m, distances_to_terrain_m
from companion.world.known_map import KnownMap
from companion.world.zones import Zone, gaps_m, packed

_BEARINGS = 72
"""Directions of ways: 5 degrees apart, which lengthens a way out of a circle by 0.1 %."""
_LENGTHS, _FARTHEST = 24, 0.4
"""Lengths of ways, and the longest as a share of R: within it all ground is usually seen."""
_LONGER = 12
"""Lengths beyond, up to where subpaths end: only out of zones, which may be as large."""
_CERTIFIED = 200
"""Ways that are proven, the shortest first: 1 ms each."""
_RANKED, _STEPS = 600, 16
"""Of the shortest ways out of zones, and points of each at which its depth is taken."""
_DEEPER = 3.0
"""Metres of way that count as much as one metre deeper into a zone."""
_SLACK_M = 0.5
"""How much nearer than the vehicle is a way may come: a proof needs a little to spare."""
_WORTH_M = 1.0
"""A place that is less deep in a zone by less than this is no better."""
_TOUCHING_M = 0.5
"""Nearer to a zone than this counts as inside."""
_ROUNDING_M = 1e-3
"""A subpath may begin where another just keeps its distance."""
_PROVABLE = 1.002
"""Of the required clearance: what a proof needs more than the bound itself."""
_SAMPLES = 64
"""Points of a way at which its distance to the terrain is taken, to split it for the proof."""
_NO_GROUND_M = -1e4
"""Altitude AMSL of ground that no proof meets: no ground on earth is as low."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class StartViolation:
    """Why no certificate can begin at the vehicle's position."""

    terrain_m: float
    """Distance to the known terrain, at most the required clearance."""
    unknown: bool
    """Whether unknown ground, or the edge of the map, is too near."""
    zones: tuple[Zone, ...]
    """Keep-outs that are too near, or around the vehicle."""


def start_violation(request: PlanRequest) -> StartViolation | None:
    """Why no subpath can start at the requested place; None if it can."""
    required_m = request.task.required_clearance_m
    required_m = required_m * _PROVABLE if request.from_rest else required_m - _ROUNDING_M
    start, around = request.start.position_nea_m, request.around
    terrain_m = distance_to_terrain_m(around, start, required_m)
    seen_m = distance_to_terrain_m(around, start, required_m, seen_only=True)
    zones = tuple(each for each in request.task.zones if _gap_m(request, (each,)) < required_m)
    if terrain_m >= required_m and not zones:
        return None
    return StartViolation(
        terrain_m=terrain_m, unknown=seen_m >= required_m > terrain_m, zones=zones
    )


def escape_path(
    request: PlanRequest, found: StartViolation, prover: Prover
) -> tuple[Subpath, Certificate] | None:
    """The shortest straight escape path and its certificate; None: there is none.

    Proven: no nearer to the terrain than the vehicle is now, and with the whole clearance from
    where it first has that; no nearer to a zone that it is clear of than now.  Out of those that
    it is in, a way that first leads deeper is only taken if it is much shorter; and out of one that
    is too large, a way as far towards its edge as can be seen.  The certificate is that about the
    terrain.
    """
    around, required_m = request.around, request.task.required_clearance_m * _PROVABLE
    inside = tuple(zone for zone in found.zones if _gap_m(request, (zone,)) < _TOUCHING_M)
    ends = _ends_nea_m(request, inside)
    clear = (end for end in ends if distance_to_terrain_m(around, end, required_m) >= required_m)
    for end in islice(clear, _CERTIFIED):
        certificate = _proven(request, found, end, prover)
        if certificate is not None:
            return straight(request.start.position_nea_m, end), certificate
    return None


def _ends_nea_m(request: PlanRequest, inside: tuple[Zone, ...]) -> FloatArray:
    """Places to escape to, the best first: clear of zones, else less deep in those around it.

    inside: the zones that the vehicle is in.  -> (N, 3)
    """
    start, zones = request.start.position_nea_m, request.task.zones
    required_m = request.task.required_clearance_m * _PROVABLE
    ends = _all_round_nea_m(request, farther=bool(inside))
    clear = ends[_gaps_m(request, zones, ends) >= required_m]
    if not inside:
        return clear
    if not len(clear):
        others = tuple(zone for zone in zones if zone not in inside)
        ends = ends[_gaps_m(request, others, ends) >= required_m]
        gaps = _gaps_m(request, inside, ends)
        better = np.count_nonzero(gaps > _gap_m(request, inside) + _WORTH_M)
        return np.asarray(ends[np.argsort(-gaps, kind="stable")[:better]])
    near = clear[:_RANKED]
    ways = start + np.linspace(0.0, 1.0, _STEPS + 1)[:, None] * (near - start)[:, None]  # (N, S, 3)
    rank = np.linalg.norm(near - start, axis=-1)
    for zone in inside:
        gaps = _gaps_m(request, (zone,), ways)
        rank += _DEEPER * np.maximum(gaps[:, 0] - gaps.min(axis=1), 0.0)
    return np.concatenate([near[np.argsort(np.round(rank, 6), kind="stable")], clear[_RANKED:]])


def _all_round_nea_m(request: PlanRequest, *, farther: bool) -> FloatArray:
    """Places all round within the band, nearest first.  -> (N, 3)."""
    task, start = request.task, request.start.position_nea_m
    usual_m, most_m = _FARTHEST * task.settings.scan_range_m, task.end_radius_m
    lengths = np.linspace(usual_m / _LENGTHS, usual_m, _LENGTHS)
    if farther and most_m > usual_m:
        lengths = np.append(lengths, np.linspace(usual_m, most_m, _LONGER + 1)[1:])
    climb, dive = task.limits.climb_angle_rad, task.limits.dive_angle_rad
    bearing, length, steep = np.meshgrid(
        np.linspace(0.0, 2.0 * math.pi, _BEARINGS, endpoint=False),
        lengths,
        [0.0, 0.95 * climb, -0.95 * dive],
        indexing="ij",
    )
    level = length * np.cos(steep)
    away = np.stack(
        [level * np.cos(bearing), level * np.sin(bearing), length * np.sin(steep)], axis=-1
    )
    ends = start + away.reshape(-1, 3)
    low, high = task.band_amsl_m
    ends = ends[(ends[:, 2] >= low) & (ends[:, 2] <= high)]
    order = np.argsort(np.round(np.linalg.norm(ends - start, axis=-1), 6), kind="stable")
    return np.asarray(ends[order])


def _proven(
    request: PlanRequest, found: StartViolation, end: FloatArray, prover: Prover
) -> Certificate | None:
    """The certificate of the straight way to an end, if all of it is proven."""
    start, required_m = request.start.position_nea_m, request.task.required_clearance_m
    whole, known, now_m = straight(start, end), request.known, found.terrain_m
    if found.zones:  # no nearer to those that it is clear of than it is
        zones = tuple(z for z in request.task.zones if _gap_m(request, (z,)) >= _TOUCHING_M)
        nearest_m = _gap_m(request, zones)
        keep_m = min(required_m, max(nearest_m - _SLACK_M, 0.5 * nearest_m))
        air = replace(known, upper_m=np.full(known.upper_m.shape, _NO_GROUND_M))
        off = _kept(request, air, zones, keep_m)
        if not certify(whole, off, from_rest=True, prover=prover).proven:
            return None
    if now_m < required_m:
        along = start + np.linspace(0.0, 1.0, _SAMPLES + 1)[:, None] * (end - start)
        short = distances_to_terrain_m(request.around, along, required_m) < required_m
        split = along[min(int(np.flatnonzero(short)[-1]) + 1, _SAMPLES)]
        # The rest is proven for a vehicle at full speed, as it does not begin there at rest.
        ground, now_m = _kept(request, known, (), required_m), max(now_m - _SLACK_M, _SLACK_M)
        if np.linalg.norm(end - split) > 1.0 and not (
            certify(straight(split, end), ground, from_rest=False, prover=prover).proven
        ):
            return None
    ground = _kept(request, known, (), min(now_m, required_m))
    certificate = certify(whole, ground, from_rest=True, prover=prover)
    return certificate if certificate.proven else None


def _kept(
    request: PlanRequest, known: KnownMap, zones: tuple[Zone, ...], keep_m: float
) -> Surroundings:
    """What a way is to keep a distance from."""
    task = request.task
    contact_m = min(task.margins.contact_m, keep_m)
    return pack_surroundings(
        known,
        task.limits,
        task.radars,
        zones,
        replace(task.margins, clearance_m=keep_m, contact_m=contact_m),
        centre_ne_m=request.start.point_nea_m[:2],
        reach_m=task.settings.scan_range_m,
    )


def _gap_m(request: PlanRequest, zones: tuple[Zone, ...]) -> float:
    """Distance of the vehicle, or of the circle that it flies, to the nearest of some zones."""
    return float(_gaps_m(request, zones, request.start.position_nea_m))


def _gaps_m(request: PlanRequest, zones: tuple[Zone, ...], points_nea_m: FloatArray) -> FloatArray:
    """`_gap_m` of points.  (..., 3) -> (...)."""
    gaps = gaps_m(packed(zones), points_nea_m[..., 0], points_nea_m[..., 1])
    return np.asarray(gaps - request.task.limits.loiter_radius_m)
