"""Kill the companion again and again in one mission; a loop starts it again each time.

    scripts/bench killed [--kills 50] [--autopilot ardupilot|px4] [--seed 1] [--json FILE]

Real processes, real time: `kill -9` at random moments of its life, start-up included, then
`companion fly MISSION --out RUN --resume`.  A tap on the wire watches the setpoints.  Each should
be where the autopilot's own target is: at the setpoint before, advanced by its velocity for as long
as the autopilot does that, from then on (it brakes) where it tells that its target is, or at the
vehicle.  The bar: it arrives; no setpoint, the first of a life or any other, jumps by more than 1 m
or 1 m/s.
"""

import dataclasses
import math
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import final

import numpy as np
import running
import tapped
from pymavlink.dialects.v20 import all as wire
from rich.console import Console
from tapped import TO_COMPANION, Tapped, messages

from companion.campaign import families
from companion.campaign.drawn_files import FRAME
from companion.campaign.drawn_world import DrawnWorld
from companion.mission.mission import AutopilotName
from vehicle_sim.geodesy import metres_per_degree

_HEARD = (
    wire.MAVLink_global_position_int_message,
    wire.MAVLink_gps_global_origin_message,
    wire.MAVLink_position_target_local_ned_message,
)
_SAID = (wire.MAVLink_set_position_target_global_int_message,)
_KILLS_A_LAP = 20.0
_LIFE_S = (0.3, 16.0)
_PATIENCE_S = 1800.0
_FLIES_ON_S = {"ardupilot": 3.0, "px4": 0.0}
"""How long the autopilot moves its target on by itself."""
_NORTH_M, _EAST_M = metres_per_degree(FRAME.latitude_deg)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Jump:
    """How far a setpoint is from where the autopilot's target was."""

    at_s: float
    life: int
    first: bool
    """The first one of this life."""
    metres: float
    speed_m_s: float
    gap_s: float


@final
@dataclass(slots=True)
class Watcher:
    """Compares each setpoint with the one before and with the vehicle."""

    flies_on_s: float
    life: int = 0
    jumps: list[Jump] = field(default_factory=list)
    _last: tuple[float, tuple[float, ...]] | None = None
    _last_life: int = -1
    _vehicle: tuple[float, ...] | None = None
    _origin: tuple[float, float, float] | None = None
    _target: tuple[float, tuple[float, ...]] | None = None

    def seen(self, way: int, at_s: float, datagram: bytes) -> None:
        for it in messages(datagram, *(_HEARD if way == TO_COMPANION else _SAID)):
            match it.get_type():
                case "GLOBAL_POSITION_INT":
                    velocity = (1e-2 * each for each in (it.vx, it.vy, it.vz))
                    self._vehicle = (1e-7 * it.lat, 1e-7 * it.lon, 1e-3 * it.alt, *velocity)
                case "GPS_GLOBAL_ORIGIN":
                    self._origin = (1e-7 * it.latitude, 1e-7 * it.longitude, 1e-3 * it.altitude)
                case "POSITION_TARGET_LOCAL_NED" if self._origin is not None:
                    there = _moved((*self._origin, it.x, it.y, it.z), 1.0)[:3]  # 1 s at m/s
                    self._target = at_s, (*there, it.vx, it.vy, it.vz)
                case "SET_POSITION_TARGET_GLOBAL_INT":
                    place = (1e-7 * it.lat_int, 1e-7 * it.lon_int, it.alt)
                    self._on_setpoint(at_s, (*place, it.vx, it.vy, it.vz))

    def _on_setpoint(self, at_s: float, now: tuple[float, ...]) -> None:
        near: list[tuple[float, float, float]] = []
        gap_s = 0.0
        if self._last is not None:
            gap_s = at_s - self._last[0]
            before = self._last[1]
            moved = _moved(before, min(gap_s, self.flies_on_s))
            near.append((_apart_m(now, moved), _apart_m_s(now, before), gap_s))
        if self._target is not None and gap_s > self.flies_on_s > 0.0:
            moved = _moved(self._target[1], at_s - self._target[0])
            near.append((_apart_m(now, moved), _apart_m_s(now, moved), gap_s))
        if self._vehicle is not None:
            near.append((_apart_m(now, self._vehicle), _apart_m_s(now, self._vehicle), gap_s))
        if near:
            metres, speed, _ = min(near, key=lambda each: each[0] + each[1])
            self.jumps.append(
                Jump(
                    at_s=at_s,
                    life=self.life,
                    first=self.life != self._last_life,
                    metres=metres,
                    speed_m_s=speed,
                    gap_s=gap_s,
                )
            )
        self._last, self._last_life = (at_s, now), self.life


