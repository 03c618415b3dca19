"""Escape: the shortest way out of a place where no certificate can begin.

If a threat appears around a hovering or loitering vehicle, or it holds beside a slope, no curve
from there keeps the required clearance.  The escape path is straight, proven not to come nearer to
the terrain than the vehicle already is, clear of every other threat, and clear of all at its end.
For a plane distances are those of its loiter circle.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from typing import final

import numpy as np

from companion.geodesy import BoolArray, FloatArray
from companion.path.certificate import Certificate, Prover, certify, pack_surroundings
from companion.path.proof import Surroundings
from companion.path.subpath import Subpath, straight
from companion.planner.request import PlanRequest
from companion.planner.settings import Task
from companion.world.columns import distance_to_terrain_m
from companion.world.known_map import KnownMap
from companion.world.zones import Zone

_BEARINGS = 72
_LENGTHS, _LONGER = 24, 12
_FARTHEST = 0.4  # of R, to where the way is usually short; beyond only out of large zones
_CERTIFIED = 200  # candidates that are tried, shortest first
_RANKED, _STEPS = 600, 16  # of the shortest ways out of zones
_DEEPER = 3.0  # metres of way for each that it first leads deeper
_SLACK_M = 0.5
_WORTH_M = 1.0
_TOUCHING_M = 0.5  # nearer to a zone than this counts as inside
_ROUNDING_M = 1e-3  # a subpath may begin where another just keeps its distance
_PROVABLE = 1.002
_SAMPLES = 64


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
    # A proof needs a little more than the bound itself; where a subpath was proven it had that.
    required_m = required_m * _PROVABLE if request.from_rest else required_m - _ROUNDING_M
    start, task = request.start.position_nea_m, request.task
    around = request.around
    terrain_m = distance_to_terrain_m(around, start, required_m)
    seen_m = distance_to_terrain_m(around, start, required_m, seen_only=True)
    zones = tuple(zone for zone in task.zones if _gap_m(zone, start, task) < required_m)
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
    start, task = request.start.position_nea_m, request.task
    inside = tuple(zone for zone in found.zones if _gap_m(zone, start, task) < _TOUCHING_M)
    ends = _ends_nea_m(request, farther=bool(inside))
    clear = ends[_clear_of(task.zones, ends, task)]
    if not len(clear):
        clear = _towards_edge(request, inside, ends)
    elif inside:
        clear = _in_order(request, inside, clear)
    for end in islice(_clear_of_terrain(request, clear), _CERTIFIED):
        certificate = _proven(request, found, end, prover)
        if certificate is not None:
            return straight(start, end), certificate
    return None


def _in_order(request: PlanRequest, inside: tuple[Zone, ...], ends: FloatArray) -> FloatArray:
    """The nearest ends by length and by how much deeper into zones the way leads; then the rest."""
    start, task = request.start.position_nea_m, request.task
    near = ends[:_RANKED]
    share = np.linspace(0.0, 1.0, _STEPS + 1)[:, None]
    ways = start + share * (near - start)[:, None]  # (N, S, 3)
    deeper_m = np.zeros(len(near))
    for zone in inside:
        gaps = _gaps_m(zone, ways, task)
        deeper_m += np.maximum(gaps[:, 0] - gaps.min(axis=1), 0.0)
    rank = np.linalg.norm(near - start, axis=-1) + _DEEPER * deeper_m
    return np.concatenate([near[np.argsort(np.round(rank, 6), kind="stable")], ends[_RANKED:]])


def _towards_edge(request: PlanRequest, inside: tuple[Zone, ...], ends: FloatArray) -> FloatArray:
    """Places in zones that the vehicle is in, less deep than it is, the least deep first."""
    if not inside:
        return ends[:0]
    start, task = request.start.position_nea_m, request.task
    others = tuple(zone for zone in task.zones if zone not in inside)
    ends = ends[_clear_of(others, ends, task)]
    gaps = np.min([_gaps_m(zone, ends, task) for zone in inside], axis=0)
    now_m = min(_gap_m(zone, start, task) for zone in inside)
    order = np.argsort(-gaps, kind="stable")
    return np.asarray(ends[order[: np.count_nonzero(gaps > now_m + _WORTH_M)]])


def _proven(
    request: PlanRequest, found: StartViolation, end: FloatArray, prover: Prover
) -> Certificate | None:
    """The certificate of the straight way to an end, if all of it is proven."""
    task, start = request.task, request.start.position_nea_m
    required_m = task.required_clearance_m
    if found.zones and not _keeps_off_zones(request, end, prover):
        return None
    now_m = min(required_m, found.terrain_m)
    if now_m >= required_m:
        split = start
    else:
        share = np.linspace(0.0, 1.0, _SAMPLES + 1)[:, None]
        along = start + share * (end - start)
        around = request.around
        short = [distance_to_terrain_m(around, at, required_m) < required_m for at in along]
        split = along[min(int(np.flatnonzero(short)[-1]) + 1, _SAMPLES)]
        now_m = max(now_m - _SLACK_M, _SLACK_M)
    # The rest is proven for a vehicle at full speed, as it does not begin there at rest.
    if now_m < required_m and np.linalg.norm(end - split) > 1.0:
        rest = certify(
            straight(split, end), _terrain(request, required_m), from_rest=False, prover=prover
        )
        if not rest.proven:
            return None
    whole = certify(straight(start, end), _terrain(request, now_m), from_rest=True, prover=prover)
    return whole if whole.proven else None


def _keeps_off_zones(request: PlanRequest, end: FloatArray, prover: Prover) -> bool:
    """Whether the way comes no nearer to zones that the vehicle is clear of than it is."""
    task, start = request.task, request.start.position_nea_m
    outside = tuple(zone for zone in task.zones if _gap_m(zone, start, task) >= _TOUCHING_M)
    nearest_m = min((_gap_m(zone, start, task) for zone in outside), default=np.inf)
    keep_m = min(task.required_clearance_m, max(nearest_m - _SLACK_M, 0.5 * nearest_m))
    flat = replace(request.known, upper_m=np.full(request.known.upper_m.shape, -1e4))
    surroundings = _surroundings(request, flat, outside, keep_m)
    return certify(straight(start, end), surroundings, from_rest=True, prover=prover).proven


def _terrain(request: PlanRequest, keep_m: float) -> Surroundings:
    return _surroundings(request, request.known, (), keep_m)


def _surroundings(
    request: PlanRequest, known: KnownMap, zones: tuple[Zone, ...], keep_m: float
) -> Surroundings:
    task = request.task
    margins = replace(
        task.margins, clearance_m=keep_m, contact_m=min(task.margins.contact_m, keep_m)
    )
    return pack_surroundings(
        known,
        task.limits,
        task.radars,
        zones,
        margins,
        centre_ne_m=request.start.point_nea_m[:2],
        reach_m=task.settings.scan_range_m,
    )


def _gap_m(zone: Zone, point_nea_m: FloatArray, task: Task) -> float:
    """Distance of the vehicle, or of the circle that it flies, to the edge of a zone."""
    return float(_gaps_m(zone, point_nea_m, task))


def _gaps_m(zone: Zone, points_nea_m: FloatArray, task: Task) -> FloatArray:
    """`_gap_m` of points.  (..., 3) -> (...)."""
    gaps = zone.distance_m(points_nea_m[..., 0], points_nea_m[..., 1])
    return np.asarray(gaps - task.limits.loiter_radius_m)


def _clear_of(zones: tuple[Zone, ...], ends: FloatArray, task: Task) -> BoolArray:
    """Which of the places keep the required clearance from zones.  (N, 3) -> (N,)."""
    clear = np.ones(len(ends), dtype=bool)
    for zone in zones:
        clear &= _gaps_m(zone, ends, task) >= task.required_clearance_m * _PROVABLE
    return clear


def _clear_of_terrain(request: PlanRequest, ends: Iterable[FloatArray]) -> Iterator[FloatArray]:
    """Those of the places that keep the required clearance from the terrain."""
    required_m, around = request.task.required_clearance_m * _PROVABLE, request.around
    return (end for end in ends if distance_to_terrain_m(around, end, required_m) >= required_m)


def _ends_nea_m(request: PlanRequest, *, farther: bool) -> FloatArray:
    """Places all round within the band, nearest first.  -> (N, 3)."""
    task, start = request.task, request.start.position_nea_m
    limits = task.limits
    bearing = np.linspace(0.0, 2.0 * math.pi, _BEARINGS, endpoint=False)[:, None, None]
    usual_m, most_m = _FARTHEST * task.settings.scan_range_m, task.end_radius_m
    lengths = np.linspace(usual_m / _LENGTHS, usual_m, _LENGTHS)
    if farther and most_m > usual_m:
        lengths = np.append(lengths, np.linspace(usual_m, most_m, _LONGER + 1)[1:])
    length = lengths[None, :, None]
    slope = np.tan([0.0, 0.95 * limits.climb_angle_rad, -0.95 * limits.dive_angle_rad])
    level = length * np.cos(np.arctan(slope))
    ends = np.stack(
        np.broadcast_arrays(
            start[0] + level * np.cos(bearing),
            start[1] + level * np.sin(bearing),
            start[2] + level * slope + 0.0 * bearing,
        ),
        axis=-1,
    ).reshape(-1, 3)
    low, high = task.band_amsl_m
    ends = ends[(ends[:, 2] >= low) & (ends[:, 2] <= high)]
    order = np.argsort(np.round(np.linalg.norm(ends - start, axis=-1), 6), kind="stable")
    return np.asarray(ends[order])
