"""Fly the bundled lidar missions among trees drawn anew: arrivals, clearance, time, holds.

    scripts/bench woods [--flights 50] [--first 201] [--world forest] [--simulated] [--json FILE]

Seed k draws the trees of `forest` and the lidar's noise; the houses of `street` stay.  The
companion flies a point in `companion.library`, or, simulated, the ArduCopter of the simulator, ten
times as slowly.  Its rival is A* over the cells of the same map by the same lidar, with pure
pursuit: a point that changes its velocity no faster than the mission's acceleration, and for which
what nobody has seen is free, as it is in the field; it keeps from what stands what the companion
has to keep.  Distances are true ones, to all things there are.  Held: not arrived, nothing touched.
A place is north + 1j east, in metres.
"""

import heapq
import math
from itertools import product
from typing import Any, Literal, final

import numba
import numpy as np
import scipy.ndimage
from numpy.typing import NDArray
from running import Bar, Found, in_processes, least, main, most
from stepped import Flight

from companion.config import folder_of, load_mission, load_world
from companion.geodesy import FloatArray
from companion.library import NearScene, Thing
from companion.library import fly as fly_in_library
from companion.mission.state import Phase
from companion.planner.offline import OnBoard
from companion.world.near_map import NearMap
from vehicle_sim.world import read_world

