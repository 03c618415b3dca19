import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from answers import answered
from programs import BIN, Program, free_port
from recorded import run_folder

from companion import cli
from companion.config import load_mission
from companion.errors import FlightFailed
from companion.runtime import loop
from companion.session import Session
from companion.telemetry.flight_summary import FlightSummary

COMPANION = BIN / "companion"
HILLS = Path(__file__).parent / "closed_loop" / "hills"
ENVIRONMENTS = Path(__file__).parents[1] / "companion" / "environments"


@pytest.fixture
def hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    """The wall clock goes ten times as fast: a vehicle that does not come is not waited for."""
    real = time.monotonic
    monkeypatch.setattr(time, "monotonic", lambda: 10.0 * real())
    monkeypatch.setitem(loop.fly.__kwdefaults__, "clock", time.monotonic)


def refused(*arguments: str | Path) -> str:
    """The one line that wrong input is answered with."""
    code, _, said = answered(*arguments)
    assert code == 2, (arguments, said)
    assert len(said.splitlines()) == 1, said
    assert said.startswith("error: ")
    return said


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("fly", "nowhere"), "MISSION = 'nowhere'"),
        (("fly", "environment-1", "--seed", "-1"), "--seed"),
        (("fly", "environment-1", "--profile", "bold"), "--profile"),
        (("fly", "environment-1", "environment-2"), "environment-2"),
        (("plan", "environment-1", "environment-1", "--figure", "/nowhere/x.png"), "--figure"),
        (("plan", "environment-1", "environment-1", "--figure", "x.jpg"), ".png, .svg or .pdf"),
        (("export", str(HILLS)), "kml, geojson, csv"),
    ],
    ids=lambda value: value[-1] if isinstance(value, tuple) else "",
)
def test_wrong_input_is_one_line_and_exit_code_2(arguments: tuple[str, ...], words: str) -> None:
    assert words in refused(*arguments)


def test_a_plan_without_a_vehicle_has_targets_of_its_own(tmp_path: Path) -> None:
    before, _, after = (HILLS / "mission.toml").read_text(encoding="utf-8").partition("[[targets]]")
    text = f"{before}[from_vehicle]\ntargets = true\n\n{after[after.index('[') :]}"
    (tmp_path / "mission.toml").write_text(text, encoding="utf-8")
    said = refused("plan", HILLS / "world.toml", tmp_path / "mission.toml")
    assert "its targets come from the vehicle" in said


@pytest.mark.parametrize("command", ["fly", "preflight"])
@pytest.mark.parametrize(
    "option",
    [
        "--connect=14550",
        "--connect=/dev/null,57600",
        "--system=0",
        "--system=256",
        "--signing-key={key}",
    ],
)
def test_so_are_a_link_a_system_and_a_key_that_cannot_be(
    command: str, option: str, tmp_path: Path
) -> None:
    """A key that others can read is not shown.  Each that cannot be: `tests/runtime`."""
    key, out = tmp_path / "key", tmp_path / "run"
    key.write_text("hush hush\n", encoding="utf-8")
    key.chmod(0o644)
    options = (option.format(key=key), *(("--out", out) if command == "fly" else ()))
    line = refused(command, "environment-1", *options)
    assert option.partition("=")[0] in line or "chmod 600" in line
    assert "hush hush" not in line
    assert not out.exists()


