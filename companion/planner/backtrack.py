"""Backtrack: the flown path reversed, segment by segment, and proven again.

A segment of a B-spline, cut at its knots, is one cubic per piece: reversed it is the same curve.
It must be proven again: map and zones may have changed, climbs become dives, and the dead-man reach
points in the other direction.
"""

from functools import partial
from itertools import zip_longest

import numpy as np

from companion.geodesy import FloatArray
from companion.path.certificate import certify
from companion.path.subpath import Subpath, cubics_of, samples_at, straight
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
    `reaches_start` is False.  A `through` subpath may be flown into the next at full speed, else
    the vehicle stops at its end.  The vehicle starts at rest.
    """
    curves, from_rest = _curves_back(flown, task), True
    subpaths, throughs, speeds_m_s = list[Subpath](), list[bool](), list[float]()
    for (control, speed_m_s), follows in zip_longest(curves, curves[1:]):
        subpath, slow = Subpath(control_nea_m=control), task.at_speed(speed_m_s)
        is_proven = partial(_is_proven, subpath, slow, known, from_rest=from_rest)
        through = follows is not None and follows[1] >= speed_m_s  # else it would come too fast
        through = through and _is_smooth(control, follows[0]) and is_proven(stops=False)
        if not (through or is_proven(stops=True)):
            break
        subpaths.append(subpath)
        throughs.append(through)
        speeds_m_s.append(speed_m_s)
        from_rest = not through
    return Backtrack(
        plan_id=plan_id,
        subpaths=tuple(subpaths),
        through=tuple(throughs),
        reaches_start=len(subpaths) == len(curves),
        speeds_m_s=tuple(speeds_m_s),
    )


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
    ends = subpath.parameter_at(segment.from_m), subpath.parameter_at(segment.until_m)
    cuts = np.array([ends[0], *inner, ends[1]])
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
    if task.limits.hovers:  # it climbs as steeply as it dives, only slower: `allowed_speed_m_s`
        steepest = max(motion.climb_angle_rad, motion.dive_angle_rad)
        motion = motion._replace(climb_angle_rad=steepest, dive_angle_rad=steepest)
    centre = 0.5 * (control.min(axis=0) + control.max(axis=0))
    reach_m = float(np.linalg.norm(control - centre, axis=-1).max())
    place = float(centre[0]), float(centre[1])
    around = task.surroundings(known, place, reach_m)._replace(motion=motion, stops=stops)
    return certify(subpath, around, from_rest=from_rest).proven
