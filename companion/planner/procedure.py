"""The online procedure (paper 2.3, design section 6): legs, where to scan, and the reference point.

     leg k      start ------------- p_scan ----- p_prog ------ end
                                      <-------- L --------->
                                                    <- tail ->

The next leg starts at p_prog of this one.  A leg that has no successor is flown to its end, where
the vehicle stops: the tail is long enough for that.  A plane circles the end.

Multicopters follow a point that moves along the path by itself (`advance`); planes, whose speed is
not commanded, are sent to a point ahead of their position (`follow`).  One that is not quite on the
path, after a restart, joins it without a jump (`Offset`).
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import final

import numpy as np

from companion.geodesy import FloatArray
from companion.path.envelope import SLOWEST, Envelope, ending_m_s, slowed_m_s, slowing_m
from companion.path.limits import Limits
from companion.path.subpath import Pose, Subpath
from companion.planner.progress import SLACK
from companion.planner.request import Planned, Rest
from companion.planner.settings import Task
from companion.world.near_map import NearMap
from companion.world.zones import Zone, gaps_m

_GAINS = 0.6  # of the lag: so far ahead it gains no speed, else the vehicle catches up too fast
_ROUNDING_M = 1e-6  # of lengths, as of proofs
ARRIVED_M = 0.05
"""So near to its end a leg is flown: what is left of the speed there is worth no mention."""
_CHORDS = 32  # of the part of the path on which the nearest point is looked for
_WINDOW_S = 5.0  # how far ahead it is looked for, in seconds of flight
_PACES = 100  # parts of a leg for each of which a speed is known
_PROJECTIONS = 2  # to the nearest point of a path that hardly bends over a tracking error
_LEAVES = math.cos(math.radians(25.0))  # a plane leaves its circle when it flies so along the path
_LEEWAY, _LEEWAY_M = 2e-3, 0.01
"""Of the required distance, and metres besides: a certificate is not exact either (to 1 %)."""
_PAST_TARGET = 0.25  # loiter radii: so far ahead of it, ArduPlane swerves by some 15 m
_BAND_SLACK_M = 0.5  # a ceiling above home moves that much with where the autopilot has its home
_BAND_SAMPLES = 100
"""A leg climbs by less than its climb angle over 1 % of its length between two of them."""
_SHARE = 0.5  # of the acceleration, for joining the path: the path needs the rest
_SLOWEST_1_S, _FASTEST_1_S = 0.02, 1.0  # gone within minutes, and as fast as a vehicle follows
_GONE = 0.05  # m and m/s

Vector = tuple[float, float, float]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Reference:
    """The reference point on a leg: where the vehicle should be."""

    length_m: float = 0.0
    speed_m_s: float = 0.0


@final
@dataclass(frozen=True, kw_only=True, eq=False)  # no slots: what is asked for often is kept
class Leg:
    """A subpath in flight."""

    number: int  # counted from 1
    plan_id: int
    subpath: Subpath
    reaches_target: bool
    through: bool = False
    """Whether it may be flown to its end at full speed, into the leg that begins there (only for
    the backtrack, which is known in advance)."""
    rules: Task  # the task that it was proven under
    speed_m_s: float | None = None  # the highest speed that it is proven for; None: V
    p_prog: Reference | None = None
    """Where its successor takes over, and how fast, once that was asked for."""

    @staticmethod
    def of(planned: Planned, number: int, rules: Task) -> "Leg":
        """The leg that a plan becomes."""
        return Leg(
            number=number, rules=rules, plan_id=planned.plan_id, subpath=planned.subpath,
            reaches_target=planned.reaches_target, speed_m_s=planned.speed_m_s,
        )  # fmt: skip

    @cached_property
    def task(self) -> Task:
        """The task at the highest speed that it is proven for."""
        return self.rules.at_speed(self.speed_m_s)

    @cached_property
    def motion(self) -> Envelope:
        """How the vehicle moves on it."""
        return self.task.envelope

    @cached_property
    def scan_at_m(self) -> float:
        """Length flown at p_scan: L before the end, or at once (short legs, and near things)."""
        at_m = self.subpath.length_m - self.task.scan_distance_m
        return 0.0 if self.task.settings.is_near else max(at_m, 0.0)

    @cached_property
    def slows_at_m(self) -> float:
        """Length flown from which on the reference point may have to slow down for its end."""
        return self.subpath.length_m - slowing_m(self.motion, self.motion.speed_m_s)

    def leaves(self, reference: Reference) -> Reference:
        """The reference point at p_prog, if the successor is asked for now.

        The tail before the end; among near things, of which each sweep shows more, as soon as scan
        and plan are done.  Until then it slows down for the end of this leg, as it has no other.
        """
        task, length_m, full_m_s = self.task, self.subpath.length_m, self.motion.speed_m_s
        if self.through:
            return Reference(length_m=length_m, speed_m_s=full_m_s)
        least_m = task.shortest_scan_distance_m
        if not task.settings.is_near:
            at_m = max(length_m - task.tail_m, self.scan_at_m + least_m - task.tail_m)
            return Reference(length_m=min(at_m, length_m), speed_m_s=full_m_s)
        period_s = task.settings.position_period_s
        for _ in range(math.ceil((least_m - task.tail_m) / full_m_s / period_s)):
            position = self.subpath.pose(reference.length_m).position_nea_m
            reference = advance(reference, self, period_s, position, goes_on=False)
        ends_m_s = ending_m_s(self.motion, length_m - reference.length_m)
        return replace(reference, speed_m_s=min(reference.speed_m_s, ends_m_s))

    def may_be_left(self, at: Reference) -> bool:
        """Whether a successor may take over there, in flight: it is far enough before the end.

        The certificate assumes a vehicle that can stop there, and a plane is sent to no point
        beyond it.  Else the leg is flown to its end, and the next begins at rest.
        """
        if not self.task.settings.profile.verified:
            return True
        left_m = self.subpath.length_m - at.length_m + _ROUNDING_M
        slows_m = max(slowing_m(self.motion, at.speed_m_s), self.motion.lead_m)
        return left_m >= slows_m and at.speed_m_s >= SLOWEST * self.motion.speed_m_s

    def wants_successor(self, reference: Reference, speed_m_s: float = 0.0) -> bool:
        """Whether to scan and plan for the next leg now: from p_scan on.

        Among near things as soon as enough of this one will be flown to be progress.
        speed_m_s: over ground.  A plane that the wind makes faster than V begins sooner: until the
        plan is there it comes the farther.
        """
        gains = max(speed_m_s / self.rules.limits.speed_m_s - 1.0, 0.0)
        sooner_m = gains * (self.rules.shortest_scan_distance_m - self.rules.tail_m)
        if self.reaches_target or reference.length_m + sooner_m < self.scan_at_m:
            return False
        p_prog, settings = self.leaves(reference), self.rules.settings
        least_m = SLACK * settings.scan_range_m if settings.is_near else 0.0
        return p_prog.length_m >= least_m and self.may_be_left(p_prog)

    @cached_property
    def leaving(self) -> Reference:
        """The reference point at p_prog, as asked for, or if that were done at its start, at V."""
        return self.p_prog or self.leaves(Reference(speed_m_s=self.motion.speed_m_s))

    @property
    def successor_at_m(self) -> float:
        """Length flown at p_prog."""
        return self.leaving.length_m

    @property
    def can_be_left(self) -> bool:
        """Whether a successor may take over in flight."""
        return self.may_be_left(self.leaving)

    @property
    def rest(self) -> Rest:
        """What is left of it beyond p_prog."""
        length_m, at = self.subpath.length_m, self.leaving
        end_nea_m = self.subpath.pose(length_m).point_nea_m
        return Rest(length_m=length_m - at.length_m, end_nea_m=end_nea_m, speed_m_s=at.speed_m_s)

    @property
    def past_target_m(self) -> float:
        """How far past its end, the target, a plane is sent: to that itself it would swerve aside.

        Left there, it circles a place so far from the last one that was proven: by as much less is
        it clear of terrain and zones, and still is no nearer than a dead-man stretch may come.
        """
        spare_m = self.task.required_clearance_m - self.motion.contact_m
        return min(_PAST_TARGET * self.task.limits.loiter_radius_m, max(spare_m, 0.0))

    # --- what bars the rest of it: what was proven stays proven, but for what is new or stricter

    def is_touched(self, from_m: float, task: Task) -> bool:
        """Whether it breaks, from a length on, a rule that is new: a zone, the floor, the ceiling.

        task: the rules now.
        """
        before = self.rules
        zones = tuple(zone for zone in task.zones if zone not in before.zones)
        was_low_m, was_high_m = before.limits.inner_band_amsl_m(before.error_m)
        low_m, high_m = task.limits.inner_band_amsl_m(task.error_m)
        lengths = np.linspace(from_m, self.subpath.length_m, _BAND_SAMPLES)
        heights = self.subpath.points_nea_m(lengths)[:, 2]
        too_low = low_m > was_low_m and heights.min() < low_m - _BAND_SLACK_M
        too_high = high_m < was_high_m and heights.max() > high_m + _BAND_SLACK_M
        return bool(too_low or too_high) or self.nears(zones, from_m, task.zone_clearance_m)

    def nears(self, zones: tuple[Zone, ...], from_m: float, required_m: float) -> bool:
        """Whether it comes nearer to a zone, from a length on, than it must keep, to 0.2 %.

        Looked at a leeway apart: between two samples nothing is nearer than half of that.
        """
        leeway_m, length_m = _LEEWAY * required_m + _LEEWAY_M, self.subpath.length_m
        count = math.ceil(max(length_m - from_m, 0.0) / leeway_m) + 1
        lengths = np.linspace(min(from_m, length_m), length_m, count)
        north, east, _ = self.subpath.points_nea_m(lengths).T
        told_m = gaps_m(zones, north, east, required_m)
        return bool((told_m < required_m - 0.5 * leeway_m).any())

    def meets(self, near: NearMap, from_m: float, required_m: float) -> bool:
        """Whether something stands nearer than required to the rest of it, seen from above.

        What is too near already may be left: a stop would be on the same path.  It must lead away,
        to where the distance is kept, within as much of the path.  Looked at every half cell: what
        lies between two points is nearer by less than 1/30 cell if required_m is a cell or more.
        """
        length_m = self.subpath.length_m
        steps = max(round(2.0 * (length_m - from_m) / near.lattice.cell_m), 1)
        lengths = np.linspace(from_m, length_m, steps + 1)
        apart_m = near.gaps_m(self.subpath.points_nea_m(lengths)[:, :2], required_m)
        kept = apart_m >= required_m
        left_at = int(np.argmax(kept)) if kept.any() else steps
        is_soon = lengths[left_at] - from_m <= required_m
        leads_away = is_soon and (apart_m[:left_at] >= apart_m[0]).all()
        return not (leads_away and kept[left_at:].all())


def hover_pose(position_nea_m: Vector | FloatArray, bearing_rad: float = 0.0) -> Pose:
    """The start pose of a vehicle at rest, level; in `flight` the plan chooses the tangent."""
    tangent = np.array([math.cos(bearing_rad), math.sin(bearing_rad), 0.0])
    return Pose(position_nea_m=np.asarray(position_nea_m), tangent_nea=tangent)


# --- of a copter


def advance(
    reference: Reference,
    leg: Leg,
    elapsed_s: float,
    vehicle_nea_m: FloatArray,
    *,
    goes_on: bool,
    until_m: float = math.inf,
    slows_to_m_s: float = math.inf,
) -> Reference:
    """Move the reference point: speed up, cruise at V, slow down for bends and the end of the leg.

    It is nowhere faster than the certificate takes it to be (`path.envelope`), gains speed the more
    slowly the farther behind the vehicle is, and waits if it is too far.  goes_on: the next leg is
    ready at the very end of this one, so there is no stop.  until_m: the length at which to stop,
    with all that the vehicle brakes with, if that is before the end.
    """
    at_m, speed, motion = reference.length_m, reference.speed_m_s, leg.motion
    pose, length_m = leg.subpath.pose(at_m), leg.subpath.length_m
    lead = float((pose.position_nea_m - vehicle_nea_m) @ pose.tangent_nea)
    if lead > motion.lag_m:
        return Reference(length_m=at_m, speed_m_s=0.0)
    slower, left_m = motion.braking_m_s2 * elapsed_s, max(min(length_m, until_m) - at_m, 0.0)
    paces_m_s = _paces_m_s(leg.subpath, motion)  # so as not to fly a bend ahead too fast
    k = int(min(max(at_m / length_m, 0.0), 1.0) * (len(paces_m_s) - 2))
    pace_m_s = float(min(paces_m_s[k], paces_m_s[k + 1]))
    allowed = min(pace_m_s, max(slows_to_m_s, speed - slower))
    if until_m < math.inf:
        allowed = min(allowed, slowed_m_s(left_m, motion.braking_m_s2, 0.0))
    if (until_m < math.inf or not goes_on) and at_m > leg.slows_at_m - _ROUNDING_M:
        allowed = min(allowed, ending_m_s(motion, length_m - at_m))
    gains = min(max(1.0 - lead / (_GAINS * motion.lag_m), 0.0), 1.0)
    faster = motion.gaining_m_s2 * elapsed_s * gains
    after = min(max(allowed, speed - 2.0 * slower), speed + faster)
    step = min(0.5 * (speed + after) * elapsed_s, left_m)
    return Reference(length_m=at_m + step, speed_m_s=after)


def entry_m_s(subpath: Subpath, motion: Envelope, *, stops: bool) -> float:
    """How fast a leg may be entered: by its first bends, and so that it can stop at its end."""
    pace_m_s = float(_paces_m_s(subpath, motion)[:2].min())
    can_stop = not stops or motion.loiter_m > 0.0
    return pace_m_s if can_stop else min(pace_m_s, ending_m_s(motion, subpath.length_m))


def entering_m_s(leg: Leg, before: Envelope, room_m: float) -> float:
    """How fast it may move so far before a leg, because of that.

    before: of the leg that it is still on.
    """
    pace_m_s = entry_m_s(leg.subpath, leg.motion, stops=not leg.through)
    return math.sqrt(pace_m_s**2 + 2.0 * before.gaining_m_s2 * max(room_m, 0.0))


def paced_s_m(subpath: Subpath, motion: Envelope) -> float:
    """How long it takes, seconds a metre in the mean."""
    return float((1.0 / _paces_m_s(subpath, motion)).mean())


@lru_cache(maxsize=4)
def _paces_m_s(subpath: Subpath, motion: Envelope) -> FloatArray:
    """V, or less where it climbs faster than the vehicle can, or bends, or soon does.  -> (N,)."""
    curve = subpath.sampled(subpath.length_m / _PACES)
    size = np.linalg.norm(curve.first, axis=-1)
    size = np.maximum(size, 1e-3 * subpath.length_m)  # where control points coincide it is 0
    around = np.cross(curve.first, curve.second)
    bends_1_m = np.linalg.norm(around, axis=-1) / size**3
    rises_1_m = np.abs(np.cross(around, curve.first)[:, 2]) / size**4  # of that, up and down
    steep = np.maximum(np.abs(curve.first[:, 2]) / size, 1e-9)
    most = np.minimum(motion.climb_rate_m_s / steep, motion.speed_m_s)
    turns = np.sqrt(motion.lateral_m_s2 / np.maximum(bends_1_m, 1e-12))
    rises = np.sqrt(motion.vertical_m_s2 / np.maximum(rises_1_m, 1e-12))
    turns = np.minimum(turns, rises)
    paces = np.minimum(most, np.maximum(turns, SLOWEST * motion.speed_m_s))
    gains = 2.0 * motion.gaining_m_s2 * subpath.length_m / (len(paces) - 1)
    for k in range(len(paces) - 2, -1, -1):
        paces[k] = min(paces[k], math.sqrt(paces[k + 1] ** 2 + gains))
    return np.asarray(paces)


def off_path_m(
    reference: Reference, leg: Leg, vehicle_nea_m: FloatArray, past_m: float = 0.0
) -> float:
    """Distance of the vehicle from the path near the reference point; beyond its end, from that.

    Before its start the path is taken to come straight from behind: another leg does.
    past_m: so far beyond its end it is taken to go straight on.
    """
    at_m, length_m = reference.length_m, leg.subpath.length_m
    for _ in range(_PROJECTIONS):
        pose = leg.subpath.pose(at_m)
        at_m += float((vehicle_nea_m - pose.position_nea_m) @ pose.tangent_nea)
        at_m = min(max(at_m, 0.0), length_m)
    pose = leg.subpath.pose(at_m)
    off = vehicle_nea_m - pose.position_nea_m
    along_m = float(off @ pose.tangent_nea)
    if at_m >= length_m:
        along_m = min(max(along_m, 0.0), past_m)
    return float(np.linalg.norm(off - along_m * pose.tangent_nea))


# --- of a plane


def follow(reference: Reference, leg: Leg, vehicle_nea_m: FloatArray) -> Reference:
    """Reference point of a plane: the nearest point of the path, seen from above.

    It never moves back, nor farther ahead than the plane can have flown, so that a path that comes
    near to itself is not short-cut.
    """
    limits = leg.task.limits
    window_m = max(_WINDOW_S * limits.speed_m_s, limits.turn_radius_m)
    until_m = min(reference.length_m + window_m, leg.subpath.length_m)
    lengths = np.linspace(reference.length_m, max(until_m, reference.length_m), _CHORDS + 1)
    points = leg.subpath.points_nea_m(lengths)[:, :2]
    steps, offset = np.diff(points, axis=0), vehicle_nea_m[:2] - points[:-1]
    squared = np.maximum((steps * steps).sum(axis=-1), 1e-12)
    share = np.clip((steps * offset).sum(axis=-1) / squared, 0.0, 1.0)
    k = int(np.argmin(np.linalg.norm(offset - share[:, None] * steps, axis=-1)))
    at_m = float(lengths[k] + share[k] * (lengths[k + 1] - lengths[k]))
    return Reference(length_m=at_m, speed_m_s=limits.speed_m_s)


def off_disc_m(centre_nea_m: Vector, position_nea_m: Vector, radius_m: float) -> float:
    """Distance from the level disc within a plane's circle, which is what is proven of it."""
    flat_m = math.dist(centre_nea_m[:2], position_nea_m[:2])
    return math.hypot(max(flat_m - radius_m, 0.0), position_nea_m[2] - centre_nea_m[2])


