"""How vehicles that all cross one point keep apart, and keep clear of aircraft, with lost messages.

    scripts/bench crossing [--seeds 200] [--first 0] [--vehicles 2 4 8] [--lost 0.1] [--jobs 2]

Each vehicle has its own companion (`Session`, with the planner in process); its vehicle does what
it is told.  Between them go positions, heartbeats and claims, of which a share is lost and the
rest is up to 0.2 s late.  2, 4 and 8 of them fly along diameters of a circle, head-on pairs
included; one alone meets three aircraft that send ADSB_VEHICLE.  Distances are those of the true
positions, ten times a second; delays are against the same flight alone.  1 if a separation was
broken, or one of them has not arrived.
"""

import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import running
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as wire

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "runtime"))
from scripted_vehicle import GEOD, HOME_AMSL_M, PARAMETERS, Vehicle

from companion.mission.mission import Mission
from companion.planner.kernels import Kernel
from companion.planner.plan import plan
from companion.runtime.compiler import load_kernel
from companion.session import Session
from companion.sources.mission_file import mission_of
from companion.sources.mission_schema import MissionTable
from companion.sources.schema import validated

FloatArray = NDArray[np.float64]
_SHARED = frozenset({0, 33, 87})  # heartbeats, positions, claims
_LIMIT_S = 400.0
_START_M, _END_M = 150.0, 240.0
_AIRCRAFT = 3
SEPARATION_M, SEPARATION_UP_M = 10.0, 6.0
_TABLE: dict[str, Any] = {
    "schema": 1,
    "name": "crossing",
    "origin": {"latitude_deg": 47.0, "longitude_deg": 8.0},
    "area": {
        "north_min_m": -500.0,
        "north_max_m": 500.0,
        "east_min_m": -500.0,
        "east_max_m": 500.0,
    },
    "altitude": {"floor_amsl_m": HOME_AMSL_M + 30.0, "ceiling_amsl_m": HOME_AMSL_M + 150.0},
    "targets": [{"north_m": 1.0, "east_m": 1.0}],
    "vehicle": {
        "kind": "copter",
        "autopilot": "ardupilot",
        "scanner": False,
        "position_rate_hz": 5.0,
        "speed_m_s": 8.0,
        "acceleration_m_s2": 2.5,
        "climb_rate_m_s": 3.0,
        "turn_radius_m": 15.0,
        "climb_angle_deg": 20.0,
        "dive_angle_deg": 20.0,
        "tracking_error_m": 1.5,
        "navigation_error_m": 1.0,
        "dead_man_s": 3.5,
    },
    "planner": {
        "scan_range_m": 500.0,
        "safety_distance_m": 5.0,
        "planning_time_s": 1.0,
        "scan_time_s": 7.0,
        "evaluations": 600,
    },
    "terrain": {"highest_amsl_m": HOME_AMSL_M + 5.0},
    "traffic": {"separation_m": SEPARATION_M, "vertical_separation_m": SEPARATION_UP_M},
    "end": {"action": "hold"},
}


class Drone:
    """A vehicle and its companion."""

    def __init__(
        self, mission: Mission, system: int, start: FloatArray, kernel: Kernel, wait: int
    ) -> None:
        """wait: ticks until it is switched on."""
        self.system, self._kernel, self._wait = system, kernel, wait
        self.vehicle = Vehicle(lockstep=False)
        self.vehicle.autopilot.srcSystem = self.vehicle.radar.srcSystem = system
        self.vehicle.parameters = {**PARAMETERS, "SYSID_THISMAV": float(system)}
        self.vehicle.north_m, self.vehicle.east_m = start.tolist()
        self.session = Session(mission, seed=system, lockstep=False)
        self.due: list[tuple[int, bytes]] = []
        """What others have sent, and when it comes."""
        self.ended, self.outcome, self.arrived_s = False, "", math.inf
        self.texts: list[str] = []
        self._answers: list[Any] = []

    @property
    def is_up(self) -> bool:
        return bool(self.vehicle.landed == 2)

    def position(self) -> FloatArray:
        vehicle = self.vehicle
        return np.array([vehicle.north_m, vehicle.east_m, vehicle.altitude_m])

    def tick(self, tick: int) -> list[bytes]:
        """A tenth of a second: what others hear of it."""
        if tick <= self._wait:
            return []
        said, now_s = self.vehicle.tick(), tick * 0.1
        shared = [frame for frame in _frames(said) if frame[7] in _SHARED]
        heard = b"".join(frame for at, frame in self.due if at <= tick)
        self.due = [each for each in self.due if each[0] > tick]
        if self.ended:
            return shared
        for answer in self._answers:
            self.session.deliver(answer)
        self.session.receive(heard + said, now_s)
        out = self.session.run()
        self.texts += [f"{now_s:.1f} {e['text']}" for e in out.journal if e["kind"] == "say"]
        self._answers = [] if out.plan is None else [plan(out.plan, lambda: False, self._kernel)]
        frames = out.frames
        if out.end is not None and out.settled:
            self.ended, self.outcome = True, out.end.outcome.value
            if self.outcome == "arrived":
                self.arrived_s = now_s - 0.1 * self._wait
            frames = frames + self.session.farewell().frames
        self.vehicle.hear(b"".join(frames))
        return shared + [frame for frame in frames if frame[7] in _SHARED]


