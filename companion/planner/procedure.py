"""The online procedure (paper 2.3, design section 6): legs, where to scan, and the reference point.

     leg k      start ------------- p_scan ----- p_prog ------ end
                                      <-------- L --------->
                                                    <- tail ->

The next leg starts at p_prog of this one.  A leg that has no successor is flown to its end, where
the vehicle stops: the tail is long enough for that.  A plane circles the end.

Multicopters follow a point that moves along the path by itself (`advance`); planes, whose speed is
not commanded, are sent to a point ahead of their position (`follow`).
"""

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from companion.geodesy import FloatArray
from companion.path.limits import Limits
from companion.path.proof_distance import braked_m_s
from companion.path.subpath import Pose, Subpath
from companion.planner.request import Planned, Rest
from companion.planner.settings import Task

_LEAD_S = 1.0  # the reference point waits when it is this far ahead of the vehicle, at full speed
_GAINS = (
    0.6  # of that: so far ahead it gains no more speed, else the vehicle catches up faster than V
)
_SLOWEST = 0.25  # of V: what would have to be left more slowly is flown to its end
_ROUNDING_M = 1e-6
_ARRIVED_M = 0.05  # what is left of the speed there is worth no mention
_CHORDS = 32  # of the part of the path on which the nearest point is looked for
_WINDOW_S = 5.0  # how far ahead it is looked for, in seconds of flight
_PROJECTIONS = 2  # to the nearest point of a path that hardly bends over a tracking error
_LEAVES_RAD = math.radians(25.0)  # a plane leaves its circle when its course is so near the path's
_ON_CIRCLE = 1.0  # tracking errors beyond the circle: farther off a plane has left its path


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Leg:
    """A subpath in flight."""

    number: int
    """Counted from 1."""
    plan_id: int
    subpath: Subpath
    reaches_target: bool
    through: bool = False
    """Whether it may be flown to its end at full speed, into the leg that begins there (only for
    the backtrack, which is known in advance)."""
    rules: Task | None = None
    """The task it was proven under; None if unknown."""
    speed_m_s: float | None = None
    """The highest speed that it is proven for; None: V."""

    @staticmethod
    def of(planned: Planned, number: int, rules: Task | None = None) -> "Leg":
        """The leg that a plan becomes."""
        return Leg(
            number=number,
            plan_id=planned.plan_id,
            subpath=planned.subpath,
            reaches_target=planned.reaches_target,
            rules=rules,
            speed_m_s=planned.speed_m_s,
        )

    def scan_at_m(self, task: Task) -> float:
        """Length flown at p_scan: L before the end, or at once on a short leg."""
        return max(self.subpath.length_m - task.at_speed(self.speed_m_s).scan_distance_m, 0.0)

    def wants_successor(self, at_m: float, task: Task) -> bool:
        """Whether to scan and plan for the next leg, at this length flown: from p_scan on."""
        scan_distance_m = task.at_speed(self.speed_m_s).scan_distance_m
        is_past_scan = at_m >= self.subpath.length_m - scan_distance_m
        return is_past_scan and not self.reaches_target and self.can_be_left(task)

    def leaving(self, task: Task) -> tuple[float, float]:
        """Length flown at p_prog, the tail before the end, and the speed there.

        Among near things a leg shorter than L is flown so slowly that scan and plan, begun at its
        start at speed V, are done while it can still stop at the end.
        """
        task, length_m = task.at_speed(self.speed_m_s), self.subpath.length_m
        limits, speed_m_s = task.limits, task.limits.speed_m_s
        if self.through:
            return length_m, speed_m_s
        least_m = task.shortest_scan_distance_m
        earliest_m = max(length_m - task.scan_distance_m, 0.0) + least_m - task.tail_m
        at_m = min(max(length_m - task.tail_m, earliest_m), length_m)
        if length_m >= least_m or not task.settings.is_near:
            return at_m, speed_m_s
        braking, time_s = limits.acceleration_m_s2, (least_m - task.tail_m) / speed_m_s
        slower_m_s = [speed_m_s]  # (V - v)^2 / 2a + v t + what it slows down in from v: the length
        for flies_on_s, over_m in ((0.0, 0.0), (limits.dead_man_s, limits.overrun_m)):
            half_s = 0.5 * (time_s + flies_on_s - speed_m_s / braking)
            room_m = length_m + over_m - 0.5 * speed_m_s**2 / braking
            root_s = math.sqrt(max(half_s**2 + room_m / braking, 0.0))
            slower_m_s.append(max(braking * (root_s - half_s), 0.0))
        slow_m_s = min(slower_m_s)
        at_m = slow_m_s * time_s + 0.5 * (speed_m_s - slow_m_s) ** 2 / braking
        return min(at_m, length_m), slow_m_s

    def slows_to_m_s(self, task: Task) -> float | None:
        """The speed that a short leg is flown at, from its start on; None: V."""
        task, is_last = task.at_speed(self.speed_m_s), self.reaches_target or self.through
        if is_last or self.subpath.length_m >= task.shortest_scan_distance_m:
            return None
        return self.leaving(task)[1] if self.can_be_left(task) else None

    def successor_at_m(self, task: Task) -> float:
        """Length flown at p_prog."""
        return self.leaving(task)[0]

    def rest(self, task: Task) -> Rest:
        """What is left of it beyond p_prog."""
        length_m = self.subpath.length_m
        at_m, speed_m_s = self.leaving(task)
        end_nea_m = self.subpath.pose(length_m).point_nea_m
        return Rest(length_m=length_m - at_m, end_nea_m=end_nea_m, speed_m_s=speed_m_s)

    def can_be_left(self, task: Task) -> bool:
        """Whether a successor may take over in flight.

        The certificate assumes a vehicle that can stop at the end; from a p_prog too near to the
        end it could not, and a plane would be sent to points beyond it.  Such a leg is flown to its
        end, and the next begins at rest.
        """
        task = task.at_speed(self.speed_m_s)
        if not task.settings.profile.verified:
            return True
        limits, (at_m, speed_m_s) = task.limits, self.leaving(task)
        left_m = self.subpath.length_m - at_m + _ROUNDING_M
        slows_m = max(limits.slowing_m(speed_m_s), limits.lead_m)
        return left_m >= slows_m and speed_m_s >= _SLOWEST * limits.speed_m_s


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Reference:
    """The reference point on a leg: where the vehicle should be."""

    length_m: float = 0.0
    speed_m_s: float = 0.0


