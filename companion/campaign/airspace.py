"""Several copters in one airspace, each with its own companion, in this process.

They stand in fours, each four on a circle, and each flies to the other side of its circle; the
circles fill a square about the middle of the mission's area, always as densely.  Heartbeats,
positions and claims go from each to all others (decision 0023), some of them late, some lost.
How far apart they were is judged by where they really were.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np

from companion.campaign.drawn_faults import split
from companion.campaign.flight import Flight, FlightFiles
from companion.campaign.in_process import Flying
from companion.geodesy import FloatArray
from companion.runtime.workers import Datagram
from companion.sources.files import RawTable, toml_table, toml_text

LOST, _LATE_TICKS = 0.1, 2
"""Share of messages between vehicles that is lost; the others are late by up to so many ticks."""
_TICK_US = 100_000
_FOUR = 4
"""More at a time are many for the levels of the band: they wait long."""
_RADIUS_M, _APART_M = 150.0, 400.0
"""Of a circle; of the middles of two."""
_BEYOND_M = 50.0
"""How much farther than the circle's other side a target lies."""
_BATTERY = {"ardupilot": {"BATT_CAPACITY": 100_000.0}}
"""Parameters, in mAh: among many, giving way takes longer than a battery of the default lasts."""
_SHARED = frozenset({0, 33, 87})  # HEARTBEAT, GLOBAL_POSITION_INT, POSITION_TARGET_GLOBAL_INT


def in_fours(files: FlightFiles, count: int, seed: int) -> list[FlightFiles]:
    """World and mission of each vehicle, systems 1 to count, drawn from a seed."""
    world, mission = (
        toml_table(path.read_text(encoding="utf-8"), path.name)
        for path in (files.world, files.mission)
    )
    area, rng = mission["area"], np.random.default_rng((count, seed))
    middle = [0.5 * (area[f"{axis}_min_m"] + area[f"{axis}_max_m"]) for axis in ("north", "east")]
    circles = math.ceil(count / _FOUR)
    side = math.ceil(math.sqrt(circles))
    turn, found = rng.uniform(0.0, math.tau), list[FlightFiles]()
    for place, system in enumerate(rng.permutation(np.arange(1, count + 1)).tolist()):
        circle, among = divmod(place, _FOUR)
        on_it = min(_FOUR, count - circle * _FOUR)
        cell = np.array(divmod(circle, side)) - 0.5 * (side - 1)
        angle = turn + (math.tau * among + rng.uniform(-0.8, 0.8)) / on_it
        along = np.array([math.cos(angle), math.sin(angle)])
        about = middle + _APART_M * cell
        start, target = about + _RADIUS_M * along, about - (_RADIUS_M + _BEYOND_M) * along
        folder = files.folder / f"vehicle-{system:03d}"
        asked = folder / "asked"  # mission.toml of a run folder is written by who flies
        asked.mkdir(parents=True)
        changes: list[tuple[str, RawTable]] = [
            ("world.toml", world | {"vehicle": _vehicle(world["vehicle"], start, system)}),
            ("asked/mission.toml", _mission(mission, target, system)),
        ]
        for name, table in changes:
            (folder / name).write_text(toml_text(table), encoding="utf-8")
        world_file, mission_file = folder / "world.toml", asked / "mission.toml"
        found.append(replace(files, folder=folder, world=world_file, mission=mission_file))
    return found


def _vehicle(vehicle: RawTable, at_ne_m: FloatArray, system: int) -> RawTable:
    return vehicle | {
        "north_m": float(at_ne_m[0]),
        "east_m": float(at_ne_m[1]),
        "system_id": system,
        "parameters": _BATTERY.get(vehicle["autopilot"], {}) | vehicle.get("parameters", {}),
    }


def _mission(mission: RawTable, target_ne_m: FloatArray, system: int) -> RawTable:
    north_m, east_m = target_ne_m.tolist()
    return mission | {
        "vehicle": mission["vehicle"] | {"system_id": system},
        "targets": [{"north_m": north_m, "east_m": east_m}],
        "traffic": mission.get("traffic", {}),
    }


def fly_together(
    several: Sequence[FlightFiles], *, seed: int, limit_s: float, recorded: bool
) -> list[Flight]:
    """All of them, tick by tick; whose mission has ended flies no more.

    A companion that is killed is resumed from its folder, as if it flew alone.
    """
    rng, air = np.random.default_rng((len(several), seed)), [list[_Due]() for _ in several]
    timelines = [split(files.faults) for files in several]
    flying = [
        Flying(
            replace(files, faults=timeline),
            seed=seed + 1000 * number,
            limit_s=limit_s,
            recorded=recorded or bool(to_come),
            shared=_SHARED,
        )
        for number, (files, (timeline, to_come)) in enumerate(zip(several, timelines, strict=True))
    ]
    try:
        tick = 0
        while any(each.flies for each in flying):
            tick += 1
            for number in rng.permutation(len(flying)).tolist():
                one, (_, to_come) = flying[number], timelines[number]
                if one.flies and to_come and 1e6 * to_come[0].at_s <= tick * _TICK_US:
                    happening = to_come.pop(0)
                    one.fly_on(1e6 * happening.at_s)
                    if one.flies:
                        one.die(happening.until_s - happening.at_s)
                    air[number].clear()  # nobody listened
                if not one.flies:
                    continue
                heard = b"".join(due.frame for due in air[number] if due.tick <= tick)
                air[number] = [due for due in air[number] if due.tick > tick]
                if heard:
                    one.loop.event_queue.put(Datagram(heard, None, one.loop.clock()))
                one.fly_on(tick * _TICK_US)
                for frame in one.take_said():
                    late = rng.integers(0, _LATE_TICKS + 1, len(flying)).tolist()
                    kept = (rng.random(len(flying)) >= LOST).tolist()
                    for other, queue in enumerate(air):
                        if kept[other] and other != number and flying[other].flies:
                            queue.append(_Due(tick + late[other], frame))
    finally:
        for each in flying:
            each.close()
    return [each.flight() for each in flying]


@final
@dataclass(frozen=True, slots=True)
class _Due:
    """A message, and when it comes."""

    tick: int
    frame: bytes


def separation(flights: Sequence[Flight]) -> dict[str, Any]:
    """How near any two came in the air -> `apart_least_m`, `separation_kept`.

    The latter is the least share of the separation that a mission asks for that was kept,
    horizontally or vertically.
    """
    rules = flights[0].mission.traffic
    assert rules is not None
    at = [
        {row["t_s"]: (row["north_m"], row["east_m"], row["altitude_amsl_m"]) for row in f.truth
         if not row["landed"]}
        for f in flights
    ]  # fmt: skip
    least_m = kept = math.inf
    for t_s in sorted({t_s for places in at for t_s in places}):
        here = np.array([places[t_s] for places in at if t_s in places])
        one, other = np.triu_indices(len(here), 1)
        if not len(one):
            continue
        apart = here[one] - here[other]
        level_m, up_m = np.hypot(apart[:, 0], apart[:, 1]), np.abs(apart[:, 2])
        least_m = min(least_m, float(np.hypot(level_m, up_m).min()))
        share = np.maximum(level_m / rules.separation_m, up_m / rules.vertical_separation_m)
        kept = min(kept, float(share.min()))
    apart_known = math.isfinite(kept)
    return {
        "apart_least_m": least_m if apart_known else None,
        "separation_kept": kept if apart_known else None,
    }
