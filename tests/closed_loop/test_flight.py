import itertools
import json
import math
import subprocess
import sys
from pathlib import Path

import pytest
import true_track
from flights import BIN, EACH_ENVIRONMENT, ROOT, Flight, Launch, free_port, interrupt

pytestmark = pytest.mark.closed_loop

HILLS = str(Path(__file__).parent / "hills" / "world.toml")
HILLS_MISSION = str(Path(__file__).parent / "hills" / "mission.toml")
ENVIRONMENTS = ROOT / "companion" / "environments"


def wait_for(flight: Flight, text: str) -> None:
    """Read what the companion says until it says this."""
    assert flight.companion.stdout is not None
    for line in flight.companion.stdout:
        if text in line:
            return
    pytest.fail(f"the companion ended without saying {text!r}")


@EACH_ENVIRONMENT
def test_a_flight_arrives_and_its_true_track_keeps_every_bound(flown: Launch, name: str) -> None:
    flight = flown(name, name)
    assert flight.companion.returncode == 0, flight.said["companion"]
    assert flight.simulator.returncode == 0, flight.said["simulator"]
    folder = ENVIRONMENTS / name
    truth = flight.folder / "truth.jsonl"
    track = true_track.judge_files(folder / "world.toml", folder / "mission.toml", truth)
    assert track.ok, [str(check) for check in track.violations]
    assert flight.outcome == "arrived"
    assert flight.truth[-1]["mode"] == "BRAKE"


@pytest.mark.xdist_group("hills")
def test_the_same_seed_writes_the_same_journal_and_another_seed_another(flown: Launch) -> None:
    journals = {
        name: (flown(HILLS, HILLS_MISSION, *options).folder / "journal.jsonl").read_bytes()
        for name, options in {
            "once": ("--seed", "3"),
            "again": ("--seed", "03"),
            "another": ("--seed", "4"),
        }.items()
    }
    assert journals["once"] == journals["again"]
    lines = {name: journal.splitlines()[1:] for name, journal in journals.items()}
    assert lines["once"] != lines["another"]


@pytest.mark.xdist_group("hills")
def test_mavlogdump_reads_the_stream_of_setpoints(flown: Launch) -> None:
    flight = flown(HILLS, HILLS_MISSION, "--seed", "3")
    dump = subprocess.run(
        [
            *(sys.executable, "-W", "ignore", BIN / "mavlogdump.py", "--format", "json"),
            *("--types", "SET_POSITION_TARGET_GLOBAL_INT", flight.folder / "flight.tlog"),
        ],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    setpoints = [json.loads(line)["data"] for line in dump.stdout.splitlines()]
    assert len(setpoints) > 1000
    assert {each["coordinate_frame"] for each in setpoints} == {5}
    assert {each["type_mask"] for each in setpoints} == {2496}
    times = [each["time_boot_ms"] for each in setpoints]
    assert all(after - before == 100 for before, after in itertools.pairwise(times))


def test_the_paper_profile_flies_too(flown: Launch) -> None:
    flight = flown(HILLS, HILLS_MISSION, "--profile", "paper")
    assert flight.companion.returncode == 0, flight.said["companion"]
    assert flight.journal[0]["profile"] == "paper"


def test_a_vehicle_that_vanishes_ends_the_flight_with_a_reason(start: Launch) -> None:
    flight = start(HILLS, HILLS_MISSION)
    wait_for(flight, "subpath  1")
    flight.simulator.kill()
    flight.wait()
    assert flight.companion.returncode == 75
    assert flight.said["companion"].splitlines()[-1].startswith("error: the vehicle fell silent.")
    assert flight.outcome == "failed"


def test_a_vehicle_whose_companion_dies_stops_by_itself(start: Launch) -> None:
    flight = start(HILLS, HILLS_MISSION, clock=("--speedup", "20"))
    wait_for(flight, "subpath  1")
    flight.companion.kill()
    flight.companion.wait(timeout=10)
    last = flight.truth[-1]["t_s"]
    truth = flight.folder / "truth.jsonl"
    with truth.open(encoding="utf-8") as lines:  # grows until the vehicle is told to end
        lines.seek(0, 2)
        states: list[dict[str, float]] = []
        while not states or states[-1]["t_s"] < last + 40.0:
            assert flight.simulator.poll() is None
            line = lines.readline()
            if line.endswith("\n") and line.startswith("{") and line.rstrip().endswith("}"):
                states.append(json.loads(line))
    speed = max(abs(states[-1][f"velocity_{axis}_m_s"]) for axis in ("north", "east", "up"))
    assert speed < 0.5
    flight.simulator.terminate()
    flight.wait()
    assert flight.simulator.returncode == 0


def test_an_interrupted_companion_leaves_the_vehicle_in_its_hold_mode(start: Launch) -> None:
    flight = start(HILLS, HILLS_MISSION)
    wait_for(flight, "subpath  1")
    interrupt(flight.companion)
    flight.wait()
    assert flight.companion.returncode == 130, flight.said["companion"]
    assert flight.simulator.returncode == 0, flight.said["simulator"]
    assert flight.truth[-1]["mode"] == "BRAKE"
    assert flight.outcome == "stopped"


def test_no_vehicle_is_said_within_ten_seconds(tmp_path: Path) -> None:
    done = subprocess.run(
        [
            *(BIN / "companion", "fly", HILLS_MISSION, "--out", tmp_path / "run"),
            *("--connect", f"udpin:127.0.0.1:{free_port()}"),
        ],
        capture_output=True,
        text=True,
        check=False,
        timeout=30,
    )
    assert done.returncode == 1
    assert "no vehicle was heard within 10 s" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def edited(source: str, target: Path, old: str, new: str) -> str:
    """A file with one thing changed."""
    text = Path(source).read_text(encoding="utf-8")
    assert text.count(old) == 1
    target.write_text(text.replace(old, new), encoding="utf-8")
    return str(target)


def test_a_mission_that_ends_with_a_landing_ends_on_the_ground(
    start: Launch, tmp_path: Path
) -> None:
    mission = edited(HILLS_MISSION, tmp_path / "land.toml", 'action = "hold"', 'action = "land"')
    flight = start(HILLS, mission)
    flight.wait()
    assert flight.companion.returncode == 0, flight.said["companion"]
    assert flight.truth[-1]["landed"]
    assert not flight.truth[-1]["armed"]


def test_nothing_is_flown_on_sight_that_the_radar_does_not_have(
    start: Launch, tmp_path: Path
) -> None:
    """What lies beyond the radar's own range is unknown, not sheltered."""
    world = edited(HILLS, tmp_path / "short.toml", "range_m = 20000.0", "range_m = 8000.0")
    mission = edited(
        HILLS_MISSION,
        tmp_path / "mission.toml",
        "planning_time_s = 5.0",
        "planning_time_s = 5.0\nevaluations = 300",
    )
    flight = start(world, mission)
    flight.wait()
    assert "radar sees 8.0 km of R = 20.0 km" in [entry.get("text") for entry in flight.journal]
    scanned: list[tuple[float, float]] = []
    for entry in flight.journal:
        if entry.get("kind") == "scan":
            scanned.append(entry["centre_nea_m"][:2])
        elif entry.get("kind") == "plan ready":
            end = entry["control_nea_m"][-1][:2]
            assert min(math.dist(end, centre) for centre in scanned) < 8_000.0
    assert scanned
