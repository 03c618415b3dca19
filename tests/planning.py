"""What tests of curves, costs and plans begin with."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from companion.path.limits import Limits
from companion.planner.procedure import hover_pose
from companion.planner.request import PlanRequest
from companion.planner.settings import Task
from companion.world.known_map import KnownMap

FloatArray = NDArray[np.float64]

_COPTER = Limits(
    speed_m_s=15.0,
    acceleration_m_s2=3.0,
    climb_rate_m_s=4.0,
    turn_radius_m=150.0,
    climb_angle_rad=0.2,
    dive_angle_rad=0.2,
    floor_amsl_m=300.0,
    ceiling_amsl_m=700.0,
    north_m=(0.0, 8_000.0),
    east_m=(0.0, 8_000.0),
    tracking_error_m=5.0,
)


def limits(**changes: Any) -> Limits:
    """A copter of 15 m/s on 8 km x 8 km between 300 and 700 m, but for some changes."""
    return replace(_COPTER, **changes)


def ask(
    task: Task, known: KnownMap, start_nea_m: tuple[float, float, float], **changes: Any
) -> PlanRequest:
    """The question of a vehicle that hovers where it scans."""
    request = PlanRequest(
        plan_id=1,
        seed=7,
        task=task,
        known=known,
        scan_nea_m=start_nea_m,
        start=hover_pose(start_nea_m),
        from_rest=True,
        target_ne_m=(7_500.0, 7_500.0),
    )
    return replace(request, **changes)


def spline(control_nea_m: FloatArray) -> Any:
    """The clamped cubic B-spline with uniform inner knots, by scipy.  (points, 3)."""
    spans = len(control_nea_m) - 3
    knots = np.concatenate([np.zeros(3), np.linspace(0.0, 1.0, spans + 1), np.ones(3)])
    return BSpline(knots, control_nea_m, 3)
