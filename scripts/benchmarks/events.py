"""How long one event takes the part that decides, with a large fence that is drawn in flight.

    scripts/bench events [--zones 50] [--corners 100] [--vehicle ardupilot-plane ...] [--json FILE]

A companion flies a short drawn mission without sockets, there and back; in flight the vehicle is
given a fence of so many polygons, all over the area and one on the path, then another one around
the vehicle, then none.  Measured is the processor time of each event in the mission's machine, of
each fence as it is drawn, of checkpoints, and of each whole turn of the session.  What plans is
left out: it has a process of its own.  Each flight is flown twice, and the lesser time of each
event counts: both are the same but for what other programs take.  1 if an event took longer than
its bar, or a turn, which handles all events that came in at once, than its own.
"""

import math
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from pymavlink.dialects.v20 import all as wire
from running import Bar, Found, Some, main, most

from companion.campaign import drawn_files, families
from companion.campaign.drawn_world import DrawnWorld
from companion.campaign.in_process import Flight, FlightFiles, Flying
from companion.geodesy import FloatArray
from companion.mavlink.autopilot_client import AutopilotClient
from companion.mission import checkpoint, entries, machine
from companion.mission.state import Phase
from companion.runtime.loop import prompt_threads
from companion.session import Session
from companion.world.zones import PolygonZone
from vehicle_sim.plans import PlanItem, PlanKind

_BAR_MS, _TURN_BAR_MS = 20.0, 50.0  # a turn is shorter than the period of a stream of 20 Hz
_TURN = "whole turn"
_DRAWN_S = {"first": 5.0, "around": 125.0, "none": 250.0}
"""When each fence is drawn, after it began to fly; fifty items a second are read here."""
_RATE_HZ = 50.0  # of positions: in lockstep an item is read with each
VEHICLES = ("ardupilot-copter", "ardupilot-plane", "px4-copter", "px4-plane")

Times = defaultdict[str, list[float]]


def polygon(
    rng: np.random.Generator, middle: FloatArray, radius_m: float, corners: int, name: str
) -> PolygonZone:
    """Jagged, and simple: its corners lie around the middle in order."""
    turns = np.arange(corners) * (math.tau / corners)
    reach_m = rng.uniform(0.7, 1.0, corners) * radius_m
    places = middle + reach_m[:, None] * np.stack([np.cos(turns), np.sin(turns)], axis=-1)
    return PolygonZone(name=name, vertices_ne_m=tuple((n, e) for n, e in places.tolist()))


def polygons(
    drawn: DrawnWorld, about: FloatArray, zones: int, corners: int, *, ahead: bool
) -> list[PolygonZone]:
    """So many about a place; the first lies on the way from there to the target, or around it."""
    rng = np.random.default_rng(1)
    target = np.array(drawn.targets_ne_m[-1])
    reach_m = drawn.task.settings.scan_range_m
    along = (target - about) / np.linalg.norm(target - about)
    first = about + (0.5 * reach_m if ahead else 0.0) * along
    found = [polygon(rng, first, 0.08 * reach_m, corners, "0")]
    while len(found) < zones:
        middle = about + rng.uniform(-reach_m, reach_m, 2)
        found.append(polygon(rng, middle, 0.06 * reach_m, corners, str(len(found))))
    return found


def give_fence(vehicle: Any, zones: list[PolygonZone]) -> None:
    """At once, as if it had been uploaded."""
    items = []
    for zone in zones:
        for corner in zone.vertices_ne_m:
            latitude, longitude = drawn_files.FRAME.to_geodetic_deg(*corner)
            items.append(
                PlanItem(
                    frame=0,
                    command=wire.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
                    parameters=(float(len(zone.vertices_ne_m)), 0.0, 0.0, 0.0),
                    x=round(float(latitude) * 1e7),
                    y=round(float(longitude) * 1e7),
                )
            )
    vehicle.plans[PlanKind.FENCE] = tuple(items)