def test_so_it_is_of_the_program_and_of_what_cannot_be_printed() -> None:
    command = [COMPANION, "fly", "nowhere"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 2
    assert done.stderr.startswith("error: MISSION = 'nowhere'")
    assert len(done.stderr.splitlines()) == 1
    with Path("/dev/full").open("w") as full:
        asked = [COMPANION, "--version"]
        done = subprocess.run(asked, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    said = "error: the output cannot be written (No space left on device)\n"
    assert (done.returncode, done.stderr) == (2, said)


@pytest.mark.parametrize("how", [("view", str(HILLS)), ("fly", "environment-1", "--view")])
def test_without_what_shows_flights_it_is_named(how: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)  # as if it were not installed
    assert "pip install 'companion[view]'" in refused(*how)


def test_a_page_on_a_port_that_is_taken(tmp_path: Path) -> None:
    folder = run_folder(tmp_path)
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        assert f"--view-port = {port}" in refused("view", folder, "--view-port", str(port))


def kept(folder: Path, resume: bytes) -> Path:
    """A run folder of an interrupted flight."""
    folder.mkdir()
    (folder / "mission.toml").write_bytes((HILLS / "mission.toml").read_bytes())
    (folder / "resume.json").write_bytes(resume)
    return folder


def test_to_go_on_needs_the_folder_of_that_mission(tmp_path: Path) -> None:
    file, other = tmp_path / "file", tmp_path / "other"
    file.write_text("", encoding="utf-8")
    other.mkdir()
    (other / "mission.toml").write_text("[package]\nname = 'x'\n", encoding="utf-8")
    run = kept(tmp_path / "run", b"{}")
    out: tuple[str | Path, ...]
    for out, words in (
        ((), "--resume"),
        (("--out", file), "--out"),
        (("--out", other), "mission.toml"),
        (("--out", run), "MISSION = 'environment-1'.*of another mission, 'hills'"),
    ):
        assert re.search(words, refused("fly", "environment-1", *out, "--resume"))
    line = refused("fly", HILLS / "mission.toml", "--out", run)  # nor is it flown over
    assert re.search("holds a flight already.*--resume", line)


@pytest.mark.usefixtures("hurried")
def test_what_was_kept_and_cannot_be_read_is_said_and_gone_on_without(tmp_path: Path) -> None:
    """Whatever is wrong with it: tests/telemetry/test_resume.py.

    The mission is the folder's own, whatever has become of the file that it was given as.
    """
    torn = b'{"schema":"companion-resume","vers'
    folder = kept(tmp_path / "run", torn)
    (folder / "journal.jsonl").write_bytes(b'{"schema":"companion-journal","version":3}\n{"t_')
    (folder / "flight.tlog").write_bytes(b"\x00\x01")
    options = ("--out", folder, "--resume", *connect(free_port()))
    code, said, errors = answered("fly", tmp_path / "gone.toml", *options)
    assert code == 75, errors  # it has flown: a service is to try again
    assert len(errors.splitlines()) == 1
    assert "no vehicle was heard" in errors
    assert said.count("warning: taking over without memory of the flight: resume.json") == 1
    journal = (folder / "journal.jsonl").read_text(encoding="utf-8").splitlines()
    entries = [json.loads(line) for line in journal]
    [resumed] = [entry for entry in entries if entry.get("kind") == "resumed"]
    assert "resume.json" in resumed["lost"]


def connect(port: int) -> tuple[str, str]:
    return ("--connect", f"udpin:127.0.0.1:{port}")


@pytest.fixture
def simulated(tmp_path: Path) -> Iterator[int]:
    """The port that a simulated PX4 calls, ten times as fast as real time."""
    port = free_port()
    program, options = COMPANION.with_name("vehicle-sim"), ("--speedup", "10", "--out", tmp_path)
    command = [program, "sitl-px4", *options, "--connect", f"udpout:127.0.0.1:{port}"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
        yield port
        process.kill()


def test_whether_a_vehicle_may_fly_is_told(simulated: int, tmp_path: Path) -> None:
    code, shown, said = answered("preflight", "sitl-px4", *connect(simulated))
    assert (code, said) == (0, "")
    assert "PX4 multicopter, system 1" in shown
    assert "refused" not in shown
    mission = (ENVIRONMENTS / "sitl-px4" / "mission.toml").read_text(encoding="utf-8")
    strict = mission.replace('autopilot = "px4"', 'autopilot = "ardupilot"')
    (tmp_path / "mission.toml").write_text(strict, encoding="utf-8")
    code, shown, said = answered("preflight", tmp_path / "mission.toml", *connect(simulated))
    assert code == 1
    assert "none that this mission is for" in shown
    assert said == "error: 1 of 1 checks refuse the flight\n"


@pytest.mark.usefixtures("hurried")
@pytest.mark.parametrize("command", ["fly", "preflight"])
def test_no_vehicle_is_said_within_ten_seconds(command: str, tmp_path: Path) -> None:
    out = ("--out", tmp_path / "run") if command == "fly" else ()
    code, shown, said = answered(command, HILLS / "mission.toml", *out, *connect(free_port()))
    assert code == 1
    assert ("no vehicle was heard within 10 s" in said) == (command == "fly")
    assert ("none was heard" in shown) == (command == "preflight")
    assert len(said.splitlines()) == 1


def test_a_planner_that_dies_before_a_vehicle_is_heard_is_not_taken_for_a_lack_of_one() -> None:
    session = Session(load_mission("valley"), seed=1, lockstep=False)
    session.part_died("planner", "made up")
    flown = FlightSummary(session=session, end=session.run().end)
    with pytest.raises(FlightFailed, match="planner: made up"):
        cli._exit_as_it_ended(flown, "udpin:127.0.0.1:1")


WATCHED_ROWS = 150
"""Ten in a second of the vehicle's."""


def test_a_shadow_watches_and_never_commands(simulated: int, tmp_path: Path) -> None:
    truth, out = tmp_path / "truth.jsonl", tmp_path / "run"
    journal = out / "journal.jsonl"
    command = (COMPANION, "fly", "sitl-px4", *connect(simulated), "--shadow", "--out", out)
    companion = Program("companion", *command, folder=tmp_path, environment=dict(os.environ))
    try:
        companion.until(lambda: journal.exists() and b'"phase":"shadow"' in journal.read_bytes())
        rows = len(truth.read_bytes().splitlines())
        companion.until(lambda: len(truth.read_bytes().splitlines()) > rows + WATCHED_ROWS)
        companion.process.send_signal(signal.SIGINT)
        companion.expect("outcome")
        assert companion.interrupt(60.0) == 130, companion.transcript  # while it draws the picture
    finally:
        companion.end()
    assert companion.transcript.endswith(f"run folder: {out}\n")
    lines = journal.read_text(encoding="utf-8").splitlines()
    kinds = {json.loads(line).get("kind") for line in lines}
    assert not kinds & {"arm", "take off", "set mode"}
