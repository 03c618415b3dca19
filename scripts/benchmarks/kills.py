"""The companion dies at every second of a flight: does the vehicle stay within what was proven?

    scripts/bench kills [--kills 500] [--scale forest] [--autopilot px4] [--first 1] [--json FILE]

The stream of setpoints ends, and a copy of the simulation flies on until the vehicle stands (a
plane: until it has gone round); every other flight is told to return on its way, every third to
pause.  Where it truly is must lie within what the certificates of its leg speak of, or of the one
that it holds at the end of, and of those before that it may still be
on: tube and navigation error about curve, stretches, circles.  A plane is sent to points ahead of
it: shortly before p_prog they lie on the next leg, whose certificate counts, too.
"""

import itertools
import math
import os
import pickle
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray
from running import Found, main, most
from stepped import Flight

from companion.campaign import drawn_world, families
from companion.config import folder_of, load_mission
from companion.mavlink.autopilots import named
from companion.mission.events import Mode
from companion.mission.following import lead_m
from companion.mission.mission import AutopilotName, Mission
from companion.mission.phases import By, Phase
from companion.path.envelope import Envelope, ending_m_s, flown_on_m, rising_m_s
from companion.planner.procedure import Leg
from companion.planner.request import PlanOutcome, PlanRequest
from vehicle_sim.world import Peak, World, read_world

FloatArray = NDArray[np.float64]
PLANES: Final = ("plane", "short-plane")
"""Families of drawn worlds (`campaign.families`)."""
_PX4_PLANE_M_S: Final = 13.5
"""PX4's own simulated plane makes 13.9 m/s; told to fly the 22 of a family it trades height for
them, and flies 18 m low (`vehicle_sim.autopilot.px4plane`)."""
_PX4_ERROR_M: Final = 1.0
"""How wrong the position of the simulated PX4 may be: it tells of no less than 0.4 m."""
_PX4_SLACK_S: Final = 0.51
"""Of COM_OF_LOSS_T, until it brakes with all that it has (`mavlink.autopilots.px4_multicopter`)."""
_SCALES: Final = {
    "forest": (2, 0.5, 120),
    "posts": (2, 0.5, 70),
    "street": (3, 0.5, 90),
    "valley": (4, 1, 400),
    "environment-1": (8, 2, 500),
    "environment-2": (8, 2, 500),
    "ridge": (8, 2, 400),
    "plane": (5, 1, 400),
    "short-plane": (3, 1, 120),
}
"""Wind and turbulence, m/s; when every other flight is told to return, s."""
_RIDGE: Final = Peak(
    north_m=15_000.0, east_m=0.0, height_amsl_m=4_300.0, spread_north_m=5_000.0, spread_east_m=1e6
)
"""In the way of environment-2, whose peaks a copter of 150 m/s flies round and not over."""
_EVERY_S = 1.03  # so that it is not always at the same time since a position
_ROUND_S, _ROUND_RAD = 70.0, 10.0  # a plane: into its circle and round it
_STANDS_M_S, _STANDS_FOR_S = 0.25, 1.5
_SAMPLES = 400  # of a leg
_LIMIT_S, _PAUSE_S = 1_500.0, 45


class Proven(NamedTuple):
    """What the certificates of a leg speak of, sampled."""

    points_nea_m: FloatArray
    """(N, 3): along the curve."""
    reaches_nea_m: FloatArray
    """(N, 3): from each to the end of the stretch that begins there."""
    motion: Envelope
    """How far it may be off: of a plane with the circle about each point."""

    def outside_m(self, track_nea_m: FloatArray) -> FloatArray:
        """How far each place is outside.  (M, 3) -> (M,); negative: inside."""
        if self.motion.loiter_m > 0.0:
            off = track_nea_m[:, None] - self.points_nea_m
            flat = np.hypot(off[..., 0], off[..., 1])
            gaps = np.hypot(np.maximum(flat - self.motion.loiter_m, 0.0), off[..., 2])
            return np.asarray(gaps.min(axis=1) - self.motion.error_m)
        steps, reaches = np.diff(self.points_nea_m, axis=0), self.reaches_nea_m
        off = track_nea_m[:, None] - self.points_nea_m
        share = _shares(off[:, :-1], steps)[..., None]
        on_curve = np.linalg.norm(off[:, :-1] - share * steps, axis=-1)
        share = _shares(off[..., :2], reaches[:, :2])[..., None]
        aside = np.linalg.norm(off[..., :2] - share * reaches[:, :2], axis=-1)
        rise, height = share[..., 0] * reaches[:, 2], off[..., 2]  # where it flies level: between
        off_level = height - np.clip(height, np.minimum(rise, 0.0), np.maximum(rise, 0.0))
        on_stretch = np.hypot(aside, off_level) - self.motion.aside_m
        gaps = np.minimum(on_curve.min(axis=1), on_stretch.min(axis=1))
        return np.asarray(gaps - self.motion.error_m)