COMPANION, RIVAL = "companion", "A*"
_BAR = 1.1  # of the rival's seconds, medians
_DEAR = 20.0  # what a metre costs nearer than the clearance: A* would find no way out else
_PURSUES = 0.125  # of R, ahead of the vehicle on its way: 2 m in the forest
_STEP_S = 0.1  # of the sensor: 10 Hz
_DECIDES_S = 0.2  # between decisions of the rival: the companion plans at 5 Hz, too
_AT_M = 1.0  # the rival has arrived
_LIMIT_S = 900.0
_STEPS = tuple((i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j)  # to the neighbours


@final
class AStar:
    """The cheapest way over the cells, planned anew each time; pure pursuit of it."""

    def __init__(self, near: NearMap, target: complex, margin_m: float, range_m: float) -> None:
        self.lattice, self._target, self._required_m = near.lattice, target, margin_m
        self._most_m, self._ahead_m = margin_m + near.lattice.cell_m, _PURSUES * range_m
        self.away_m = np.full(near.lattice.shape, self._most_m)
        """How far the cells are from what stands, up to some distance."""

    def look(self, near: NearMap, place: complex, reach_m: float) -> None:
        """The map may have changed within reach of a place."""
        point = np.array([[place.real, place.imag]])
        changed = near.lattice.about(point, reach_m + self._most_m)
        wide = near.lattice.about(point, reach_m + 2.0 * self._most_m)
        stands = near.occupied(wide) & near.sharp[wide]
        away_m = np.full(stands.shape, np.inf)
        if stands.any():
            away_m = scipy.ndimage.distance_transform_edt(~stands) - 0.5
        rows, columns = (
            slice(a.start - b.start, a.stop - b.start) for a, b in zip(changed, wide, strict=True)
        )
        self.away_m[changed] = np.clip(
            away_m[rows, columns] * self.lattice.cell_m, 0.0, self._most_m
        )

    def aim(self, place: complex) -> complex:
        """Where to fly straight to; the place itself if there is no way."""
        lattice = self.lattice
        corner = complex(lattice.north_min_m, lattice.east_min_m)
        ends = np.array([place, self._target]) - corner
        cells = np.stack([ends.real, ends.imag], axis=-1) / lattice.cell_m
        start, end = np.clip(cells.astype(int), 0, np.array(lattice.shape) - 1)
        rate = np.where(self.away_m >= self._required_m, 1.0, _DEAR)
        way = a_star(np.where(self.away_m > 0.0, rate, np.inf), tuple(start), tuple(end))
        places = corner + (way @ np.array([1.0, 1.0j]) + 0.5 + 0.5j) * lattice.cell_m
        if not len(places):
            return place
        along_m = np.append(0.0, np.cumsum(np.abs(np.diff(places))))
        if along_m[-1] <= self._ahead_m:
            return self._target
        return complex(places[np.searchsorted(along_m, self._ahead_m)])


@numba.njit
def a_star(rate: FloatArray, start: tuple[int, int], end: tuple[int, int]) -> NDArray[np.int64]:
    """The cheapest way over cells, eight neighbours each, (K, 2); none: there is no way.

    rate: of a cell, 1 or more; inf: not to be entered.  A step costs its length in cells times the
    mean of both; the start counts 1.
    """
    rate = rate.copy()
    rate[start] = 1.0
    cost, before = np.full(rate.shape, np.inf), np.full((*rate.shape, 2), -1)
    cost[start] = 0.0
    ahead = [(0.0, start)]
    while ahead:
        _, (row, column) = heapq.heappop(ahead)
        if (row, column) == end:
            break
        for north, east in _STEPS:
            i, j = row + north, column + east
            if 0 <= i < rate.shape[0] and 0 <= j < rate.shape[1]:
                step = math.sqrt(north * north + east * east)
                by_it = cost[row, column] + step * 0.5 * (rate[row, column] + rate[i, j])
                if by_it < cost[i, j]:
                    cost[i, j], before[i, j] = by_it, (row, column)
                    far, near = abs(end[0] - i), abs(end[1] - j)
                    least = max(far, near) + (math.sqrt(2.0) - 1.0) * min(far, near)
                    heapq.heappush(ahead, (by_it + least, (i, j)))
    way = [end]
    while before[way[-1]][0] >= 0:
        way.append((before[way[-1]][0], before[way[-1]][1]))
    return np.array(way[::-1]) if way[-1] == start else np.empty((0, 2), dtype=np.int64)


def scene_of(name: str, seed: int) -> NearScene:
    """What stands in a bundled world, with the trees of a seed, as the companion's own scene.

    Of that what a lidar sees at the lowest altitude of the mission.
    """
    world = read_world(folder_of(name) / "world.toml").with_woods_of(seed)
    ground_m = world.terrain.ground_amsl_m or 0.0
    floor_m = load_mission(name).task.limits.floor_amsl_m - ground_m
    seen = [
        Thing(corners_ne_m=thing.corners_ne_m, half_width_m=thing.half_width_m, closed=thing.closed)
        for thing in world.scene().things
        if thing.height_m > floor_m and math.isinf(thing.hangs_m)
    ]
    return NearScene(seen, rate_hz=1.0 / _STEP_S)


def fly(name: str, pilot: str, seed: int, simulated: bool = False) -> dict[str, Any]:
    """One flight: what came of it."""
    scene, holds, end = scene_of(name, seed), None, None
    if pilot == RIVAL:
        seconds, way = _by_rival(name, scene)
        nearest_m = float(scene.gaps_m(way).min())
    elif simulated:
        seconds, way, nearest_m, holds, end = _on_simulator(name, seed)
    else:
        flown = fly_in_library(name, name, scene=scene, seed=seed)
        way, seconds = flown.points_nea_m[:, :2], flown.seconds if flown.arrived else math.inf
        nearest_m = float(scene.gaps_m(way).min())
        holds, end = flown.details.holds, flown.why or None
    return {
        "world": name,
        "pilot": pilot,
        "seed": seed,
        "seconds": seconds,
        "flown_m": float(np.hypot(*np.diff(way, axis=0).T).sum()),
        "straight_m": math.dist(way[0], way[-1]),
        "nearest_m": nearest_m,
        "holds": holds,
        "end": end,
    }


def _on_simulator(name: str, seed: int) -> tuple[float, FloatArray, float, int, str | None]:
    """Seconds, inf if it did not arrive; its way, its least distance, its holds and its reason."""
    world = read_world(folder_of(name) / "world.toml").with_woods_of(seed)
    it, phases = Flight(load_mission(name), world, seed), [Phase.WAITING]
    began_s, track = math.inf, list[tuple[float, float, float]]()
    while not it.is_over and it.now_s < _LIMIT_S:
        it.step()
        if it.phase is not phases[-1]:
            phases.append(it.phase)
        if track or it.phase is Phase.FLYING:
            track.append(it.simulation.contact.place_nea_m())
            began_s = min(began_s, it.now_s)
    way, reason = np.array(track), it.session.state.reason
    seconds = it.now_s - began_s if it.phase is Phase.ARRIVED else math.inf
    end = reason.text if reason is not None and seconds == math.inf else None
    nearest_m = float(world.scene().distance_m(way).min())
    return seconds, way[:, :2], nearest_m, phases.count(Phase.HOLDING), end


def _by_rival(name: str, scene: NearScene) -> tuple[float, FloatArray]:
    """How many seconds it took, inf if it did not arrive or touched something; and its way."""
    mission = load_mission(name)
    task, start = mission.task, load_world(name).start_ne_m
    assert mission.known is not None
    assert mission.near is not None
    on_board = OnBoard(mission.near, scene, task, mission.known)
    target, place, velocity = complex(*mission.targets_ne_m[0]), complex(*start), 0j
    range_m, limits = task.settings.scan_range_m, task.limits
    pilot = AStar(on_board.near, target, task.required_clearance_m, range_m)
    on_board.look(start, 0.0, 0.0, seconds=2.0)
    way, seconds, aim = [place], 0.0, place
    while abs(place - target) >= _AT_M:
        pilot.look(on_board.near, place, range_m + 2.0)
        if round(seconds / _STEP_S) % round(_DECIDES_S / _STEP_S) == 0:
            aim = pilot.aim(place)
        away = aim - place
        speed_m_s = math.sqrt(limits.acceleration_m_s2 * abs(target - place))
        speed_m_s = min(limits.speed_m_s, speed_m_s, 2.0 * abs(away))
        change = speed_m_s * away / max(abs(away), 1e-6) - velocity
        velocity += change * min(limits.acceleration_m_s2 * _STEP_S / max(abs(change), 1e-6), 1.0)
        place, seconds = place + velocity * _STEP_S, seconds + _STEP_S
        heading_rad = math.atan2(velocity.imag, velocity.real)
        on_board.look((place.real, place.imag), heading_rad, abs(velocity), seconds=_STEP_S)
        way.append(place)
        if seconds > _LIMIT_S or scene.gaps_m(np.array([[place.real, place.imag]]))[0] <= 0.0:
            seconds = math.inf
            break
    return seconds, np.stack([np.real(way), np.imag(way)], axis=-1)


def woods(
    flights: int = 10,
    first: int = 1,
    jobs: int = 2,
    world: Literal["both", "forest", "street", "posts"] = "both",
    simulated: bool = False,
) -> Found:
    """Fly them; the companion is held: not too near, not much slower, no silent end."""
    worlds = ("forest", "street") if world == "both" else (world,)
    seeds, bars = range(first, first + flights), list[Bar]()
    todo = [*product(worlds, (COMPANION, RIVAL), seeds, (simulated,))]
    flown = [*in_processes(fly, todo, jobs)]
    median_s = dict[tuple[str, str], float]()
    for name, who in product(worlds, (COMPANION, RIVAL)):
        mine = [flight for flight in flown if (flight["world"], flight["pilot"]) == (name, who)]
        arrived = [flight for flight in mine if flight["seconds"] < math.inf]
        lost = [flight for flight in mine if flight["seconds"] == math.inf]
        nearest_m = min(flight["nearest_m"] for flight in mine)
        median_s[name, who] = _middle(flight["seconds"] for flight in arrived)
        yield {
            "among near things": f"{name}, {who}",
            "arrived": f"{len(arrived)} of {len(mine)}",
            "held": sum(flight["nearest_m"] > 0.0 for flight in lost),
            "touched": sum(flight["nearest_m"] <= 0.0 for flight in mine),
            "least, m|.2f": nearest_m,
            "flown / straight|.2f": _middle(e["flown_m"] / e["straight_m"] for e in arrived),
            "m/s|.2f": _middle(flight["flown_m"] / flight["seconds"] for flight in arrived),
            "s|.0f": median_s[name, who],
            "holds|.0f": _middle(e["holds"] for e in mine if e["holds"] is not None),
            "why": "; ".join(
                f"{flight['seed']}: {flight['end']}" for flight in mine if flight["end"]
            ),
        }
        if who == COMPANION:
            safety_m = load_mission(name).task.settings.safety_distance_m
            bars.append(least(f"{name}: least distance, m", nearest_m, safety_m))
            bars.append(least(f"{name}: arrived", len(arrived), len(mine)))
            silent = sum(not flight["end"] for flight in lost)
            bars.append(most(f"{name}: ended without a reason", silent, 0))
    yield flown
    yield from bars
    for name in worlds:
        ratio = median_s[name, COMPANION] / median_s[name, RIVAL]
        yield most(f"{name}: seconds, of those of A*", ratio, _BAR)


def _middle(values: Any) -> float:
    return float(np.median([*values] or [math.nan]))


if __name__ == "__main__":
    main(woods)
