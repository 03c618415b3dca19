"""The companion dies at every second of a flight: does the vehicle stay within what was proven?

    scripts/bench kills [--kills 10000] [--scale forest] [--autopilot ardupilot] [--json FILE]

The stream of setpoints ends, and a copy of the simulation flies on until the vehicle stands (a
plane: until it has gone round).  Where it truly is must lie within what the certificates of its leg
and of the leg before speak of: a tube of tracking and navigation error about the curve and about
each straight stretch that the companion's end may lead to; of a plane, about the loiter circles of
the curve's points.  Companion and simulator without sockets, by the bundled missions and, for
planes, drawn worlds; noise and latency as bundled, and wind.
"""

import math
import os
import pickle
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, final

import numpy as np
import running
from numpy.typing import NDArray

from companion.campaign import drawn_files, families
from companion.config import folder_of, load_mission
from companion.mavlink.autopilots import named
from companion.mission.mission import Mission
from companion.mission.state import OVER, Phase
from companion.path.envelope import ending_m_s, flown_on_m, rising_m_s
from companion.planner.plan import plan
from companion.planner.procedure import Leg
from companion.planner.request import Planned, PlanRequest
from companion.planner.settings import Task
from companion.session import Session
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import World, read_world

FloatArray = NDArray[np.float64]
COPTERS: Final = ("forest", "street", "posts", "valley", "environment-1")
PLANES: Final = ("plane", "short-plane")
"""Families of drawn worlds (`campaign.families`)."""
AUTOPILOTS: Final = ("ardupilot", "px4")
_WIND: Final = {
    "forest": "at 1 s: wind 2 m/s from 250 deg turbulence 0.5",
    "posts": "at 1 s: wind 2 m/s from 250 deg turbulence 0.5",
    "street": "at 1 s: wind 3 m/s from 250 deg turbulence 0.5",
    "valley": "at 1 s: wind 4 m/s from 250 deg turbulence 1",
    "environment-1": "at 1 s: wind 8 m/s from 250 deg turbulence 2",
    "plane": "at 1 s: wind 5 m/s from 250 deg turbulence 1",
    "short-plane": "at 1 s: wind 3 m/s from 250 deg turbulence 1",
}
_EVERY_S = 1.0
_ROUND_S = 70.0  # a plane: into its circle and round it
_STANDS_M_S, _STANDS_FOR_S = 0.25, 1.5
_SAMPLES = 400  # of a leg
_LIMIT_S = 1_500.0


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Proven:
    """What the certificates of a leg speak of, sampled."""

    points_nea_m: FloatArray
    """(N, 3): along the curve."""
    reaches_nea_m: FloatArray
    """(N, 3): from each to the end of the stretch that begins there."""
    circle_m: float
    """Of a plane: radius of the circle about each point."""
    error_m: float
    """Tracking and navigation error."""

    def outside_m(self, track_nea_m: FloatArray) -> FloatArray:
        """How far each place is outside.  (M, 3) -> (M,); negative: inside."""
        if self.circle_m > 0.0:
            off = track_nea_m[:, None] - self.points_nea_m
            flat = np.hypot(off[..., 0], off[..., 1])
            gaps = np.hypot(np.maximum(flat - self.circle_m, 0.0), off[..., 2])
            return np.asarray(gaps.min(axis=1) - self.error_m)
        starts = np.concatenate([self.points_nea_m[:-1], self.points_nea_m])
        steps = np.concatenate([np.diff(self.points_nea_m, axis=0), self.reaches_nea_m])
        off = track_nea_m[:, None] - starts
        squared = np.maximum((steps * steps).sum(axis=-1), 1e-12)
        share = np.clip((off * steps).sum(axis=-1) / squared, 0.0, 1.0)
        off -= share[..., None] * steps
        return np.asarray(np.sqrt((off * off).sum(axis=-1)).min(axis=1) - self.error_m)


def proven(leg: Leg, task: Task, *, from_rest: bool) -> Proven:
    """What the certificate of a leg speaks of."""
    motion, length_m = task.envelope, leg.subpath.length_m
    at_m = np.linspace(0.0, length_m, _SAMPLES)
    points = leg.subpath.points_nea_m(at_m)
    reaches = np.zeros_like(points)
    if motion.loiter_m == 0.0:
        for k, here_m in enumerate(at_m):
            left_m = length_m - here_m
            speed = ending_m_s(motion, left_m)
            if from_rest:
                speed = min(speed, rising_m_s(motion, here_m))
            reaches[k] = flown_on_m(motion, speed) * leg.subpath.pose(float(here_m)).tangent_nea
    return Proven(
        points_nea_m=points,
        reaches_nea_m=reaches,
        circle_m=motion.loiter_m,
        error_m=motion.error_m,
    )