def _shares(off: FloatArray, steps: FloatArray) -> FloatArray:
    """How much of each step leads to where it is nearest to a place.  (M, K, D), (K, D) -> (M, K).

    off: of the place from where the step begins.
    """
    squared = np.maximum(np.einsum("kd,kd->k", steps, steps), 1e-12)
    return np.clip(np.einsum("mkd,kd->mk", off, steps) / squared, 0.0, 1.0)


def proven(leg: Leg, *, from_rest: bool, near_m: float = 0.0) -> Proven:
    """What the certificate of a leg speaks of; more samples near a length: stretches fan out."""
    motion, length_m = leg.motion, leg.subpath.length_m
    near = np.clip(near_m + np.linspace(-motion.lag_m, motion.lag_m, _SAMPLES // 4), 0.0, length_m)
    at_m = np.union1d(np.linspace(0.0, length_m, _SAMPLES), near)
    points = leg.subpath.points_nea_m(at_m)
    if motion.loiter_m > 0.0 and leg.reaches_target:  # it is sent to points beyond it
        last = leg.subpath.pose(length_m)
        ahead = leg.past_target_m * last.tangent_nea * (1.0, 1.0, 0.0)
        shares = np.linspace(0.0, 1.0, _SAMPLES // 8)[:, None]
        points = np.concatenate([points, last.position_nea_m + shares * ahead])
    reaches = np.zeros_like(points)
    if motion.loiter_m == 0.0:
        for k, here_m in enumerate(at_m):
            speed = motion.speed_m_s
            if not leg.through:
                speed = ending_m_s(motion, length_m - here_m)
            if from_rest:
                speed = min(speed, rising_m_s(motion, here_m))
            reaches[k] = flown_on_m(motion, speed) * leg.subpath.pose(float(here_m)).tangent_nea
    return Proven(points, reaches, motion)


class KilledFlight(Flight):
    """One flight whose companion dies again and again, each time in a copy."""

    def __init__(self, mission: Mission, world: World, seed: int, faults: str = "") -> None:
        super().__init__(mission, world, seed, faults)
        self._from_rest: dict[int, bool] = {}
        """Of plans."""
        self._legs: list[tuple[Leg, bool]] = []
        """The last one first, and whether it was begun at rest."""

    def planned(self, request: PlanRequest) -> PlanOutcome:
        """Notes what was planned from rest."""
        self._from_rest[request.plan_id] = request.from_rest
        return super().planned(request)

    def step(self) -> None:
        """Notes the legs: a vehicle that is late may still be on one of those before."""
        super().step()
        leg = self.session.state.leg
        if leg is None or (self._legs and leg is self._legs[0][0]):
            return
        same = leg.plan_id, leg.number  # its p_prog is known now
        before = [flown for flown in self._legs if (flown[0].plan_id, flown[0].number) != same]
        rests = self._from_rest.get(leg.plan_id, False) and not (before and before[0][0].through)
        behind_m = itertools.accumulate(flown.successor_at_m for flown, _ in before)
        late = sum(each_m < leg.motion.lag_m for each_m in behind_m)
        self._legs = [(leg, rests), *before[: late + 1]]

    @property
    def is_led(self) -> bool:
        """Whether it is led on a leg, or held by setpoints at the end of one."""
        state = self.session.state
        if not self._legs or state.vehicle.mode is not Mode.GUIDED:
            return False
        return self.phase in (Phase.FLYING, Phase.RETURNING) or state.held_by is By.SETPOINTS

    def killed(self) -> dict[str, Any]:
        """What comes of it in a copy without a companion."""
        read, write = os.pipe()
        if (child := os.fork()) == 0:
            try:
                os.write(write, pickle.dumps(self._flies_on()))
            finally:
                os._exit(0)
        os.close(write)
        os.waitpid(child, 0)
        kill: dict[str, Any] = pickle.loads(os.read(read, 65_536))
        os.close(read)
        return kill

    def _flies_on(self) -> dict[str, Any]:
        """Without a companion, and how far that leads out of what was proven."""
        simulation, limits = self.simulation, self.mission.task.limits
        began_s, begin_m_s = self.now_s, self.speed_m_s
        simulation._lidars, simulation._scanner = [], None
        simulation._controller.streams.soonest_us = sys.maxsize  # nobody listens
        track, vehicle = [simulation.contact.place_nea_m()], simulation.vehicle
        longest_s = limits.dead_man_s + 4.0 * limits.speed_m_s / limits.acceleration_m_s2 + 8.0
        steps_left = 100.0 * (longest_s if limits.hovers else _ROUND_S)
        stood_s, turned_rad, heading_rad = 0.0, 0.0, vehicle.heading_rad
        while steps_left > 0.0 and stood_s <= _STANDS_FOR_S and turned_rad < _ROUND_RAD:
            simulation.step()
            track.append(simulation.contact.place_nea_m())
            steps_left -= 1.0
            if limits.hovers:
                stood_s = stood_s + 0.01 if self.speed_m_s < _STANDS_M_S else 0.0
            else:
                turned_rad += abs(math.remainder(vehicle.heading_rad - heading_rad, math.tau))
                heading_rad = vehicle.heading_rad
        where = np.array([*track[:: max(len(track) // 150, 1)], track[-1]])
        state, legs, (leg, _) = self.session.state, self._legs, self._legs[0]
        path = state.path
        at_m = path.reference.length_m if path else leg.subpath.length_m
        points_m = at_m + lead_m(state)
        if path and path.next_leg and points_m > path.leg.successor_at_m:
            legs = [(path.next_leg, False), *legs]
        outside = np.full(len(where), math.inf)
        for its_leg, from_rest in legs:
            around = proven(its_leg, from_rest=from_rest, near_m=at_m)
            outside = np.minimum(outside, around.outside_m(where))
        return {
            "at_s": began_s,
            "outside_m": float(outside.max()),
            "speed_m_s": begin_m_s,
            "left_m": leg.subpath.length_m - at_m,
            "leg_m_s": leg.motion.speed_m_s,
            "stands": steps_left > 0.0,
        }


def setting(scale: str, autopilot: str, seed: int) -> tuple[Mission, World]:
    """Mission and world of one flight."""
    if scale in PLANES:
        drawn = families.world(scale, seed, 1)
        if autopilot == "px4":
            limits = drawn.task.limits
            limits = replace(limits, speed_m_s=min(limits.speed_m_s, _PX4_PLANE_M_S))
            drawn = replace(drawn, task=replace(drawn.task, limits=limits))
        with tempfile.TemporaryDirectory() as folder:
            files = drawn_world.write(drawn, Path(folder), cast("AutopilotName", autopilot))
            return load_mission(str(files[1])), read_world(files[0])
    name = "environment-2" if scale == "ridge" else scale
    mission, world = load_mission(name), read_world(folder_of(name) / "world.toml")
    world = world.with_woods_of(seed)
    if scale == "ridge":
        terrain = world.terrain.model_copy(update={"peaks": (_RIDGE,)})
        world = world.model_copy(update={"terrain": terrain})
    if autopilot == "px4":  # the worlds of these scales are flown by an ArduCopter
        mission, world = _on_px4(mission, world)
    return mission, world


def _on_px4(mission: Mission, world: World) -> tuple[Mission, World]:
    """A copter's mission and world with the other autopilot, set up for it as preflight asks."""
    limits, strategy = mission.task.limits, named("px4", "copter")
    limits = replace(limits, navigation_error_m=max(limits.navigation_error_m, _PX4_ERROR_M))
    longest_s = limits.dead_man_s - _PX4_SLACK_S
    parameters = {
        **strategy.firmware.lasting_battery,
        **strategy.parameters_for(limits),
        "MPC_ACC_HOR": limits.acceleration_m_s2,
        "MPC_JERK_AUTO": 4.0 * limits.acceleration_m_s2,
        "COM_OF_LOSS_T": math.floor(10.0 * longest_s) / 10.0,
    }
    task = replace(mission.task, limits=limits, handling=strategy.traits.handling)
    own = {"autopilot": "px4", "parameters": parameters}
    vehicle = world.vehicle.model_copy(update=own)
    # the second lidar is ArduPilot's own
    world = world.model_copy(update={"vehicle": vehicle, "second_lidar": None})
    return replace(mission, autopilot="px4", task=task), world


def kills(scale: str, autopilot: str, seed: int, every_s: float) -> Iterator[dict[str, Any]]:
    """The kills of one flight, one after the other; the last says why it gave up, if it did."""
    wind_m_s, gusts_m_s, returns_s = _SCALES[scale]
    faults = f"at 1 s: wind {wind_m_s} m/s from 250 deg turbulence {gusts_m_s}"
    if seed % 2:
        faults += f"\nat {returns_s} s: ground_command 20"  # NAV_RETURN_TO_LAUNCH
    if seed % 3 == 0:
        faults += f"\nat {returns_s // 2} s: ground_command 193 0"  # DO_PAUSE_CONTINUE
        faults += f"\nat {returns_s // 2 + _PAUSE_S} s: ground_command 193 1"
    flight, due_s = KilledFlight(*setting(scale, autopilot, seed), seed, faults), -1.0
    kill: dict[str, Any] = {}
    while not flight.is_over and flight.now_s <= _LIMIT_S:
        flight.step()
        if flight.is_led and flight.now_s >= due_s:
            due_s = flight.now_s + every_s
            kill = {"scale": scale, "autopilot": autopilot, "seed": seed, "gave_up": None}
            kill |= flight.killed()
            yield kill
    reason = flight.session.state.reason
    if not kill:
        raise AssertionError(reason)  # it never flew: there is nothing to kill
    if flight.phase is Phase.DONE and reason is not None:
        kill["gave_up"] = reason.text


def sample(
    scale: str, autopilot: str, first: int, count: int, every_s: float = _EVERY_S
) -> list[dict[str, Any]]:
    """So many kills, of flights with seeds from the first on."""
    flights = (kills(scale, autopilot, seed, every_s) for seed in itertools.count(first))
    return list(itertools.islice(itertools.chain.from_iterable(flights), count))


def killed(
    kills: int = 500,
    first: int = 1,
    scale: Literal[("all", *_SCALES)] = "all",
    autopilot: Literal["all", "ardupilot", "px4"] = "all",
) -> Found:
    """So many kills at each scale with each autopilot, of flights with seeds from the first on."""
    scales = tuple(_SCALES) if scale == "all" else (scale,)
    autopilots = ("ardupilot", "px4") if autopilot == "all" else (autopilot,)
    every = list[dict[str, Any]]()
    for settings in itertools.product(scales, autopilots):
        mine = sample(*settings, first, kills)
        outside = np.array([kill["outside_m"] for kill in mine])
        yield {
            "killed at every second": ", ".join(settings),
            "kills": len(mine),
            "outside": int((outside > 0.0).sum()),
            "flights given up": sum(kill["gave_up"] is not None for kill in mine),
            "margin left: least, m|.2f": -outside.max(),
            "1 %, m|.2f": -np.percentile(outside, 99.0),
        }
        every += mine
    yield every
    yield most("killed and outside", sum(kill["outside_m"] > 0.0 for kill in every), 0)


if __name__ == "__main__":
    main(killed)