def advance(
    reference: Reference,
    leg: Leg,
    elapsed_s: float,
    vehicle_nea_m: FloatArray,
    limits: Limits,
    *,
    goes_on: bool,
    until_m: float | None = None,
    slows_to_m_s: float | None = None,
) -> Reference:
    """Move the reference point: speed up, cruise at V, slow down to stop at the end of the leg.

    It slows down with the mission's acceleration, harder where the path demands a lower speed;
    it gains speed the more slowly the farther behind the vehicle is, and waits if it is too far.
    goes_on: the next leg is ready, so there is no stop at the end of this one.  until_m: the length
    at which to stop if that is before the end.  slows_to_m_s: see `Leg.slows_to_m_s`.
    """
    pose = leg.subpath.pose(reference.length_m)
    allowed = allowed_speed_m_s(pose, limits)
    end_m = leg.subpath.length_m if until_m is None else min(leg.subpath.length_m, until_m)
    left = max(end_m - reference.length_m, 0.0)
    if not goes_on or until_m is not None:
        to_end = max(leg.subpath.length_m - reference.length_m, 0.0)
        braking, dead_man_s = limits.acceleration_m_s2, limits.dead_man_s
        allowed = min(allowed, braked_m_s(to_end, braking, dead_man_s, limits.overrun_m))
        if until_m is not None:
            allowed = min(allowed, limits.braked_m_s(left))
    change = limits.acceleration_m_s2 * elapsed_s
    if slows_to_m_s is not None:
        allowed = min(allowed, max(slows_to_m_s, reference.speed_m_s - change))
    lead = float((pose.position_nea_m - vehicle_nea_m) @ pose.tangent_nea)
    most = longest_wait_m(limits)
    if lead > most:
        return Reference(length_m=reference.length_m, speed_m_s=0.0)
    faster = change * min(max(1.0 - lead / (_GAINS * most), 0.0), 1.0)
    speed = min(max(allowed, reference.speed_m_s - 2.0 * change), reference.speed_m_s + faster)
    step = min(0.5 * (reference.speed_m_s + speed) * elapsed_s, left)
    return Reference(length_m=reference.length_m + step, speed_m_s=speed)


def longest_wait_m(limits: Limits) -> float:
    """How far behind it a copter may be: the reference point waits for it when it is farther."""
    return max(_LEAD_S * limits.speed_m_s, 2.0 * limits.tracking_error_m)


