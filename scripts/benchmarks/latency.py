"""How long the companion thinks, and how even its stream is: real processes, real time, loaded.

    scripts/bench latency [--autopilot ardupilot|px4] [--rates 20 200] [--idle] [--json FILE]

vehicle-sim and `companion fly` run as processes over UDP with a tap between them, and one more
process keeps a core busy.  The tap tells when a position went in and when the setpoint that answers
it (it carries the position's time) came out, and how long the gaps of the stream are.
Then, in this process: the calls and modules of our own from such a position to its setpoint.
"""

import multiprocessing
import tempfile
import time
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pymavlink.dialects.v20 import all as wire
from running import Bar, Found, main, most
from stepped import Called, Flight
from tapped import TO_COMPANION, Tapped, messages

from companion.campaign import families
from companion.config import folder_of, load_mission
from companion.mavlink.frames import number_of
from companion.mission.mission import AutopilotName
from companion.mission.state import Phase
from vehicle_sim.world import read_world

_POSITION = wire.MAVLink_global_position_int_message
_SETPOINT = wire.MAVLink_set_position_target_global_int_message
_PATIENCE_S = 400.0
_BARS_HZ = 20.0


def busy() -> None:
    """Keeps a core."""
    number = 1
    while True:
        number = number * 16807 % 2147483647


def measured(
    autopilot: AutopilotName, rate_hz: float, folder: Path, *, loaded: bool
) -> tuple[list[float], list[float]]:
    """One mission at this rate: milliseconds from positions to setpoints, and between these."""
    in_s, out_s, waits_s = dict[int, float](), list[float](), list[float]()

    def seen(way: int, at_s: float, datagram: bytes) -> None:
        for message in messages(datagram, _POSITION if way == TO_COMPANION else _SETPOINT):
            if way == TO_COMPANION:
                in_s[message.time_boot_ms] = at_s
                continue
            out_s.append(at_s)
            if message.time_boot_ms in in_s:
                waits_s.append(at_s - in_s[message.time_boot_ms])

    load, began_s = multiprocessing.Process(target=busy, daemon=True), time.monotonic()
    drawn = families.world("short-copter", 1, 1)
    with Tapped(drawn, autopilot, folder, seen, rate_hz=rate_hz) as pair:
        if loaded:
            load.start()
        while (code := pair.companion.poll()) is None and time.monotonic() < began_s + _PATIENCE_S:
            pair.pump(0.25 / rate_hz)
        if loaded:
            load.kill()
        if code != 0:
            raise SystemExit(f"the companion did not arrive ({code}):\n{pair.last_printed()}")
    return (1e3 * np.array(waits_s)).tolist(), (1e3 * np.diff(out_s)).tolist()


def called(name: str, seconds: float = 60.0) -> list[tuple[int, int]]:
    """Calls and modules of our own, from each position to a setpoint that is all that it brings."""
    it = Flight(load_mission(name), read_world(folder_of(name) / "world.toml"), seed=1)
    counts, until_s = list[tuple[int, int]](), np.inf
    while it.now_s < until_s and not it.is_over:
        it.simulation.step()
        for _, frame in it.simulation.take_frames():
            with Called("/companion/") as mine:
                answers = it.answers(frame)
            for answer in answers:
                it.simulation.receive(0, answer)
            if number_of(frame) == _POSITION.id and [*map(number_of, answers)] == [_SETPOINT.id]:
                counts.append((mine.calls, len(mine.files)))
        if it.phase is Phase.FLYING:
            until_s = min(until_s, it.now_s + seconds)
    return counts


def latency(
    autopilot: Literal["ardupilot", "px4"] = "ardupilot",
    rates: tuple[float, ...] = (20.0, 200.0),
    idle: bool = False,
) -> Found:
    """One mission for each rate of positions; idle: the other core is left alone."""
    bars, every = list[Bar](), list[Any]()
    yield "Position in to setpoint out, and gaps of the stream: ms"
    for rate_hz in rates:
        with tempfile.TemporaryDirectory() as folder:
            waits, gaps = measured(autopilot, rate_hz, Path(folder), loaded=not idle)
        row: dict[str, Any] = {"Hz|g": rate_hz, "setpoints": len(waits)}
        for what, times in (("", waits), ("gap ", gaps)):
            for share in (50, 99, 99.9, 100):
                row[f"{what}p{share:g}|.2f"] = np.percentile(times, share)
        yield row
        if rate_hz == _BARS_HZ:
            bars.append(most("gaps of the stream, 99.9 %, ms", row["gap p99.9|.2f"], 100.0))
            bars.append(most("position to setpoint, 99 %, ms", row["p99|.2f"], 5.0))
        every.append([rate_hz, waits, gaps])
    yield every
    counts = np.array(called("sitl-arducopter"))
    for what, column, bar in (("calls", counts[:, 0], 30.0), ("modules", counts[:, 1], 12.0)):
        yield {
            "of our own, from a position to its setpoint": what,
            "positions": len(column),
            "least": column.min(),
            "median|.0f": np.median(column),
            "most": column.max(),
        }
        bars.append(most(f"{what} from a position to its setpoint", float(np.median(column)), bar))
    yield from bars


if __name__ == "__main__":
    main(latency)
