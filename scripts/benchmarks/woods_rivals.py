"""Two rivals for flights among near things, on the same map, lidar and simulated ArduCopter.

- `Bendy`: what ArduPilot's BendyRuler does (AC_Avoidance/AP_OABendyRuler, horizontal search): every
  5 degrees to either side of the target's bearing, the first that keeps the margin from what was
  seen over the look-ahead, and from its end on in one of three directions; it resists turning.
- `AStar`: the cheapest way over the cells of the map, and pure pursuit of it.

For both, what nobody has seen is free, as it is for them in the field.  Both keep from what stands
what our own vehicle has to keep, decide five times a second (BendyRuler itself once) and send
velocities 20 times a second.  The companion takes off for them, and then says nothing more.

A place is north + 1j east, in metres.
"""

import cmath
import math
from typing import Any, final

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as wire
from scipy.sparse import csr_array
from stepped import Flight

from companion.config import load_mission
from companion.geodesy import FloatArray
from companion.mavlink.near_scanner import NearScanner
from companion.mission.state import Phase
from companion.paper.rivals.roadmaps import EIGHT, cheapest, grid_edges
from companion.world.near_map import NearMap
from vehicle_sim.world import World

_DEAR = 20.0  # what a metre costs nearer than the clearance: A* would find no way out else
DECIDES_S, _SENDS_S, LIMIT_S, _TAKEN_OFF_S = 0.2, 0.05, 600.0, 90.0
AT_M, _SLOW_M_S = 1.0, 0.2
_LOOK_AHEAD_M, _RATIO, _RESISTS_RAD = 15.0, 1.5, math.radians(75.0)  # OA_BR_* as by default
_PAST_M = 2.0  # OA_BENDYRULER_LOOKAHEAD_PAST_DEST, and _STEP2_MIN
_ASIDE = [0.0, *(side * step for step in range(5, 175, 5) for side in (-1.0, 1.0))]
_PURSUES = 0.125  # of R, ahead of the vehicle on its way: 2 m in the forest
_VELOCITY = 0b110111000111  # POSITION_TARGET_TYPEMASK: all but the velocity is ignored


class Clearances:
    """How far the cells of a map are from what stands, up to some distance."""

    def __init__(self, near: NearMap, most_m: float) -> None:
        self.lattice, self._most_m = near.lattice, most_m
        self.away_m = np.full(near.lattice.shape, most_m)

    def look(self, near: NearMap, here: complex, reach_m: float) -> None:
        """The map may have changed within reach of a place."""
        point = np.array([[here.real, here.imag]])
        told = near.lattice.about(point, reach_m + self._most_m)
        wide = near.lattice.about(point, reach_m + 2.0 * self._most_m)
        stands = near.occupied(wide) & near.sharp[wide]
        away_m = np.full(stands.shape, np.inf)
        if stands.any():
            away_m = scipy.ndimage.distance_transform_edt(~stands) - 0.5
        rows, columns = (
            slice(a.start - b.start, a.stop - b.start) for a, b in zip(told, wide, strict=True)
        )
        self.away_m[told] = np.clip(away_m[rows, columns] * self.lattice.cell_m, 0.0, self._most_m)

    def margin_m(self, start: complex, end: complex) -> float:
        """The least along a straight line; off the map there is nothing."""
        lattice = self.lattice
        places = np.linspace(start, end, math.ceil(abs(end - start) / lattice.cell_m) + 2)
        row = np.floor((places.real - lattice.north_min_m) / lattice.cell_m).astype(int)
        column = np.floor((places.imag - lattice.east_min_m) / lattice.cell_m).astype(int)
        on = (row >= 0) & (row < lattice.shape[0]) & (column >= 0) & (column < lattice.shape[1])
        return float(self.away_m[row[on], column[on]].min(initial=self._most_m))