class Flight:
    """One flight in this process, in lockstep."""

    def __init__(self, mission: Mission, world: World, seed: int, faults: str = "") -> None:
        self.mission, self.now_s = mission, 0.0
        self.session = Session(mission, seed=seed, lockstep=True)
        self.simulation = Simulation(world, seed=seed, faults=faults)
        self._asked: PlanRequest | None = None
        self._from_rest: dict[int, bool] = {}
        self._legs: list[Leg] = []

    def step(self) -> None:
        """One step of the simulator, and all that the companion says to it."""
        self.simulation.step()
        self.now_s = self.simulation.now_us * 1e-6
        for _, frame in self.simulation.take_frames():
            self.session.receive(frame, self.now_s)
            out = self.session.run()
            while True:
                self._asked = out.plan or self._asked
                for sent in out.frames:
                    self.simulation.receive(0, sent)
                if not out.awaits_plan:
                    break
                assert self._asked is not None
                found = plan(self._asked)
                if isinstance(found, Planned):
                    self._from_rest[found.plan_id] = self._asked.from_rest
                self.session.deliver(found)
                out = self.session.run()
        leg = self.session.state.flight.leg
        if leg is not None and (not self._legs or self._legs[-1] is not leg):
            self._legs = [*self._legs[-1:], leg]

    @property
    def phase(self) -> Phase:
        return self.session.state.phase

    @property
    def is_over(self) -> bool:
        return self.phase in (Phase.ARRIVED, *OVER) or self.now_s > _LIMIT_S

    def may_be_killed(self) -> bool:
        """Whether it flies a leg."""
        return self.phase is Phase.FLYING and self.session.state.flight.leg is not None

    def killed(self) -> dict[str, Any]:
        """What comes of it in a copy without a companion."""
        read, write = os.pipe()
        child = os.fork()
        if child == 0:
            try:
                os.close(read)
                with os.fdopen(write, "wb") as pipe:
                    pickle.dump(self._flies_on(), pipe)
            finally:
                os._exit(0)
        os.close(write)
        with os.fdopen(read, "rb") as pipe:
            told = pipe.read()
        os.waitpid(child, 0)
        found: dict[str, Any] = pickle.loads(told)
        return found

    def _flies_on(self) -> dict[str, Any]:
        """Without a companion, and how far that leads out of what was proven."""
        simulation, task = self.simulation, self.mission.task
        hovers, began_us = task.limits.hovers, simulation.now_us
        flight, vehicle = self.session.state.flight, simulation.vehicle
        simulation._lidars, simulation._scanner = [], None
        track, stood_s = [simulation._place_nea_m()], 0.0
        begin_m_s = math.hypot(vehicle.velocity_north_m_s, vehicle.velocity_east_m_s)
        limits = task.limits
        longest_s = limits.dead_man_s + 2.0 * limits.speed_m_s / limits.acceleration_m_s2 + 4.0
        longest_s = longest_s if hovers else _ROUND_S
        while simulation.now_us - began_us < 1e6 * longest_s:
            simulation.step()
            simulation.take_frames()
            speed = math.hypot(vehicle.velocity_north_m_s, vehicle.velocity_east_m_s)
            stood_s = stood_s + 0.01 if speed < _STANDS_M_S else 0.0
            track.append(simulation._place_nea_m())
            if hovers and stood_s > _STANDS_FOR_S:
                break
        where = np.array(track[:: max(len(track) // 400, 1)])
        outside = np.full(len(where), math.inf)
        for leg in self._legs:
            from_rest = self._from_rest.get(leg.plan_id, False)
            told = proven(leg, leg.rules or task, from_rest=from_rest)
            outside = np.minimum(outside, told.outside_m(where))
        k = int(np.argmax(outside))
        leg, reference = self._legs[-1], flight.reference
        return {
            "at_s": self.now_s,
            "outside_m": float(outside[k]),
            "estimate_m": float(np.linalg.norm(np.array(self.session.state.vehicle.position_nea_m) - where[0])),
            "at_once_m": float(outside[0]),
            "speed_m_s": begin_m_s,
            "reference_m_s": reference.speed_m_s,
            "at_m": reference.length_m,
            "left_m": leg.subpath.length_m - reference.length_m,
            "flown_m": float(np.linalg.norm(where[-1] - where[0])),
            "aside": flight.offset is not None,
            "stops": flight.stop is not None,
            "stands": stood_s > _STANDS_FOR_S,
            "k": k/len(where),
            "off": self._off(where[k]),
        }


    def _off(self, p):
        best=None
        for leg in self._legs:
            L=leg.subpath.length_m
            ls=np.linspace(0,L,2000); pts=leg.subpath.points_nea_m(ls)
            j=int(np.argmin(np.linalg.norm(pts-p,axis=1))); d=float(np.linalg.norm(pts[j]-p))
            if best is None or d<best[0]:
                t=leg.subpath.pose(float(ls[j])).tangent_nea; o=p-pts[j]
                best=(d,leg.number,round(float(ls[j]),2),round(float(L-ls[j]),2),"along %.2f up %.2f"%(float(o@t),float(o[2])))
        return best


def setting(scale: str, autopilot: str, seed: int) -> tuple[Mission, World, str]:
    """Mission, world and faults of one flight."""
    if scale in PLANES:
        drawn = families.world(scale, 41, seed)
        with tempfile.TemporaryDirectory() as folder:
            files = drawn_files.write(drawn, Path(folder), autopilot)  # type: ignore[arg-type]
            return load_mission(str(files[1])), read_world(files[0]), _WIND.get(scale, "")
    mission, world = load_mission(scale), read_world(folder_of(scale) / "world.toml")
    world = world.with_woods_of(seed)
    if autopilot != world.vehicle.autopilot:
        strategy = named(autopilot, "copter")  # type: ignore[arg-type]
        parameters = strategy.firmware.lasting_battery | strategy.parameters_for(mission.task.limits)
        limits = mission.task.limits
        parameters |= {"MPC_ACC_HOR": limits.acceleration_m_s2, "MPC_JERK_AUTO": 4.0 * limits.acceleration_m_s2,
            "COM_OF_LOSS_T": math.floor(10.0 * (limits.dead_man_s - 0.51)) / 10.0}
        vehicle = replace(world.vehicle, autopilot=autopilot, parameters=parameters)  # type: ignore[arg-type]
        limits = replace(limits, navigation_error_m=max(limits.navigation_error_m, 0.5))
        mission = replace(mission, autopilot=autopilot, task=replace(mission.task, limits=limits))  # type: ignore[arg-type]
        world = replace(world, vehicle=vehicle)
    return mission, world, _WIND.get(scale, "")


def kills(
    scale: str, autopilot: str, seed: int, every_s: float = _EVERY_S, first_s: float = 0.0,
    until: Callable[[float], bool] = lambda _: False,
) -> Iterator[dict[str, Any]]:
    """The kills of one flight, one after the other."""
    flight = Flight(*setting(scale, autopilot, seed)[:2], seed, setting(scale, autopilot, seed)[2])
    due_s = -math.inf
    while not flight.is_over and not until(flight.now_s):
        flight.step()
        if flight.now_s >= max(due_s, first_s) and flight.may_be_killed():
            due_s = flight.now_s + every_s
            yield {"scale": scale, "autopilot": autopilot, "seed": seed, **flight.killed()}
    print(scale, autopilot, seed, flight.phase, flight.session.state.reason, flight.now_s, file=sys.stderr)


def main() -> int:
    import time
    scale, autopilot, seed = sys.argv[1], sys.argv[2], int(sys.argv[3])
    every = float(sys.argv[4]); until=float(sys.argv[5]) if len(sys.argv)>5 else 1e9
    t0=time.process_time(); w0=time.time()
    found=list(kills(scale, autopilot, seed, every, until=lambda s: s>until))
    print("cpu", time.process_time()-t0, "wall", time.time()-w0)
    out=[k for k in found if k["outside_m"]>0]
    print(scale, autopilot, "kills", len(found), "outside", len(out), "max", max([k["outside_m"] for k in found]), "not standing", sum(not k["stands"] for k in found))
    for k in sorted(found, key=lambda k:-k["outside_m"])[:8]: print({a:(round(b,2) if isinstance(b,float) else b) for a,b in k.items() if a not in("scale","autopilot","seed")})
    return 0

if __name__ == "__main__":
    sys.exit(main())