def _frames(data: bytes) -> Iterator[bytes]:
    """The frames in plain MAVLink 2."""
    at = 0
    while at < len(data):
        end = at + 12 + data[at + 1]
        yield data[at:end]
        at = end


class Aircraft:
    """Flies straight on, and says so once a second."""

    def __init__(self, rng: np.random.Generator, number: int) -> None:
        self.course_rad, self.speed_m_s = rng.uniform(0.0, math.tau), rng.uniform(15.0, 60.0)
        self._icao = 0x400000 + number
        meets_s, place = rng.uniform(25.0, 60.0), rng.uniform(-60.0, 60.0, 2)
        self._along = np.array([math.cos(self.course_rad), math.sin(self.course_rad)])
        self._start = place - meets_s * self.speed_m_s * self._along
        self._altitude_m = HOME_AMSL_M + rng.uniform(20.0, 200.0)
        self._codec = wire.MAVLink(None, srcSystem=1, srcComponent=wire.MAV_COMP_ID_ADSB)

    def position(self, now_s: float) -> FloatArray:
        place = self._start + now_s * self.speed_m_s * self._along
        return np.array([*place, self._altitude_m])

    def report(self, now_s: float) -> bytes:
        north, east, altitude_m = self.position(now_s)
        azimuth = math.degrees(math.atan2(east, north))
        longitude, latitude, _ = GEOD.fwd(8.0, 47.0, azimuth, math.hypot(north, east))
        frame: bytes = wire.MAVLink_adsb_vehicle_message(
            self._icao,
            round(latitude * 1e7),
            round(longitude * 1e7),
            wire.ADSB_ALTITUDE_TYPE_GEOMETRIC,
            round(altitude_m * 1e3),
            round(math.degrees(self.course_rad) * 100.0) % 36_000,
            round(self.speed_m_s * 100.0),
            0,
            b"TEST",
            0,
            1,
            0x9F,
            0,
        ).pack(self._codec)
        return frame


def fly(count: int, aircraft: int, lost: float, seed: int) -> dict[str, Any]:
    """One trial: least distances, arrivals, delays."""
    rng, kernel = np.random.default_rng(seed), _kernel()
    mission = mission_of(validated(MissionTable, _TABLE, "crossing"), None, "crossing")
    turn, drones = rng.uniform(0.0, math.tau), list[Drone]()
    for number, system in enumerate(rng.permutation(np.arange(1, count + 1)).tolist()):
        angle = turn + math.tau * number / count + rng.uniform(-0.1, 0.1)
        along = np.array([math.cos(angle), math.sin(angle)])
        north_m, east_m = (-_END_M * along).tolist()
        its = replace(mission, targets_ne_m=((north_m, east_m),), system_id=system)
        wait = int(rng.integers(0, 60)) if count > 1 else 0
        drones.append(Drone(its, system, _START_M * along, kernel, wait))
    planes = [Aircraft(rng, number) for number in range(aircraft)]
    nearest, tick = Nearest(), 0
    while tick < _LIMIT_S * 10 and not all(drone.ended for drone in drones):
        tick += 1
        now_s = tick * 0.1
        for number in rng.permutation(count).tolist():
            drone = drones[number]
            if tick % 10 == 0:
                drone.due += [(tick, p.report(now_s)) for p in planes if rng.random() >= lost]
            for frame in drone.tick(tick):
                for other in drones:
                    if other is not drone and rng.random() >= lost:
                        other.due.append((tick + int(rng.integers(0, 3)), frame))
        nearest.look(drones, planes, now_s)
    return {
        "seed": seed,
        "least_m": nearest.least_m,
        "kept": nearest.kept,
        "clear_m": nearest.clear_m,
        "arrived": sum(drone.outcome == "arrived" for drone in drones),
        "times_s": [round(drone.arrived_s, 1) for drone in drones],
        "texts": {drone.system: drone.texts for drone in drones},
    }


