"""Backtrack: the flown path reversed, segment by segment, and proven again.

A segment of a B-spline, cut at its knots, is one cubic per piece: reversed it is the same curve.
It must be proven again: map and zones may have changed, climbs become dives, and the dead-man reach
points in the other direction.
"""

import math
from itertools import product
from typing import NamedTuple

import numpy as np

from companion.geodesy import FloatArray
from companion.path.certificate import certify
from companion.path.subpath import Subpath, cubics_of, samples_at, straight
from companion.planner import procedure
from companion.planner.request import Backtrack, FlownSegment
from companion.planner.settings import Task
from companion.world.known_map import KnownMap

_SHORTEST_M = 0.5  # no piece is shorter
_APART_M = 0.05  # farther apart two segments are joined by a straight leg
_SMOOTH = 1e-6  # of the unit tangent: more is a corner, at which the vehicle stops


def backtrack(
    flown: tuple[FlownSegment, ...], task: Task, known: KnownMap, plan_id: int = 0
) -> Backtrack:
    """Subpaths back along the flown segments, from their end to their start.

    flown: in flight order.  The subpaths end before the first one that cannot be proven; then
    `reaches_start` is False.  A `through` subpath may be flown into the next without a stop, else
    the vehicle stops at its end: those before it are flown so slowly that it can, and so that none
    is entered faster than its bends allow.  The vehicle starts at rest.
    """
    legs, reaches_start = list[_Leg](), True  # the last one first
    for control, speed_m_s in reversed(_curves_back(flown, task)):
        leg = _leg_back(control, speed_m_s, task, known, legs[-1] if legs else None)
        if leg is None:
            reaches_start = False
            legs.clear()
        else:
            legs.append(leg)
    legs.reverse()
    return Backtrack(
        plan_id=plan_id,
        subpaths=tuple(leg.subpath for leg in legs),
        through=tuple(leg.through for leg in legs),
        reaches_start=reaches_start,
        speeds_m_s=tuple(leg.speed_m_s for leg in legs),
    )


class _Leg(NamedTuple):
    """A subpath back, proven."""

    subpath: Subpath
    through: bool
    speed_m_s: float
    entry_m_s: float  # the fastest that it may be entered; 0: it begins at rest


def _leg_back(
    control: FloatArray, speed_m_s: float, task: Task, known: KnownMap, follows: _Leg | None
) -> _Leg | None:
    """A curve as a leg, into the one that follows if that may be; None: it is not proven."""
    subpath, ways = Subpath(control_nea_m=control), [(speed_m_s, False)]
    if follows and follows.entry_m_s > 0.0 and _is_smooth(control, follows.subpath.control_nea_m):
        most_m_s = math.inf
        if task.limits.hovers:
            slows = 2.0 * task.envelope.gaining_m_s2 * subpath.length_m
            most_m_s = math.sqrt(follows.entry_m_s**2 + slows)
        ways.insert(0, (min(speed_m_s, most_m_s), True))
    for (at_m_s, through), from_rest in product(ways, (False, True)):
        slow = task.at_speed(at_m_s)
        if _is_proven(subpath, slow, known, from_rest=from_rest, stops=not through):
            entry_m_s = procedure.entry_m_s(subpath, slow.envelope, stops=not through)
            return _Leg(subpath, through, at_m_s, 0.0 if from_rest else entry_m_s)
    return None


def _curves_back(flown: tuple[FlownSegment, ...], task: Task) -> list[tuple[FloatArray, float]]:
    """Cubics, each from the end of the one before: control points, (4, 3), and the speed."""
    curves: list[tuple[FloatArray, float]] = []
    for segment in reversed(flown):
        speed_m_s = task.at_speed(segment.speed_m_s).limits.speed_m_s
        for control in _reversed(segment):
            if curves:
                last = curves[-1][0][-1]
                if np.linalg.norm(control[0] - last) > _APART_M:
                    curves.append((straight(last, control[0]).control_nea_m, speed_m_s))
                else:
                    control[0] = last
            curves.append((control, speed_m_s))
    return curves


def _reversed(segment: FlownSegment) -> list[FloatArray]:
    """A segment of a leg, reversed, as Bezier control points of its pieces."""
    subpath, cubics = Subpath(control_nea_m=segment.control_nea_m), cubics_of(segment.control_nea_m)
    first_m, last_m = segment.from_m + _SHORTEST_M, segment.until_m - _SHORTEST_M
    if last_m <= segment.from_m:
        return []
    knots = [k / len(cubics) for k in range(1, len(cubics))]
    inner = [u for u in knots if first_m < subpath.length_at_m(u) < last_m]
    first, last = subpath.parameters_at(np.array([segment.from_m, segment.until_m]))
    cuts = np.array([first, *inner, last])
    curve = samples_at(cubics, cuts)
    third = np.diff(cuts)[:, None] / 3.0
    leaving, arriving = curve.first[:-1] * third, curve.first[1:] * third
    begin, end = curve.value[:-1], curve.value[1:]
    return list(np.stack([end, end - arriving, begin + leaving, begin], axis=1)[::-1])


def _is_smooth(control: FloatArray, follows: FloatArray) -> bool:
    """Whether a curve goes on in the direction of the one before it."""
    before, after = control[3] - control[2], follows[1] - follows[0]
    before, after = (leg / max(float(np.linalg.norm(leg)), 1e-12) for leg in (before, after))
    return float(np.linalg.norm(before - after)) < _SMOOTH


def _is_proven(
    subpath: Subpath, task: Task, known: KnownMap, *, from_rest: bool, stops: bool
) -> bool:
    motion, control = task.envelope, subpath.control_nea_m[:, :2]
    if task.limits.hovers:  # it climbs as steeply as it dives, only slower
        steepest = max(motion.climb_angle_rad, motion.dive_angle_rad)
        motion = motion._replace(climb_angle_rad=steepest, dive_angle_rad=steepest)
    centre = 0.5 * (control.min(axis=0) + control.max(axis=0))
    reach_m = float(np.linalg.norm(control - centre, axis=-1).max())
    place = float(centre[0]), float(centre[1])
    around = task.surroundings(known, place, reach_m)._replace(motion=motion, stops=stops)
    return certify(subpath, around, from_rest=from_rest).proven
