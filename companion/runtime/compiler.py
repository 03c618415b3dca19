"""Loads the planner's compiled kernel before it is waited for."""

import importlib
import shutil
from dataclasses import replace
from functools import cache

import numpy as np

from companion import jit
from companion.path.limits import Limits
from companion.planner.procedure import hover_pose
from companion.planner.request import PlanRequest
from companion.planner.settings import PlannerSettings, Task
from companion.planning import plan
from companion.profiles import FLIGHT, PAPER, Profile
from companion.world.known_map import empty_map
from companion.world.zones import PolygonZone


@cache
def load_kernel() -> None:
    """Compile all that a plan calls, or load it, by a small plan over flat ground.

    The first time it takes some ten seconds to compile; then it is loaded from a cache on disk.  If
    the cache cannot be written it is compiled each time; an unreadable one (after a power cut) is
    rebuilt.
    """
    load_libraries()
    try:
        _plan_over_flat_ground()
    except Exception:
        folder = jit.cache_on_disk()
        if folder is None or not any(folder.iterdir()):
            raise
        shutil.rmtree(folder, ignore_errors=True)
        jit.compiled.cache_clear()
        _plan_over_flat_ground()


def load_libraries() -> None:
    """What scipy loads when it is first asked for, in up to 0.5 s: before anybody waits for it."""
    for name in ("linalg", "ndimage"):
        importlib.import_module(f"scipy.{name}")


def load_proof() -> None:
    """Compile what proves a subpath: a process beside that of `load_kernel`, on another core.

    A plan of profile `paper` is proven by the same code, and searched by other code.
    """
    _plan_over_flat_ground(PAPER)


def _plan_over_flat_ground(profile: Profile = FLIGHT) -> None:
    side_m = (-2_000.0, 2_000.0)
    limits = Limits(
        speed_m_s=10.0, acceleration_m_s2=2.0, climb_rate_m_s=2.0, turn_radius_m=50.0,
        climb_angle_rad=0.2, dive_angle_rad=0.2, floor_amsl_m=100.0, ceiling_amsl_m=300.0,
        north_m=side_m, east_m=side_m,
    )  # fmt: skip
    settings = PlannerSettings(
        scan_range_m=1_000.0, safety_distance_m=20.0, planning_time_s=1.0, evaluations=200,
        profile=profile,
    )  # fmt: skip
    zone = PolygonZone(name="", vertices_ne_m=((900.0, 900.0), (900.0, 950.0), (950.0, 900.0)))
    task = Task(limits=limits, settings=settings, zones=(zone,))
    blank, start = empty_map(task.cell_m, side_m, side_m), hover_pose((0.0, 0.0, 150.0))
    known = replace(blank, upper_m=np.zeros_like(blank.upper_m))
    asked = PlanRequest(
        plan_id=1, seed=1, task=task, known=known, scan_nea_m=start.point_nea_m, start=start,
        from_rest=True, target_ne_m=(1_500.0, 0.0),
    )  # fmt: skip
    plan(asked)
