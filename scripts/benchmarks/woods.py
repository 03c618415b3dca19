"""Fly the bundled lidar missions among trees drawn anew: arrivals, clearance, time, holds.

Both programs over UDP, in lockstep.  Seed k draws the trees of `forest` and the lidar's noise; the
houses of `street` stay.  Distances are true ones, of the simulator, to the nearest thing.
"""

import json
import math
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import running
import tomlkit
from pair_processes import BIN, free_port

WORLDS = ("forest", "street")
HERE = Path(__file__).parents[2] / "companion" / "environments"

LIMIT_S = 900.0


def fly(name: str, seed: int) -> dict[str, Any]:
    """One flight: what its run folder says of it."""
    out = Path(tempfile.mkdtemp(prefix=f"{name}-{seed}-"))
    world = tomlkit.parse((HERE / name / "world.toml").read_text(encoding="utf-8"))
    for wood in world.get("woods", []):
        wood["seed"] = seed
    (out / "world.toml").write_text(tomlkit.dumps(world), encoding="utf-8")
    link = f"127.0.0.1:{free_port()}"
    vehicle = [BIN / "vehicle-sim", out / "world.toml", "--lockstep", "--seed", str(seed)]
    vehicle += ["--connect", f"udpout:{link}", "--out", out]
    companion = [BIN / "companion", "fly", HERE / name / "mission.toml", "--lockstep"]
    companion += ["--connect", f"udpin:{link}", "--out", out]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(vehicle, **quiet) as simulator:  # type: ignore[call-overload]
        try:
            code = subprocess.run(companion, timeout=LIMIT_S, check=False, **quiet).returncode  # type: ignore[call-overload]
        except subprocess.TimeoutExpired:
            code = -1
        simulator.terminate()
    found = {"world": name, "seed": seed, "code": code, **_told(out)}
    shutil.rmtree(out)
    return found


def _told(out: Path) -> dict[str, Any]:
    """Of truth and journal."""
    rows = [json.loads(line) for line in (out / "truth.jsonl").read_text().splitlines()[1:]]
    entries = [json.loads(line) for line in (out / "journal.jsonl").read_text().splitlines()[1:]]
    phases = [each for each in entries if each["kind"] == "phase"]
    began_s = next(each["t_s"] for each in phases if each["phase"] == "flying")
    ended_s = next((each["t_s"] for each in phases if each["phase"] == "arrived"), math.nan)
    flown = [row for row in rows if began_s <= row["t_s"] and not row["landed"]]
    place = np.array([(row["north_m"], row["east_m"]) for row in flown])
    return {
        "seconds": ended_s - began_s,
        "flown_m": float(np.hypot(*np.diff(place, axis=0).T).sum()),
        "straight_m": math.dist(place[0], place[-1]),
        "nearest_m": min(row["near_m"] for row in flown),
        "holds": sum(each["phase"] == "holding" for each in phases),
        "end": phases[-1].get("reason"),
    }


def main() -> int:
    """Fly them, print the table; 1 if a vehicle came nearer than d_s or none knows why it ended."""
    options, console = running.begin(__doc__, flights=10, first=1, jobs=2, world=["both", *WORLDS])
    worlds = WORLDS if options.world == "both" else (options.world,)
    seeds = range(options.first, options.first + options.flights)
    todo = [(name, seed) for name in worlds for seed in seeds]
    found = []
    for _, future in running.in_processes(fly, todo, options.jobs, "woods", console):
        found.append(future.result())
    headings = ("arrived", "least m", "flown / straight", "m/s", "holds", "not arrived")
    table = running.figures("Among near things", "world", *headings)
    kept = True
    for name in worlds:
        mine = [each for each in found if each["world"] == name]
        arrived = [each for each in mine if each["code"] == 0]
        mission = tomlkit.parse((HERE / name / "mission.toml").read_text(encoding="utf-8"))
        nearest_m = min(each["nearest_m"] for each in mine)
        kept &= nearest_m >= mission["planner"]["safety_distance_m"]
        kept &= all(each["end"] for each in mine if each["code"] != 0)
        ratio = np.median([each["flown_m"] / each["straight_m"] for each in arrived] or [math.nan])
        speed = np.median([each["flown_m"] / each["seconds"] for each in arrived] or [math.nan])
        table.add_row(
            name,
            f"{len(arrived)} of {len(mine)}",
            f"{nearest_m:.2f}",
            f"{ratio:.2f}",
            f"{speed:.2f}",
            f"{np.median([each['holds'] for each in mine]):.0f}",
            "; ".join(f"{each['seed']}: {each['end']}" for each in mine if each["code"] != 0),
        )
    console.print(table)
    running.store(options.json, found)
    return running.ended(console, kept=kept)


if __name__ == "__main__":
    sys.exit(main())
