"""The flights of `woods` through `companion.library`: no MAVLink, no simulator, perfect tracking.

Trees are drawn as the simulator draws them.  A rival flies a point that changes its velocity no
faster than the mission's acceleration, by the same sensor and map.
"""

import math
from typing import Any

import numpy as np
from woods_rivals import PILOTS

from companion.config import folder_of, load_mission, load_world
from companion.geodesy import FloatArray
from companion.library import NearScene, Thing
from companion.library import fly as fly_in_library
from companion.planner.offline import OnBoard
from vehicle_sim.world import read_world

_STEP_S = 0.1  # of the sensor: 10 Hz
_DECIDES_S = 0.2  # between decisions of a rival: the companion plans at 5 Hz, too
_AT_M, _LIMIT_S = 1.0, 600.0  # a rival has arrived; it never will


def scene_of(name: str, seed: int) -> NearScene:
    """What stands in a bundled world, with the trees of a seed, as the companion's own scene.

    Of that what a lidar sees at the lowest altitude of the mission.
    """
    world = read_world(folder_of(name) / "world.toml").with_woods_of(seed)
    floor_m = load_mission(name).task.limits.floor_amsl_m
    seen = [
        Thing(corners_ne_m=each.corners_ne_m, half_width_m=each.half_width_m, closed=each.closed)
        for each in world.scene(world.truth()).things
        if each.visible and each.top_amsl_m > floor_m
    ]
    return NearScene(seen, rate_hz=1.0 / _STEP_S)


def fly(name: str, pilot: str, seed: int) -> dict[str, Any]:
    """One flight: what came of it."""
    scene, holds, end = scene_of(name, seed), None, None
    if pilot in PILOTS:
        seconds, way = _by_rival(name, pilot, scene)
    else:
        flown = fly_in_library(name, name, scene=scene, seed=seed)
        way, seconds = flown.points_nea_m[:, :2], flown.seconds if flown.arrived else math.inf
        holds, end = flown.details.holds, flown.why or None
    return told(name, pilot, seed, way) | {
        "seconds": seconds,
        "holds": holds,
        "end": end,
        "nearest_m": float(scene.gaps_m(way).min()),
    }


def told(name: str, pilot: str, seed: int, way_ne_m: FloatArray) -> dict[str, Any]:
    """Whose flight it was, and how long it was."""
    return {
        "world": name,
        "pilot": pilot,
        "seed": seed,
        "flown_m": float(np.hypot(*np.diff(way_ne_m, axis=0).T).sum()),
        "straight_m": math.dist(way_ne_m[0], way_ne_m[-1]),
    }


def _by_rival(name: str, kind: str, scene: NearScene) -> tuple[float, FloatArray]:
    """How many seconds it took, inf if it did not arrive or touched something; and its way."""
    mission = load_mission(name)
    task, start = mission.task, load_world(name).start_ne_m
    assert mission.known is not None
    assert mission.near is not None
    on_board = OnBoard(mission.near, scene, task, mission.known)
    target, here, velocity = complex(*mission.targets_ne_m[0]), complex(*start), 0j
    range_m, limits = task.settings.scan_range_m, task.limits
    pilot = PILOTS[kind](on_board.near, target, task.required_clearance_m, range_m)
    on_board.look(start, 0.0, 0.0, seconds=2.0)
    way, seconds, aim = [here], 0.0, here
    while abs(here - target) >= _AT_M:
        pilot.look(on_board.near, here, range_m + 2.0)
        if round(seconds / _STEP_S) % round(_DECIDES_S / _STEP_S) == 0:
            aim = pilot.aim(here, velocity or target - here)
        away = aim - here
        speed_m_s = math.sqrt(limits.acceleration_m_s2 * abs(target - here))
        speed_m_s = min(limits.speed_m_s, speed_m_s, 2.0 * abs(away))
        change = speed_m_s * away / max(abs(away), 1e-6) - velocity
        most = limits.acceleration_m_s2 * _STEP_S
        velocity += change * min(most / max(abs(change), 1e-6), 1.0)
        here, seconds = here + velocity * _STEP_S, seconds + _STEP_S
        heading_rad = math.atan2(velocity.imag, velocity.real)
        on_board.look((here.real, here.imag), heading_rad, abs(velocity), seconds=_STEP_S)
        way.append(here)
        if seconds > _LIMIT_S or scene.gaps_m(np.array([[here.real, here.imag]]))[0] <= 0.0:
            seconds = math.inf
            break
    return seconds, np.stack([np.real(way), np.imag(way)], axis=-1)
