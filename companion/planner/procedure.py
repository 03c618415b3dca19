"""The online procedure (paper 2.3, design section 6): legs, where to scan, and the reference point.

     leg k      start ------------- p_scan ----- p_prog ------ end
                                      <-------- L --------->
                                                    <- tail ->

The next leg starts at p_prog of this one.  A leg that has no successor is flown to its end, where
the vehicle stops: the tail is long enough for that.
"""

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from companion.geodesy import FloatArray
from companion.path.limits import Limits
from companion.path.subpath import Pose, Subpath
from companion.planner.request import Planned
from companion.planner.settings import Task

_LEAD_S = 1.0  # the reference point waits when it is this far ahead of the vehicle, at full speed
_ARRIVED_M = 0.5


@final
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Leg:
    """A subpath in flight."""

    number: int
    """Counted from 1."""
    plan_id: int
    subpath: Subpath
    reaches_target: bool

    @staticmethod
    def of(planned: Planned, number: int) -> "Leg":
        """The leg that a plan becomes."""
        return Leg(
            number=number,
            plan_id=planned.plan_id,
            subpath=planned.subpath,
            reaches_target=planned.reaches_target,
        )

    def scan_at_m(self, task: Task) -> float:
        """Length flown at p_scan: L before the end, or at once on a short leg."""
        return max(self.subpath.length_m - task.scan_distance_m, 0.0)

    def successor_at_m(self, task: Task) -> float:
        """Length flown at p_prog: the tail before the end."""
        earliest = self.scan_at_m(task) + task.shortest_scan_distance_m - task.tail_m
        return min(max(self.subpath.length_m - task.tail_m, earliest), self.subpath.length_m)

    def can_be_left(self, task: Task) -> bool:
        """Whether a successor may take over in flight.

        The certificate is about a vehicle that can always stop at the end; from a p_prog too near
        to the end it could not.  Such a leg is flown to its end, and the next begins at rest.
        """
        if not task.settings.profile.verified:
            return True
        left_m = self.subpath.length_m - self.successor_at_m(task)
        return left_m >= task.limits.stopping_m(task.limits.speed_m_s)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Reference:
    """The point of a leg where the vehicle ought to be."""

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
) -> Reference:
    """Move the reference point: speed up, cruise at V, slow down to stop at the end of the leg.

    It slows down with the mission's acceleration, harder where the path demands a lower speed,
    and waits for a vehicle that has fallen behind.  goes_on: the next leg is ready, so there
    is no stop at the end of this one.
    """
    pose = leg.subpath.pose(reference.length_m)
    allowed = allowed_speed_m_s(pose, limits)
    left = leg.subpath.length_m - reference.length_m
    if not goes_on:
        allowed = min(allowed, math.sqrt(2.0 * limits.acceleration_m_s2 * max(left, 0.0)))
    change = limits.acceleration_m_s2 * elapsed_s
    speed = min(max(allowed, reference.speed_m_s - 2.0 * change), reference.speed_m_s + change)
    lead = float((pose.position_nea_m - vehicle_nea_m) @ pose.tangent_nea)
    if lead > max(_LEAD_S * limits.speed_m_s, 2.0 * limits.tracking_error_m):
        return Reference(length_m=reference.length_m, speed_m_s=0.0)
    step = min(0.5 * (reference.speed_m_s + speed) * elapsed_s, left)
    return Reference(length_m=reference.length_m + step, speed_m_s=speed)


def off_path_m(reference: Reference, leg: Leg, vehicle_nea_m: FloatArray) -> float:
    """Distance of the vehicle from the path, across the tangent at the reference point."""
    pose = leg.subpath.pose(reference.length_m)
    offset = vehicle_nea_m - pose.position_nea_m
    return float(np.linalg.norm(offset - (offset @ pose.tangent_nea) * pose.tangent_nea))


def allowed_speed_m_s(pose: Pose, limits: Limits) -> float:
    """V, or less where the path climbs faster than the vehicle can."""
    steepness = abs(float(pose.tangent_nea[2]))
    return min(limits.speed_m_s, limits.climb_rate_m_s / max(steepness, 1e-9))


def is_at_end(reference: Reference, leg: Leg) -> bool:
    """Whether the reference point has come to the end of its leg."""
    return leg.subpath.length_m - reference.length_m < _ARRIVED_M


def hover_pose(position_nea_m: tuple[float, float, float]) -> Pose:
    """Where a vehicle at rest starts from; the tangent is chosen by the plan."""
    return Pose(position_nea_m=np.asarray(position_nea_m), tangent_nea=np.array([1.0, 0.0, 0.0]))
