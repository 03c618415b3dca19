"""What a copter does about something that appears before it: a post of 0.6 m, seen by a lidar.

    scripts/bench popup [--runs 3] [--json FILE]

Companion and simulator without sockets, by the missions forest and street (lidars of 16 and 40 m,
10 and 20 Hz, with noise, lost echoes and latency), over open ground.  A post stands so far ahead:
its surface from where the copter truly is, when it has just come to its speed, and half a second
and more later.  Reaction: from then to the first setpoint of the stop; "went round": it was avoided
without one.  Limit: what the copter flies in that time, and then to a stand when the autopilot is
told at that moment to stand still by the simplest means: no velocity, there.  Nearer than that
nobody can stop it.  1 if one was touched that was farther away.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Any

from pymavlink.dialects.v20 import all as wire
from running import Found, main, most
from stepped import Flight

from companion.config import folder_of, load_mission
from companion.geodesy import deg_e7
from companion.mission.state import Reason
from vehicle_sim.scene import Scene, Upright
from vehicle_sim.world import World, read_world

_MISSIONS = ("forest", "street")
_AHEAD_M = (15.0, 10.0, 6.0, 4.0)
_RADIUS_M = 0.3
_STANDS_M_S = 0.1
_AT_SPEED, _LATER_S = 0.95, 0.5
_WATCHED_S, _LIMIT_S = 12.0, 200.0
_SETPOINT = wire.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT


def open_world(name: str) -> World:
    """That of a bundled mission, without anything that stands in it."""
    world = read_world(folder_of(name) / "world.toml")
    return replace(world, woods=(), walls=(), buildings=(), trees=(), wires=())


class PostFlight(Flight):
    """One flight over open ground, until some seconds after the post has appeared."""

    def __init__(self, name: str, seed: int) -> None:
        super().__init__(load_mission(name), open_world(name), seed)
        self.setpoints: list[float] = []
        """When they were sent."""
        self._parser = wire.MAVLink(None)

    def said(self, frames: Sequence[bytes]) -> None:
        """Notes the times of setpoints."""
        for frame in frames:
            for message in self._parser.parse_buffer(frame) or ():
                if message.get_msgId() == _SETPOINT:
                    self.setpoints.append(self.now_s)
        super().said(frames)

    def place(self, ahead_m: float) -> Upright:
        """A post before the copter, and in the simulator's world from now on."""
        simulation, vehicle = self.simulation, self.simulation.vehicle
        north, east, _ = simulation.place_nea_m()
        v_n, v_e = vehicle.velocity_north_m_s, vehicle.velocity_east_m_s
        by = (ahead_m + _RADIUS_M) / math.hypot(v_n, v_e)
        post = Upright(((north + by * v_n, east + by * v_e),), _RADIUS_M, 400.0, 420.0)
        simulation._contact.scene = Scene(simulation._world.truth(), (post,))
        for lidar, _ in simulation._lidars:
            lidar._scene = simulation._contact.scene
        return post

    def gap_m(self, post: Upright) -> float:
        """From the copter to the post."""
        return math.dist(self.simulation.place_nea_m()[:2], post.corners_ne_m[0]) - _RADIUS_M


def at_speed(name: str, seed: int) -> PostFlight:
    """A flight at full speed: just so in the first, later in the others."""
    it = PostFlight(name, seed)
    full_m_s, later_s = _AT_SPEED * it.mission.task.limits.speed_m_s, math.inf
    while it.now_s < later_s:
        it.step()
        assert it.now_s < _LIMIT_S, it.phase
        reference_m_s = it.session.state.flight.reference.speed_m_s
        if later_s == math.inf and min(it.speed_m_s, reference_m_s) >= full_m_s:
            later_s = it.now_s + _LATER_S * (seed - 1)
    return it


def stopping_m(name: str, seed: int, react_s: float) -> float:
    """How far it flies until it stands, if the autopilot is told to stop so much later."""
    it = at_speed(name, seed)
    begin = it.simulation.place_nea_m()
    told_s = it.now_s + react_s
    while it.now_s < told_s:
        it.step()
    sent = wire.MAVLink(None, srcSystem=1, srcComponent=195)
    north_m, east_m, amsl_m = it.simulation.place_nea_m()
    latitude, longitude = it.mission.frame.to_geodetic_deg(north_m, east_m)
    stands = sent.set_position_target_global_int_encode(
        0, 1, 1, wire.MAV_FRAME_GLOBAL_INT, 0b110111000000, deg_e7(float(latitude)),
        deg_e7(float(longitude)), amsl_m, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
    )  # fmt: skip
    while it.speed_m_s > _STANDS_M_S:
        it.simulation.receive(0, stands.pack(sent))
        it.simulation.step()
        it.simulation.take_frames()
    return math.dist(it.simulation.place_nea_m()[:2], begin[:2])


def popped_up(name: str, ahead_m: float, seed: int) -> dict[str, Any]:
    """What came of one post."""
    it = at_speed(name, seed)
    began_s, speed, post = it.now_s, it.speed_m_s, it.place(ahead_m)
    gaps_m, stops, stood = [it.gap_m(post)], list[float](), False
    while it.now_s < began_s + _WATCHED_S and not stood:
        it.step()
        gaps_m.append(it.gap_m(post))
        stop, stood = it.session.state.flight.stop, it.speed_m_s < _STANDS_M_S
        if stop is not None and stop.reason is Reason.NEW_THREAT:
            stops.append(it.now_s)
    told = [at_s for at_s in it.setpoints if stops and at_s >= stops[0]]
    react_s = told[0] - began_s if told else None
    return {
        "mission": name,
        "speed_m_s": speed,
        "ahead_m": ahead_m,
        "seed": seed,
        "reaction_s": react_s,
        "least_m": min(gaps_m),
        "stood": stood,
        "touched": min(gaps_m) <= 0.0,
        "limit_m": None if react_s is None else stopping_m(name, seed, react_s),
    }


def popup(runs: int = 3) -> Found:
    """Posts so far ahead, so often each."""
    found = list[dict[str, Any]]()
    for name, ahead_m in product(_MISSIONS, _AHEAD_M):
        mine = [popped_up(name, ahead_m, seed) for seed in range(1, runs + 1)]
        reactions = [run["reaction_s"] for run in mine if run["reaction_s"] is not None]
        yield {
            "a post appears": name,
            "speed, m/s|.1f": max(run["speed_m_s"] for run in mine),
            "ahead, m|.0f": ahead_m,
            "limit, m|.1f": max((run["limit_m"] for run in mine if run["limit_m"]), default=None),
            "reaction": f"{max(reactions):.2f} s" if reactions else "went round",
            "least gap, m|.1f": min(run["least_m"] for run in mine),
            "came to rest": sum(run["stood"] for run in mine),
            "touched": sum(run["touched"] for run in mine),
        }
        found += mine
    yield found
    avoidable = [run["touched"] and (run["limit_m"] or 0.0) < run["ahead_m"] for run in found]
    yield most("touched where it could have stopped", sum(avoidable), 0)


if __name__ == "__main__":
    main(popup)