def timed(times: Times, name: Callable[..., str], function: Callable[..., Any]) -> Any:
    """The function, with its processor time kept under a name that depends on its arguments."""

    def call(*arguments: Any, **keywords: Any) -> Any:
        began_s = time.thread_time()
        try:
            return function(*arguments, **keywords)
        finally:
            times[name(*arguments)].append(time.thread_time() - began_s)

    return call


def fly(
    vehicle: str, zones: int, corners: int, limit_s: float = 500.0
) -> tuple[Times, Flight, list[PolygonZone]]:
    """One flight, so long after it began to fly at most: processor times in seconds, by what they
    were taken for; the flight; and its first fence."""
    autopilot, kind = vehicle.split("-")
    drawn = families.world(f"short-{kind}", 1, 1)
    (target,) = drawn.targets_ne_m
    drawn = replace(drawn, targets_ne_m=(target, drawn.start_nea_m[:2]) * 3)
    times: Times = defaultdict(list)
    patched = (
        (machine, "step", lambda _state, event, *_: type(event).__name__),
        (entries, "of_event", lambda event, *_: f"journal of {type(event).__name__}"),
        (AutopilotClient, "news", lambda *_: "fence and parameters"),
        (checkpoint.CheckpointPolicy, "due", lambda *_: "checkpoint"),
        (Session, "receive", lambda *_: "bytes in"),
        (Session, "run", lambda *_: _TURN),
    )
    patches = [
        patch.object(owner, call, timed(times, name, getattr(owner, call)))
        for owner, call, name in patched
    ]
    first: list[PolygonZone] = []
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        often = {"position_rate_hz": _RATE_HZ}
        world, mission = drawn_files.write(drawn, Path(folder), autopilot, often)  # type: ignore[arg-type]
        files = FlightFiles(world=world, mission=mission, faults="", folder=Path(folder) / "run")
        for each in patches:
            stack.enter_context(each)
        stack.enter_context(prompt_threads())  # as in flight
        flying = Flying(files, seed=1, limit_s=900.0)
        session = flying.loop.session
        while flying.flies and session.state.phase is not Phase.FLYING:
            flying.fly_on(1e6 * (flying.now_s + 0.1))
        began_s = flying.now_s
        for which, after_s in _DRAWN_S.items():
            if after_s > limit_s:
                break
            flying.fly_on(1e6 * (began_s + after_s))
            about = np.array((session.state.vehicle.position_nea_m or drawn.start_nea_m)[:2])
            is_ahead = which == "first"
            fence = polygons(drawn, about, zones, corners, ahead=is_ahead)
            give_fence(flying._vehicle, [] if which == "none" else fence)
            first = first or fence
        flying.fly_on(1e6 * (began_s + limit_s))
        flying.close()
        return times, flying.flight(), first


def events(zones: int = 50, corners: int = 100, vehicle: tuple[str, ...] = Some(VEHICLES)) -> Found:
    """Fly with each vehicle, twice: of each event the lesser time counts."""
    bars = list[Bar]()
    for each in vehicle:
        (once, flight, _), (again, _, _) = (fly(each, zones, corners) for _ in "12")
        times_ms = {
            name: 1e3 * np.minimum(taken, again[name], dtype=float) for name, taken in once.items()
        }
        for name, taken in sorted(times_ms.items(), key=lambda item: -item[1].max()):
            yield {
                f"{each}: processor time, ms": name,
                "count": len(taken),
                "median|.2f": np.median(taken),
                "p99|.2f": np.quantile(taken, 0.99),
                "most|.2f": taken.max(),
            }
        told = [len(e["zones"]) for e in flight.journal if e["kind"] == "fence"]
        ended = [e["outcome"] for e in flight.journal if e["kind"] == "end"]
        yield f"fences told: {told} zones; ended: {ended}\n"
        longest_ms = max(taken.max() for name, taken in times_ms.items() if name != _TURN)
        bars.append(most(f"{each}: longest event, ms", longest_ms, _BAR_MS))
        bars.append(most(f"{each}: longest turn, ms", times_ms[_TURN].max(), _TURN_BAR_MS))
    yield from bars


if __name__ == "__main__":
    main(events)
