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
from companion.path.subpath import Subpath
from companion.planner.request import PlanRequest
from companion.world.clearance import distance_to_terrain_m
from companion.world.threats import KeepOut

_BEARINGS = 72
_LENGTHS = 24
_FARTHEST = 0.4  # of R
_CERTIFIED = 200  # candidates that are tried, shortest first
_SLACK_M = 0.5
_ROUNDING_M = 1e-3  # a subpath may begin where another just keeps its distance


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Trouble:
    """What keeps a certificate from beginning where the vehicle is."""

    terrain_m: float
    """Distance to the known terrain."""
    inside: tuple[KeepOut, ...]
    """Keep-outs that are too near, or around the vehicle."""


def trouble(request: PlanRequest) -> Trouble | None:
    """What is wrong with the place where a subpath is to start, None if nothing."""
    required_m = request.task.required_clearance_m - _ROUNDING_M
    start = request.start.position_nea_m
    terrain_m = distance_to_terrain_m(request.known, start, required_m)
    inside = tuple(
        zone
        for zone in request.task.keep_outs
        if float(zone.distance_m(start[0], start[1])) < required_m
    )
    if terrain_m >= required_m and not inside:
        return None
    return Trouble(terrain_m=terrain_m, inside=inside)


def way_out(
    request: PlanRequest, found: Trouble, prover: Prover
) -> tuple[Subpath, Certificate] | None:
    """The shortest straight subpath out of trouble, and what is proven of it; None: there is none.

    The certificate is about the terrain and the other threats, with the clearance that the
    vehicle has now where that is less than the required one.
    """
    task = request.task
    others = tuple(zone for zone in task.keep_outs if zone not in found.inside)
    nearest_m = min(task.required_clearance_m, found.terrain_m - _SLACK_M)
    margins = replace(
        task.margins,
        clearance_m=max(nearest_m, _SLACK_M),
        contact_m=min(task.margins.contact_m, max(nearest_m, _SLACK_M)),
    )
    surroundings = pack_surroundings(
        request.known,
        task.limits,
        task.radars,
        others,
        margins,
        centre_ne_m=request.start.point_nea_m[:2],
        reach_m=_FARTHEST * task.settings.scan_range_m,
    )
    for end in _ends_nea_m(request)[:_CERTIFIED]:
        share = np.linspace(0.0, 1.0, 4)[:, None]
        start = request.start.position_nea_m
        subpath = Subpath(control_nea_m=start + share * (end - start))
        certificate = certify(subpath, surroundings, from_rest=True, prover=prover)
        if certificate.proven:
            return subpath, certificate
    return None


def _ends_nea_m(request: PlanRequest) -> FloatArray:
    """Places all round that keep every clearance, nearest first.  -> (N, 3)."""
    task, start = request.task, request.start.position_nea_m
    required_m, limits = task.required_clearance_m, task.limits
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
