"""Kill the companion again and again in one mission; a loop starts it again each time.

    scripts/bench killed [--kills 50] [--autopilot ardupilot|px4] [--seed 1] [--json FILE]

Real processes, real time: `kill -9` at random moments of its life, start-up included, then
`companion fly MISSION --out RUN --resume`.  A tap on the wire watches the setpoints.  Each should
be where the autopilot's own target is: at the setpoint before, advanced by its velocity for as long
as the autopilot does that, from then on (it brakes) where it tells that its target is, or at the
vehicle.  The bar: it arrives; no setpoint, the first of a life or any other, jumps by more than 1 m
or 1 m/s.
"""

import math
import tempfile
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, NamedTuple, final

import numpy as np
from pymavlink.dialects.v20 import all as wire
from running import Found, main, most
from tapped import TO_COMPANION, Tapped, end, messages

from companion.campaign import families
from companion.campaign.drawn_world import FRAME, DrawnWorld
from companion.geodesy import FloatArray
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


class Jump(NamedTuple):
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
    """Compares each setpoint with the one before and with the vehicle.

    A state is north, east, down in metres, and the velocity there.  (6,).
    """

    flies_on_s: float
    life: int = 0
    jumps: list[Jump] = field(default_factory=list)
    _last: tuple[float, FloatArray] | None = None
    _last_life: int = -1
    _vehicle: FloatArray | None = None
    _origin: FloatArray | None = None
    _target: tuple[float, FloatArray] | None = None

    def seen(self, way: int, at_s: float, datagram: bytes) -> None:
        for it in messages(datagram, *(_HEARD if way == TO_COMPANION else _SAID)):
            match it.get_type():
                case "GLOBAL_POSITION_INT":
                    velocity = 1e-2 * it.vx, 1e-2 * it.vy, 1e-2 * it.vz
                    self._vehicle = _state(it.lat, it.lon, 1e-3 * it.alt, *velocity)
                case "GPS_GLOBAL_ORIGIN":
                    self._origin = _state(it.latitude, it.longitude, 1e-3 * it.altitude)
                case "POSITION_TARGET_LOCAL_NED" if self._origin is not None:
                    there = np.array([it.x, it.y, it.z, it.vx, it.vy, it.vz])
                    self._target = at_s, self._origin + there
                case "SET_POSITION_TARGET_GLOBAL_INT":
                    setpoint = _state(it.lat_int, it.lon_int, it.alt, it.vx, it.vy, it.vz)
                    self._on_setpoint(at_s, setpoint)

    def _on_setpoint(self, at_s: float, now: FloatArray) -> None:
        near, gap_s = list[FloatArray](), 0.0
        if self._last is not None:
            gap_s = at_s - self._last[0]
            near.append(_moved(self._last[1], min(gap_s, self.flies_on_s)))
        if self._target is not None and gap_s > self.flies_on_s > 0.0:
            near.append(_moved(self._target[1], at_s - self._target[0]))
        if self._vehicle is not None:
            near.append(self._vehicle)
        if near:
            differences = np.linalg.norm((np.array(near) - now).reshape(-1, 2, 3), axis=-1)
            metres, speed = differences[differences.sum(axis=1).argmin()].tolist()
            is_first = self.life != self._last_life
            self.jumps.append(Jump(at_s, self.life, is_first, metres, speed, gap_s))
        self._last, self._last_life = (at_s, now), self.life


def _state(lat_e7: int, lon_e7: int, up_m: float, *velocity: float) -> FloatArray:
    place = 1e-7 * lat_e7 * _NORTH_M, 1e-7 * lon_e7 * _EAST_M, -up_m
    return np.array([*place, *(velocity or (0.0, 0.0, 0.0))])


def _moved(state: FloatArray, seconds: float) -> FloatArray:
    return state + np.append(seconds * state[3:], np.zeros(3))


def drawn_for(kills: int) -> DrawnWorld:
    """There and back, as often as so many kills take."""
    drawn = families.world("short-copter", 1, 4)
    legs = (drawn.targets_ne_m[-1], drawn.start_nea_m[:2])
    return replace(drawn, targets_ne_m=legs * math.ceil(kills / _KILLS_A_LAP))


def fly(autopilot: AutopilotName, kills: int, seed: int, folder: Path) -> tuple[Watcher, str]:
    """One mission with so many kills; SystemExit if it does not arrive."""
    rng = np.random.default_rng(seed)
    watcher = Watcher(flies_on_s=_FLIES_ON_S[autopilot])
    began_s, lives = time.monotonic(), 1
    dies_s = began_s + 60.0 if autopilot == "ardupilot" else began_s + 20.0
    with Tapped(drawn_for(kills), autopilot, folder, watcher.seen) as pair:
        while pair.companion.poll() is None and time.monotonic() - began_s < _PATIENCE_S:
            pair.pump(0.05)
            if lives <= kills and time.monotonic() > dies_s:
                end(pair.companion)
                watcher.life = lives
                pair.start("--resume")
                lives += 1
                dies_s = time.monotonic() + rng.uniform(*_LIFE_S)
        flies_s, code = time.monotonic() - began_s, pair.companion.poll()
        summary = f"{lives - 1} kills in {flies_s:.0f} s; the last life ended with {code}"
        if code != 0 or lives <= kills:
            raise SystemExit(f"{summary}\n{pair.last_printed()}")
    return watcher, summary


def killed(
    kills: int = 50, autopilot: Literal["ardupilot", "px4"] = "ardupilot", seed: int = 1
) -> Found:
    """Fly it, and hold the jumps of its setpoints."""
    with tempfile.TemporaryDirectory() as folder:
        watcher, summary = fly(autopilot, kills, seed, Path(folder))
    yield summary
    yield [jump._asdict() for jump in watcher.jumps]
    for name, is_first in (("first setpoints of a life", True), ("other setpoints", False)):
        jumps = [(j.metres, j.speed_m_s) for j in watcher.jumps if j.first == is_first]
        largest = [max(column) for column in zip(*jumps, strict=True)] or [0.0, 0.0]
        yield most(f"jumps of {len(jumps)} {name}, m and m/s", largest, (1.0, 1.0))


if __name__ == "__main__":
    main(killed)