def is_on_circle(centre_nea_m: Vector, position_nea_m: Vector, limits: Limits) -> bool:
    """Whether a plane has reached its loiter circle, but for its tracking error."""
    off_m = off_disc_m(centre_nea_m, position_nea_m, limits.loiter_radius_m)
    return off_m <= limits.tracking_error_m


def may_leave(leg: Leg, at_m: float, position_nea_m: Vector, velocity_nea_m_s: Vector) -> bool:
    """Whether a plane that circles a point of a leg is on that circle and flies the leg's way.

    It does so once in each turn, and is then no farther aside than its circle: what it flies until
    it is on the path lies within the circles about the path's points, which are proven.
    """
    pose, (north, east, _) = leg.subpath.pose(at_m), velocity_nea_m_s
    ahead_n, ahead_e = pose.tangent_nea[:2].tolist()
    least = _LEAVES * math.hypot(ahead_n, ahead_e) * math.hypot(north, east)
    flies_along = north * ahead_n + east * ahead_e >= least > 0.0
    return flies_along and is_on_circle(pose.point_nea_m, position_nea_m, leg.task.limits)


# --- joining the path


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Offset:
    """What is added to the reference point's position and velocity, so that it does not jump.

    A companion that was restarted in flight, or has taken over, begins with the setpoint at the
    vehicle (or at its autopilot's target).  The offset then decays like a critically damped spring:
    as fast as half of the mission's acceleration allows.
    """

    position_nea_m: FloatArray  # (3,)
    velocity_nea_m_s: FloatArray  # (3,)

    @staticmethod
    def of(setpoint_nea_m: Vector, velocity_nea_m_s: Vector, pose: Pose, speed: float) -> "Offset":
        """That of a setpoint from a reference point that moves at a pose with a speed, m/s."""
        return Offset(
            position_nea_m=setpoint_nea_m - pose.position_nea_m,
            velocity_nea_m_s=velocity_nea_m_s - speed * pose.tangent_nea,
        )

    @property
    def is_gone(self) -> bool:
        """Whether it has decayed to almost nothing."""
        parts = self.position_nea_m, self.velocity_nea_m_s
        return all(float(np.linalg.norm(part)) < _GONE for part in parts)

    def after(self, elapsed_s: float, limits: Limits) -> "Offset":
        """One step later, at the fastest decay rate w whose acceleration is allowed.

        x = (x0 + c t) e^(-wt) with c = v0 + w x0 has an acceleration of at most w (|c| + |v0|), so
        of w^2 |x0| + 2 w |v0|.
        """
        position, velocity = self.position_nea_m, self.velocity_nea_m_s
        far, fast = float(np.linalg.norm(position)), float(np.linalg.norm(velocity))
        most = _SHARE * limits.acceleration_m_s2
        rate = most / (fast + math.sqrt(fast * fast + most * far) + 1e-12)
        rate = min(max(rate, _SLOWEST_1_S), _FASTEST_1_S)
        slope, left = velocity + rate * position, math.exp(-rate * elapsed_s)
        return Offset(
            position_nea_m=left * (position + elapsed_s * slope),
            velocity_nea_m_s=left * (velocity - rate * elapsed_s * slope),
        )
