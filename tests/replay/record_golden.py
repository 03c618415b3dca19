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
from companion.replay.feed import flown_mission, outputs
from companion.replay.shadow import watch
from companion.telemetry import inputs

_ROOT = Path(__file__).parents[2]


def main(arguments: list[str]) -> int:
    """scripts/update-goldens [--fly] [NAME...]."""
    if os.environ.get("CI"):
        sys.stderr.write("error: goldens are updated by a person, who reads what changes\n")
        return 2
    names = [name for name in arguments if name != "--fly"] or list(NAMES)
    for name in sorted(set(names) - {path.name for path in GOLDENS.iterdir()}):
        known = f"One of: {', '.join(NAMES)}"
        sys.stderr.write(f"error: NAME = {name!r}: no such golden. {known}\n")
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
    """Fly it again, or watch the flight of a log, and keep what the session was told until then."""
    told, until_s = list[inputs.Input](), float(how["until_s"])
    if "log" in how:

        def keep(at_s: float, output: Output) -> None:
            told.extend(output.inputs if at_s <= until_s else ())

        mission = load_mission(str(folder / "mission.toml"))
        watch(recording(how["log"]), mission, on_output=keep)
    else:
        with tempfile.TemporaryDirectory() as name:
            scratch = Path(name)
            for file, text in texts(folder, how).items():
                (scratch / file).write_text(text, encoding="utf-8")
            (_kill if "killed_after_wall_s" in how else _fly)(how, scratch)
            shutil.copy(scratch / "run" / "mission.toml", folder / "mission.toml")
            for each, session, _ in outputs(scratch / "run", flown_mission(scratch / "run")):
                if session.now_s > until_s:
                    break
                told.append(each)
    (folder / inputs.FILE).write_bytes(b"".join(inputs.packed((inputs.HEADER, *told))))


def texts(folder: Path, how: dict[str, Any]) -> dict[str, str]:
    """What is flown: world and mission of the golden itself, or those that its recipe names."""
    found = {}
    for kind in ("world", "mission"):
        path = _ROOT / how[kind] if kind in how else folder / f"{kind}.toml"
        found[path.name] = path.read_text(encoding="utf-8")
        for old, new in how.get("replaced", {}).items():
            found[path.name] = found[path.name].replace(old, new)
    return found


def _fly(how: dict[str, Any], scratch: Path) -> None:
    """In this process: with faults by vehicle time, and what happens so long after it flies."""
    world, mission = scratch / "world.toml", scratch / "mission.toml"
    faults = "\n".join(how.get("faults", ()))
    files = FlightFiles(world=world, mission=mission, faults=faults, folder=scratch / "run")
    flying = Flying(files, seed=how.get("seed", 1), limit_s=900.0)
    while flying.loop.session.state.phase is not Phase.FLYING:
        flying.fly_on(1e6 * (flying.now_s + 0.1))
    began_s = flying.now_s
    for at_s, what in how.get("happens", ()):
        flying.fly_on(1e6 * (began_s + at_s))
        name, *words = what.split()
        if name == "companion_off":
            flying.die(float(words[1]))
        else:
            flying._vehicle.add_fault(what)
    flying.fly_on(1e6 * how["until_s"])
    flying.close()


def _kill(how: dict[str, Any], scratch: Path) -> None:
    """Both programs, over UDP in real time; the companion is killed once and started again."""
    (scratch / "faults.txt").write_text("\n".join(how["faults"]) + "\n", encoding="utf-8")
    files = (scratch / name for name in ("run", "world.toml", "mission.toml"))
    faults = ("--faults", scratch / "faults.txt")
    flight = launch(*files, clock=("--speedup", "10"), simulator_options=faults)
    try:
        time.sleep(how["killed_after_wall_s"])
        flight.companion.kill()
        flight.companion = program(*flight.companion.process.args, "--resume")
        time.sleep(how["killed_after_wall_s"])
        flight.companion.interrupt(60.0)
        flight.companion.wait()
    finally:
        flight.kill()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