@final
class Bendy(Clearances):
    """ArduPilot's BendyRuler in the plane."""

    def __init__(self, near: NearMap, target: complex, margin_m: float, range_m: float) -> None:
        super().__init__(near, 4.0 * margin_m)
        self._target, self._required_m = target, margin_m
        self._ahead_m = self._farthest_m = min(_LOOK_AHEAD_M, range_m)
        self._before: complex | None = None

    def aim(self, here: complex, course: complex) -> complex:
        """Where to fly straight to.  course: the direction of flight, or of the nose."""
        offset, target = self._target - here, self._target
        self._ahead_m = min(max(self._ahead_m, 0.5 * self._farthest_m), self._farthest_m)
        first_m = min(self._ahead_m, abs(offset) + _PAST_M)
        found: list[tuple[float, complex]] = []
        for aside in _ASIDE:
            way = cmath.rect(1.0, cmath.phase(offset) + math.radians(aside))
            there = here + first_m * way
            margin_m = self.margin_m(here, there)
            found.append((margin_m, way))
            if margin_m <= self._required_m:
                continue
            second_m = min(max(self._ahead_m, _PAST_M), abs(target - there))
            for turn in (0.0, 0.25, -0.25):
                on = cmath.rect(second_m, cmath.phase(target - there) + turn * math.pi)
                if self.margin_m(there, there + on) > self._required_m:
                    self._ahead_m *= 1.1
                    if aside == turn == 0.0:
                        self._before = None
                    return here + min(abs(offset), first_m) * self._kept(
                        here, way, margin_m, first_m
                    )
        clear = [way for margin_m, way in found if margin_m > self._required_m]
        if clear:
            self._ahead_m *= 1.05
            return here + first_m * min(clear, key=lambda way: abs(cmath.phase(way / course)))
        self._ahead_m *= 0.9
        margin_m, way = max(found, key=lambda each: each[0])
        return here + max(first_m + margin_m - self._required_m, 0.0) * way

    def _kept(self, here: complex, way: complex, margin_m: float, first_m: float) -> complex:
        """The new direction, or the one before where the new one is a sharp turn for little."""
        before = self._before
        if before is not None and abs(cmath.phase(way / before)) > _RESISTS_RAD:
            before_m = self.margin_m(here, here + first_m * before)
            if margin_m < _RATIO * before_m:
                return before
        self._before = way
        return way


@final
class AStar(Clearances):
    """The cheapest way over the cells, planned anew each time; pure pursuit of it."""

    def __init__(self, near: NearMap, target: complex, margin_m: float, range_m: float) -> None:
        super().__init__(near, margin_m + near.lattice.cell_m)
        self._target, self._required_m, self._ahead_m = target, margin_m, _PURSUES * range_m

    def aim(self, here: complex, _course: complex) -> complex:
        """Where to fly straight to; here if there is no way."""
        lattice = self.lattice
        corner = complex(lattice.north_min_m, lattice.east_min_m)
        ends = np.array([here, self._target]) - corner
        cells = np.stack([ends.real, ends.imag], axis=-1) / lattice.cell_m
        start, end = np.clip(cells.astype(int), 0, np.array(lattice.shape) - 1)
        rate = np.where(self.away_m >= self._required_m, 1.0, _DEAR)
        way = a_star(np.where(self.away_m > 0.0, rate, np.inf), tuple(start), tuple(end))
        places = corner + (way @ np.array([1.0, 1.0j]) + 0.5 + 0.5j) * lattice.cell_m
        if not len(places):
            return here
        along_m = np.append(0.0, np.cumsum(np.abs(np.diff(places))))
        if along_m[-1] <= self._ahead_m:
            return self._target
        return complex(places[np.searchsorted(along_m, self._ahead_m)])


def a_star(rate: FloatArray, start: tuple[int, int], end: tuple[int, int]) -> NDArray[np.int64]:
    """The cheapest way over cells, eight neighbours each, (K, 2); none: there is no way.

    rate: of a cell, 1 or more; inf: not to be entered.  A step costs its length in cells times the
    mean of both; the start counts 1.
    """
    rate = rate.copy()
    rate[start] = 1.0
    before, after, cost = grid_edges(rate, 1, EIGHT)
    graph = csr_array((cost, (before, after)), shape=(rate.size, rate.size))
    way = cheapest(graph, *(row * rate.shape[1] + column for row, column in (start, end)))
    return np.stack(np.divmod(np.array(way, dtype=np.int64), rate.shape[1]), axis=-1)


