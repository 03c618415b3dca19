"""The shortest way out, for a vehicle that hovers where no certificate can begin.

A threat that appears around the vehicle, or a slope that it is held beside: from there no curve
keeps the required clearance.  The way out is a straight one, proven not to come nearer to the
terrain than the vehicle is already, clear of every other threat, and clear of all at its end.
"""

import math
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from companion.geodesy import FloatArray
from companion.path.certificate import Certificate, Prover, certify, pack_surroundings
from companion.path.proof_distance import Surroundings
from companion.path.subpath import Subpath
from companion.planner.request import PlanRequest
from companion.world.clearance import distance_to_terrain_m
from companion.world.known_map import KnownMap
from companion.world.threats import KeepOut

_BEARINGS = 72
_LENGTHS = 24
_FARTHEST = 0.4  # of R
_CERTIFIED = 200  # candidates that are tried, shortest first
_SLACK_M = 0.5
_ROUNDING_M = 1e-3  # a subpath may begin where another just keeps its distance
_PROVABLE = 1.002
_SAMPLES = 64


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Trouble:
    """What keeps a certificate from beginning where the vehicle is."""

    terrain_m: float
    """Distance to the known terrain, at most the required clearance."""
    unknown: bool
    """Whether it is unknown ground, or the edge of the map, that is too near."""
    zones: tuple[KeepOut, ...]
    """Keep-outs that are too near, or around the vehicle."""


def trouble(request: PlanRequest) -> Trouble | None:
    """What is wrong with the place where a subpath is to start, None if nothing."""
    required_m = request.task.required_clearance_m
    # A proof needs a little more than the bound itself; where a subpath was proven it had that.
    required_m = required_m * _PROVABLE if request.from_rest else required_m - _ROUNDING_M
    start = request.start.position_nea_m
    terrain_m = distance_to_terrain_m(request.known, start, required_m)
    seen_m = distance_to_terrain_m(request.known, start, required_m, seen_only=True)
    zones = tuple(zone for zone in request.task.keep_outs if _distance_m(zone, start) < required_m)
    if terrain_m >= required_m and not zones:
        return None
    return Trouble(terrain_m=terrain_m, unknown=seen_m >= required_m > terrain_m, zones=zones)


def way_out(
    request: PlanRequest, found: Trouble, prover: Prover
) -> tuple[Subpath, Certificate] | None:
    """The shortest straight subpath out of trouble, and what is proven of it; None: there is none.

    Proven: no nearer to the terrain than the vehicle is now, and with the whole clearance from
    where it first has that; no nearer to a keep-out that it is outside of than now.  Out of one
    that it is in, the way never leads deeper.  The certificate is that about the terrain.
    """
    start = request.start.position_nea_m
    for end in _ends_nea_m(request)[:_CERTIFIED]:
        if all(_leaves(zone, start, end) for zone in found.zones if _distance_m(zone, start) < 0.0):
            certificate = _proven(request, found, end, prover)
            if certificate is not None:
                return _straight(start, end), certificate
    return None


def _proven(
    request: PlanRequest, found: Trouble, end: FloatArray, prover: Prover
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
        short = [distance_to_terrain_m(request.known, at, required_m) < required_m for at in along]
        split = along[min(int(np.flatnonzero(short)[-1]) + 1, _SAMPLES)]
        now_m = max(now_m - _SLACK_M, _SLACK_M)
    # The rest is proven for a vehicle at full speed, as it does not begin there at rest.
    if now_m < required_m and np.linalg.norm(end - split) > 1.0:
        rest = certify(
            _straight(split, end), _terrain(request, required_m), from_rest=False, prover=prover
        )
        if not rest.proven:
            return None
    whole = certify(_straight(start, end), _terrain(request, now_m), from_rest=True, prover=prover)
    return whole if whole.proven else None


def _keeps_off_zones(request: PlanRequest, end: FloatArray, prover: Prover) -> bool:
    """Whether the way comes no nearer to keep-outs that the vehicle is outside of than it is."""
    task, start = request.task, request.start.position_nea_m
    outside = tuple(zone for zone in task.keep_outs if _distance_m(zone, start) >= 0.0)
    nearest_m = min((_distance_m(zone, start) for zone in outside), default=np.inf)
    keep_m = max(min(task.required_clearance_m, nearest_m - _SLACK_M), _SLACK_M)
    flat = replace(request.known, upper_m=np.full(request.known.upper_m.shape, -1e4))
    surroundings = _surroundings(request, flat, outside, keep_m)
    return certify(_straight(start, end), surroundings, from_rest=True, prover=prover).proven


def _terrain(request: PlanRequest, keep_m: float) -> Surroundings:
    return _surroundings(request, request.known, (), keep_m)


def _surroundings(
    request: PlanRequest, known: KnownMap, zones: tuple[KeepOut, ...], keep_m: float
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
        reach_m=_FARTHEST * task.settings.scan_range_m,
    )


def _straight(start: FloatArray, end: FloatArray) -> Subpath:
    return Subpath(control_nea_m=start + np.linspace(0.0, 1.0, 4)[:, None] * (end - start))


def _distance_m(zone: KeepOut, point_nea_m: FloatArray) -> float:
    return float(zone.distance_m(point_nea_m[0], point_nea_m[1]))


def _leaves(zone: KeepOut, start: FloatArray, end: FloatArray) -> bool:
    """Whether the straight way never leads deeper into a zone."""
    at = start + np.linspace(0.0, 1.0, _SAMPLES + 1)[:, None] * (end - start)
    gap = zone.distance_m(at[:, 0], at[:, 1])
    return bool((np.diff(np.minimum(gap, 0.0)) >= -1e-6).all())


def _ends_nea_m(request: PlanRequest) -> FloatArray:
    """Places all round that keep every clearance, nearest first.  -> (N, 3)."""
    task, start = request.task, request.start.position_nea_m
    required_m, limits = task.required_clearance_m * _PROVABLE, task.limits
    bearing = np.linspace(0.0, 2.0 * math.pi, _BEARINGS, endpoint=False)[:, None, None]
    farthest_m = _FARTHEST * task.settings.scan_range_m
    length = np.linspace(farthest_m / _LENGTHS, farthest_m, _LENGTHS)[None, :, None]
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
    good = (ends[:, 2] >= low) & (ends[:, 2] <= high)
    for zone in task.keep_outs:
        good &= zone.distance_m(ends[:, 0], ends[:, 1]) >= required_m
    ends = ends[good]
    ends = ends[np.argsort(np.linalg.norm(ends - start, axis=-1), kind="stable")]
    clear = [distance_to_terrain_m(request.known, end, required_m) >= required_m for end in ends]
    return ends[np.array(clear, dtype=bool)]