def follow(reference: Reference, leg: Leg, vehicle_nea_m: FloatArray, limits: Limits) -> Reference:
    """Reference point of a plane: the nearest point of the path, seen from above.

    It never moves back, nor farther ahead than the plane can have flown, so that a path that comes
    near to itself is not short-cut.
    """
    ahead_m = max(_WINDOW_S * limits.speed_m_s, limits.turn_radius_m)
    until_m = min(reference.length_m + ahead_m, leg.subpath.length_m)
    lengths = np.linspace(reference.length_m, max(until_m, reference.length_m), _CHORDS + 1)
    points = leg.subpath.points_nea_m(lengths)[:, :2]
    steps, offset = np.diff(points, axis=0), vehicle_nea_m[:2] - points[:-1]
    squared = np.maximum((steps * steps).sum(axis=-1), 1e-12)
    share = np.clip((steps * offset).sum(axis=-1) / squared, 0.0, 1.0)
    k = int(np.argmin(np.linalg.norm(offset - share[:, None] * steps, axis=-1)))
    at_m = float(lengths[k] + share[k] * (lengths[k + 1] - lengths[k]))
    return Reference(length_m=at_m, speed_m_s=limits.speed_m_s)


def sent_pose(
    reference: Reference, leg: Leg, next_leg: Leg | None, lead_m: float, task: Task
) -> Pose:
    """The point that a plane is sent to: so far ahead of where it is along the path.

    Beyond p_prog it lies on the next leg, if there is one; else it stays at the end of this one,
    and the plane circles there.
    """
    at_m = reference.length_m + lead_m
    if next_leg is not None and at_m > (over_at_m := leg.successor_at_m(task)):
        return next_leg.subpath.pose(at_m - over_at_m)
    return leg.subpath.pose(at_m)


def is_on_circle(
    centre_nea_m: tuple[float, float, float],
    position_nea_m: tuple[float, float, float],
    limits: Limits,
) -> bool:
    """Whether a plane has reached its loiter circle."""
    most_m = limits.loiter_radius_m + _ON_CIRCLE * limits.tracking_error_m
    return math.dist(centre_nea_m, position_nea_m) <= most_m


def may_leave(
    leg: Leg,
    at_m: float,
    position_nea_m: tuple[float, float, float],
    velocity_nea_m_s: tuple[float, float, float],
    limits: Limits,
) -> bool:
    """Whether a plane that circles a point of a leg is on that circle and flies the leg's way.

    It does so once in each turn, and is then no farther aside than its circle: what it flies until
    it is on the path lies within the circles about the path's points, which are proven.
    """
    pose = leg.subpath.pose(at_m)
    north, east = velocity_nea_m_s[0], velocity_nea_m_s[1]
    along = north * float(pose.tangent_nea[0]) + east * float(pose.tangent_nea[1])
    level = math.hypot(float(pose.tangent_nea[0]), float(pose.tangent_nea[1]))
    near = is_on_circle(pose.point_nea_m, position_nea_m, limits)
    return near and along >= math.cos(_LEAVES_RAD) * level * math.hypot(north, east) > 0.0


def off_path_m(reference: Reference, leg: Leg, vehicle_nea_m: FloatArray) -> float:
    """Distance of the vehicle from the path near the reference point; beyond its end, from that.

    Before its start the path is taken to come straight from behind: another leg does.
    """
    at_m = reference.length_m
    for _ in range(_PROJECTIONS):
        pose = leg.subpath.pose(at_m)
        along_m = float((vehicle_nea_m - pose.position_nea_m) @ pose.tangent_nea)
        at_m = min(max(at_m + along_m, 0.0), leg.subpath.length_m)
    pose = leg.subpath.pose(at_m)
    off = vehicle_nea_m - pose.position_nea_m
    along_m = float(off @ pose.tangent_nea)
    if at_m < leg.subpath.length_m:
        off = off - along_m * pose.tangent_nea
    return float(np.linalg.norm(off))


def ahead_m(reference: Reference, leg: Leg, vehicle_nea_m: FloatArray) -> float:
    """How far the vehicle is ahead of the reference point, along the path; negative: behind."""
    pose = leg.subpath.pose(reference.length_m)
    return float((vehicle_nea_m - pose.position_nea_m) @ pose.tangent_nea)


def allowed_speed_m_s(pose: Pose, limits: Limits) -> float:
    """V, or less where the path climbs faster than the vehicle can."""
    steepness = abs(float(pose.tangent_nea[2]))
    return min(limits.speed_m_s, limits.climb_rate_m_s / max(steepness, 1e-9))


def is_at_end(reference: Reference, leg: Leg, until_m: float | None = None) -> bool:
    """Whether the reference point has come to the end of its leg, or to where it is to stop."""
    end_m = leg.subpath.length_m if until_m is None else min(leg.subpath.length_m, until_m)
    return end_m - reference.length_m < _ARRIVED_M


def hover_pose(position_nea_m: tuple[float, float, float]) -> Pose:
    """The start pose of a vehicle at rest; the plan chooses the tangent."""
    return Pose(position_nea_m=np.asarray(position_nea_m), tangent_nea=np.array([1.0, 0.0, 0.0]))