@final
class _RivalFlight(Flight):
    """A companion that takes off, and then a rival in its place."""

    def __init__(self, name: str, world: World, seed: int, kind: type[Bendy | AStar]) -> None:
        super().__init__(load_mission(name), world, seed)
        task = self.mission.task
        self._limits, self._range_m = task.limits, task.settings.scan_range_m
        self._kind, self._margin_m = kind, task.required_clearance_m
        self.target = complex(*self.mission.targets_ne_m[0])
        self._scanner, self._pilot = NearScanner(self.mission), None
        self._ears, self._mouth = wire.MAVLink(None), wire.MAVLink(None, 1, 195)
        self._here, self._course, self._aim = None, 1.0 + 0.0j, None
        self._up_m = self._boot_s = self._decides_s = self._sends_s = 0.0

    def on(self, level_m: float) -> None:
        """One step with the rival at the controls."""
        self.simulation.step()
        for _, frame in self.simulation.take_frames():
            for message in self._ears.parse_buffer(frame) or ():
                self._hear(message)
        seen = None if self._here is None else self._scanner.seen(self._boot_s)
        if seen is not None:
            if self._pilot is None:
                self._pilot = self._kind(seen.near, self.target, self._margin_m, self._range_m)
            self._pilot.look(seen.near, self._here, self._range_m + 2.0)
        if self._pilot is not None and self.now_s >= self._decides_s:
            self._decides_s = self.now_s + DECIDES_S
            self._aim = self._pilot.aim(self._here, self._course)
        if self._here is not None and self.now_s >= self._sends_s:
            self._sends_s = self.now_s + _SENDS_S
            self._send(self._up_m - level_m)

    def _hear(self, message: Any) -> None:
        if message.get_msgId() != wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT:
            return self._scanner.on_message(message, self._boot_s)
        place = self.mission.frame.to_local_m(message.lat * 1e-7, message.lon * 1e-7)
        self._here, self._up_m = complex(*map(float, place)), message.alt * 1e-3
        self._boot_s = message.time_boot_ms * 1e-3
        course = complex(message.vx, message.vy) * 1e-2
        self._course = course if abs(course) > _SLOW_M_S else self._course
        self._scanner.on_position(self._boot_s, (self._here.real, self._here.imag, self._up_m))

    def _send(self, down_m_s: float) -> None:
        """A velocity to where it aims, slower near where it has to stop."""
        away = (self._here if self._aim is None else self._aim) - self._here
        left_m = abs(away if self._kind is Bendy else self.target - self._here)
        speed_m_s = math.sqrt(self._limits.acceleration_m_s2 * left_m)
        speed_m_s = min(self._limits.speed_m_s, speed_m_s, 2.0 * abs(away))
        velocity = speed_m_s * away / max(abs(away), 1e-6)
        message = wire.MAVLink_set_position_target_local_ned_message(
            round(self._boot_s * 1e3), 1, 1, wire.MAV_FRAME_LOCAL_NED, _VELOCITY,
            *[0.0] * 3, velocity.real, velocity.imag, down_m_s, *[0.0] * 5,
        )  # fmt: skip
        self.simulation.receive(0, message.pack(self._mouth))


def fly(name: str, world: World, seed: int, kind: type[Bendy | AStar]) -> tuple[float, FloatArray]:
    """One flight: how many seconds it took, inf if it did not arrive; and where it truly was."""
    it = _RivalFlight(name, world, seed, kind)
    while it.phase is not Phase.FLYING:
        it.step()
        assert it.now_s < _TAKEN_OFF_S, it.phase
    began_s, track = it.now_s, [it.simulation.place_nea_m()]
    while it.now_s < began_s + LIMIT_S and it.simulation.nearest_m > 0.0:
        it.on(track[0][2])
        track.append(it.simulation.place_nea_m())
        if abs(complex(*track[-1][:2]) - it.target) < AT_M:
            return it.now_s - began_s, np.array(track)
    return math.inf, np.array(track)
