"""Record golden flights anew, or decide them once more: `scripts/update-goldens`."""

import json
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parents[1] / "recordings"))
sys.path.insert(0, str(Path(__file__).parents[1] / "closed_loop"))
from flights import launch
from flights import run as program
from golden import GOLDENS, NAMES, decisions_of, differences, expected
from recordings import recording

from companion.campaign.in_process import FlightFiles, Flying
from companion.config import load_mission
from companion.mavlink.link import Output
from companion.mission.state import Phase
from companion.replay.feed import outputs
from companion.replay.shadow import watch
from companion.telemetry import inputs

_ROOT = Path(__file__).parents[2]


def main(arguments: list[str]) -> int:
    """scripts/update-goldens [--fly] [NAME...]."""
    if os.environ.get("CI"):
        sys.stderr.write("error: goldens are updated by a person, who reads what changes\n")
        return 2
    names = [name for name in arguments if name != "--fly"] or list(NAMES)
    unknown = sorted(set(names) - {path.name for path in GOLDENS.iterdir()})
    if unknown:
        sys.stderr.write(
            f"error: NAME = {unknown[0]!r}: no such golden. One of: {', '.join(NAMES)}\n"
        )
        return 2
    for name in names:
        folder = GOLDENS / name
        if "--fly" in arguments:
            _record(folder, json.loads((folder / "flight.json").read_text(encoding="utf-8")))
        now = list(decisions_of(folder))
        was = expected(folder) if (folder / "decisions.jsonl").exists() else []
        print(f"{name}: {differences(was, now) or 'as it was'}")  # noqa: T201
        text = "".join(json.dumps(line, separators=(",", ":")) + "\n" for line in now)
        (folder / "decisions.jsonl").write_text(text, encoding="utf-8")
    return 0


def _record(folder: Path, how: dict[str, Any]) -> None:
    """Fly it again, and keep what the session was told up to a time."""
    with tempfile.TemporaryDirectory() as scratch:
        run = Path(scratch) / "run"
        if "log" in how:
            _watch(folder, how)
            return
        for file, text in texts(folder, how).items():
            (Path(scratch) / file).write_text(text, encoding="utf-8")
        if "happens" in how:
            _try_out(how, Path(scratch), run)
        else:
            _fly(how, Path(scratch), run)
        shutil.copy(run / "mission.toml", folder / "mission.toml")
        _cut(run, folder / inputs.FILE, float(how["until_s"]))


def texts(folder: Path, how: dict[str, Any]) -> dict[str, str]:
    """What is flown: world and mission of the golden itself, or those that its recipe names."""
    found = {}
    for kind in ("world", "mission"):
        path = _ROOT / how[kind] if kind in how else folder / f"{kind}.toml"
        found[path.name] = path.read_text(encoding="utf-8")
        for old, new in how.get("replaced", {}).items():
            found[path.name] = found[path.name].replace(old, new)
    return found


def _watch(folder: Path, how: dict[str, Any]) -> None:
    """Run somebody's flight in shadow, and keep what the session was told up to a time."""
    told: list[inputs.Input] = []

    def keep(at_s: float, output: Output) -> None:
        if at_s <= float(how["until_s"]):
            told.extend(output.inputs)

    mission = load_mission(str(folder / "mission.toml"))
    watch(recording(how["log"]), mission, on_output=keep)
    (folder / inputs.FILE).write_bytes(b"".join(inputs.packed((inputs.HEADER, *told))))


def _try_out(how: dict[str, Any], scratch: Path, run: Path) -> None:
    """A short flight in this process, with faults so long after it began to fly."""
    world, mission = scratch / "world.toml", scratch / "mission.toml"
    files = FlightFiles(world=world, mission=mission, faults="", folder=run)
    flying = Flying(files, seed=how["seed"], limit_s=900.0)
    while flying.loop.session.state.phase is not Phase.FLYING:
        flying.fly_on(1e6 * (flying.now_s + 0.1))
    began_s = flying.now_s
    for at_s, what in how["happens"]:
        flying.fly_on(1e6 * (began_s + at_s))
        name, *words = what.split()
        if name == "companion_off":
            flying.die(float(words[1]))
        else:
            flying._vehicle.add_fault(what)
    flying.fly_on(1e6 * how["until_s"])
    flying.close()


def _fly(how: dict[str, Any], scratch: Path, run: Path) -> None:
    """Both programs, over UDP; the companion is killed once and started again if it says so."""
    (scratch / "faults.txt").write_text("\n".join(how["faults"]) + "\n", encoding="utf-8")
    killed_s = how.get("killed_after_wall_s")
    flight = launch(
        run,
        scratch / "world.toml",
        scratch / "mission.toml",
        clock=("--lockstep",) if killed_s is None else ("--speedup", "10"),
        simulator_options=("--faults", scratch / "faults.txt"),
    )
    try:
        if killed_s is not None:
            time.sleep(killed_s)
            flight.companion.kill()
            flight.companion = program(*flight.companion.process.args, "--resume")
            time.sleep(killed_s)
            flight.companion.interrupt(60.0)
        flight.companion.wait()
    finally:
        flight.kill()


def _cut(run: Path, to: Path, until_s: float) -> None:
    """The inputs of a flight up to a vehicle time."""
    mission = str(run / "mission.toml")
    told = []
    for each, session, _ in outputs(run, lambda start: load_mission(mission, start.profile)):
        if session.now_s > until_s:
            break
        told.append(each)
    to.write_bytes(b"".join(inputs.packed((inputs.HEADER, *told))))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