def _moved(setpoint: tuple[float, ...], seconds: float) -> tuple[float, ...]:
    lat, lon, altitude, north, east, down = setpoint
    place = (lat + north * seconds / _NORTH_M, lon + east * seconds / _EAST_M)
    return (*place, altitude - down * seconds, north, east, down)


def _apart_m(one: Sequence[float], other: Sequence[float]) -> float:
    north, east = (one[0] - other[0]) * _NORTH_M, (one[1] - other[1]) * _EAST_M
    return math.hypot(north, east, one[2] - other[2])


def _apart_m_s(one: Sequence[float], other: Sequence[float]) -> float:
    return math.dist(one[3:6], other[3:6])


def drawn_for(kills: int) -> DrawnWorld:
    """There and back, as often as so many kills take."""
    drawn = families.world("short-copter", 1, 4)
    legs = (drawn.targets_ne_m[-1], drawn.start_nea_m[:2])
    return dataclasses.replace(drawn, targets_ne_m=legs * math.ceil(kills / _KILLS_A_LAP))


def fly(autopilot: AutopilotName, kills: int, seed: int, folder: Path, console: Console) -> Watcher:
    """One mission with so many kills; SystemExit if it does not arrive."""
    rng = np.random.default_rng(seed)
    watcher = Watcher(flies_on_s=_FLIES_ON_S[autopilot])
    began_s, lives = time.monotonic(), 1
    dies_s = began_s + 60.0 if autopilot == "ardupilot" else began_s + 20.0
    with Tapped(drawn_for(kills), autopilot, folder, watcher.seen) as pair:
        while pair.companion.poll() is None and time.monotonic() - began_s < _PATIENCE_S:
            pair.tap.pump(0.05)
            if lives <= kills and time.monotonic() > dies_s:
                tapped.end(pair.companion)
                watcher.life = lives
                pair.start("--resume")
                lives += 1
                dies_s = time.monotonic() + rng.uniform(*_LIFE_S)
        flies_s, code = time.monotonic() - began_s, pair.companion.poll()
        console.print(f"{lives - 1} kills in {flies_s:.0f} s; the last life ended with {code}")
        if code != 0 or lives <= kills:
            raise SystemExit(pair.said())
    return watcher


def main() -> int:
    """Fly it; 1 if a setpoint jumps."""
    autopilots = ["ardupilot", "px4"]
    options, console = running.begin(__doc__, kills=50, autopilot=autopilots, seed=1)
    with tempfile.TemporaryDirectory() as folder:
        watcher = fly(options.autopilot, options.kills, options.seed, Path(folder), console)
    bars = []
    for name, is_first in (("first setpoints of a life", True), ("other setpoints", False)):
        jumps = [(j.metres, j.speed_m_s) for j in watcher.jumps if j.first == is_first]
        most = [max(each) for each in zip(*jumps, strict=True)] or [0.0, 0.0]
        bars.append(running.most(f"jumps of {len(jumps)} {name}, m and m/s", most, (1.0, 1.0)))
    found = [dataclasses.asdict(jump) for jump in watcher.jumps]
    return running.ended(console, options.json, found, bars)


if __name__ == "__main__":
    sys.exit(main())