@dataclass
class Nearest:
    """How near they have come."""

    least_m: float = math.inf
    """Least distance between vehicles, all axes."""
    kept: float = math.inf
    """Least share of the separation that was kept, horizontally or vertically."""
    clear_m: float = math.inf
    """The same, to an aircraft."""

    def look(self, drones: list[Drone], planes: list[Aircraft], now_s: float) -> None:
        places = [each.position() for each in drones if each.is_up]
        for index, one in enumerate(places):
            for other in places[:index]:
                self.least_m = min(self.least_m, self._apart_m(one - other))
            for plane in planes:
                self.clear_m = min(self.clear_m, self._apart_m(one - plane.position(now_s)))

    def _apart_m(self, apart: FloatArray) -> float:
        level_m, up_m = math.hypot(apart[0], apart[1]), abs(float(apart[2]))
        self.kept = min(self.kept, max(level_m / SEPARATION_M, up_m / SEPARATION_UP_M))
        return math.hypot(level_m, up_m)


_KERNELS: list[Kernel] = []


def _kernel() -> Kernel:
    if not _KERNELS:
        _KERNELS.append(load_kernel())
    return _KERNELS[0]


def _row(found: list[dict[str, Any]], count: int, alone_s: float) -> list[str]:
    delays = np.array([each - alone_s for trial in found for each in trial["times_s"]])
    there = delays[np.isfinite(delays)]
    kept = [trial["kept"] for trial in found if math.isfinite(trial["kept"])]
    clear = [trial["clear_m"] for trial in found if math.isfinite(trial["clear_m"])]
    least = [trial["least_m"] for trial in found if math.isfinite(trial["least_m"])]
    return [
        f"{len(there)} of {count * len(found)}",
        f"{min(least):.1f}" if least else "",
        f"{min(kept):.2f}" if kept else "",
        f"{min(clear):.0f}" if clear else "",
        *(f"{np.percentile(there, share):.0f}" for share in (50, 95, 100)),
    ]


def main() -> int:
    options, console = running.begin(
        __doc__,
        seeds=200,
        lost=0.1,
        jobs=2,
        first=0,
        vehicles={"nargs": "*", "type": int, "default": [2, 4, 8]},
    )
    alone = [fly(1, 0, 0.0, seed)["times_s"][0] for seed in range(5)]
    alone_s = float(np.median(alone))
    cases = [(count, 0) for count in options.vehicles] + [(1, _AIRCRAFT)]
    seeds = range(options.first, options.first + options.seeds)
    todo = [(count, aircraft, options.lost, seed) for seed in seeds for count, aircraft in cases]
    found: dict[tuple[int, int], list[dict[str, Any]]] = {case: [] for case in cases}
    for (count, aircraft, _, _), future in running.in_processes(
        fly, todo, options.jobs, "flying", console
    ):
        found[count, aircraft].append(future.result())
    table = running.figures(
        f"{options.seeds} seeds, {options.lost:.0%} of messages lost; alone {alone_s:.0f} s",
        "vehicles",
        "arrived",
        "least m",
        "kept",
        "to aircraft m",
        "delay s 50 %",
        "95 %",
        "most",
    )
    for case, trials in found.items():
        name = f"{case[0]} and {case[1]} aircraft" if case[1] else f"{case[0]}"
        table.add_row(name, *_row(trials, case[0], alone_s))
    console.print(table)
    running.store(options.json, {str(case): trials for case, trials in found.items()})
    kept = all(
        trial["kept"] >= 1.0 and trial["arrived"] == case[0]
        for case, trials in found.items()
        for trial in trials
    )
    return running.ended(console, kept=kept)


if __name__ == "__main__":
    sys.exit(main())
