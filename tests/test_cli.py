"""The command line: what goes wrong is one line and an exit code, which a service reads."""

import io
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
from programs import BIN, ROOT, Program, free_port

import companion
from companion import cli
from companion.config import load_mission
from companion.errors import FlightFailed, FlightInterrupted, InputError
from companion.mission.state import Reason
from companion.runtime import loop
from companion.runtime.compiler import load_kernel
from companion.session import Session
from companion.telemetry.flight_summary import FlightSummary

COMPANION = BIN / "companion"
HILLS = Path(__file__).parent / "closed_loop" / "hills"
STOPPED, CRASHED = 130, 70


@pytest.fixture
def hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    """The wall clock goes ten times as fast: a vehicle that does not come is not waited for.

    Nor is a planner that has to be compiled.
    """
    load_kernel()
    real = time.monotonic
    monkeypatch.setattr(time, "monotonic", lambda: 10.0 * real())
    monkeypatch.setitem(loop.fly.__kwdefaults__, "clock", time.monotonic)


def connect(port: int) -> tuple[str, str]:
    return ("--connect", f"udpin:127.0.0.1:{port}")


# --- wrong input: one line, and exit code 2


def test_an_input_error_is_field_value_rule_and_remedy_in_one_line_of_printable_text() -> None:
    error = InputError("planner.evaluations", 3, "it must be 60 or more", "Raise it.")
    assert str(error) == "planner.evaluations = 3: it must be 60 or more. Raise it."
    name = b"fl\xe9.plan".decode("utf-8", "surrogateescape")
    said = str(InputError(name, Path("n", name), f"{name} is", f"Move {name}."))
    assert said.count(r"fl\udce9.plan") == 4
    assert said.isascii()


def refused(*arguments: str | Path) -> str:
    """The one line that wrong input is answered with."""
    code, _, said = answered(*arguments)
    assert code == 2, (arguments, said)
    assert len(said.splitlines()) == 1, said
    assert said.startswith("error: ")
    return said


REFUSED = {
    "fly environment-1 --seed -1": "--seed",
    "fly environment-1 --profile bold": "--profile",
    "fly environment-1 environment-2": "environment-2",
    "fly environment-1 --connect 14550": "--connect = '14550'",
    "preflight environment-1 --connect /dev/null,57600": "--connect = '/dev/null,57600'",
    "fly environment-1 --system 0": "--system",
    "preflight environment-1 --system 256": "--system",
    "fly environment-1 --signing-key {key}": "chmod 600",
    "preflight environment-1 --signing-key {key}": "chmod 600",
    "fly environment-1 --resume": "--resume",
    "fly environment-1 --resume --out {key}": "--out",
    "fly environment-1 --resume --out {other}": "mission.toml",
    "fly environment-1 --resume --out {flown}": "MISSION.*of another mission, 'hills'",
    "fly {hills}/mission.toml --out {flown}": "holds a flight already.*--resume",
    "plan environment-1 environment-1 --figure /nowhere/x.png": "--figure",
    "plan environment-1 environment-1 --figure x.jpg": ".png, .svg or .pdf",
    "plan {hills}/world.toml {theirs}": "its targets come from the vehicle",
    "export {hills}": "kml, geojson, csv",
}
"""Of a command and its arguments what is said; of links and keys more in `runtime`."""


@pytest.mark.parametrize("command", REFUSED)
def test_wrong_input_is_one_line_and_exit_code_2(command: str, tmp_path: Path) -> None:
    """And nothing is written; a key that others can read is not shown."""
    key, other, theirs = (tmp_path / name for name in ("key", "other", "theirs.toml"))
    key.write_text("hush hush\n", encoding="utf-8")
    key.chmod(0o644)
    other.mkdir()
    (other / "mission.toml").write_text("[package]\nname = 'x'\n", encoding="utf-8")
    before, _, after = (HILLS / "mission.toml").read_text(encoding="utf-8").partition("[[targets]]")
    theirs.write_text(f"{before}[from_vehicle]\ntargets = true\n\n{after[after.index('[') :]}")
    places = {"key": key, "other": other, "theirs": theirs, "hills": HILLS}
    places["flown"] = kept(tmp_path / "flown", b"{}")
    before_it = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    line = refused(*(word.format(**places) for word in command.split()))
    assert re.search(REFUSED[command], line)
    assert "hush hush" not in line
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before_it


def kept(folder: Path, resume: bytes) -> Path:
    """A run folder of an interrupted flight."""
    folder.mkdir()
    (folder / "mission.toml").write_bytes((HILLS / "mission.toml").read_bytes())
    (folder / "resume.json").write_bytes(resume)
    return folder


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


def test_a_page_on_a_port_that_is_taken(run_dir: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        assert f"--view-port = {port}" in refused("view", run_dir, "--view-port", str(port))


# --- exit codes


def test_the_service_starts_again_what_may_go_on_and_nothing_that_was_decided() -> None:
    text = (ROOT / "deploy" / "companion.service").read_text(encoding="utf-8")
    [prevented] = re.findall(r"^RestartPreventExitStatus=(.*)$", text, re.MULTILINE)
    decided = {FlightFailed.exit_code, InputError.exit_code, STOPPED}
    assert set(map(int, prevented.split())) == decided == {1, 2, 130}
    assert not decided & {FlightInterrupted.exit_code, CRASHED}
    assert "Restart=on-failure" in text
    assert "StartLimitIntervalSec=0" in text  # a vehicle in the air is not given up for trying
    page = (ROOT / "docs" / "in-flight.md").read_text(encoding="utf-8")
    for code in (0, *decided, FlightInterrupted.exit_code, CRASHED):
        assert f"| {code} |" in page


@pytest.mark.parametrize(
    ("part", "raised", "code"),
    [("app", ZeroDivisionError("made up"), CRASHED), ("main", KeyboardInterrupt(), STOPPED)],
)
def test_a_crash_is_a_traceback_with_a_code_of_its_own_and_ctrl_c_is_none(
    part: str, raised: BaseException, code: int, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    """Also while the program is loaded."""

    def breaks(**_: object) -> None:
        raise raised

    monkeypatch.setattr(cli, part, breaks)
    with pytest.raises(SystemExit) as ended:
        companion.main()
    assert ended.value.code == code
    assert ("ZeroDivisionError: made up" in capsys.readouterr().err) == (code == CRASHED)


def test_closed_streams_and_poor_encodings_are_no_crash(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = io.BytesIO()
    monkeypatch.setattr(sys, "stdin", None)
    monkeypatch.setattr(sys, "stderr", None)
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(shown, encoding="ascii"))
    monkeypatch.setattr(sys, "argv", ["companion", "check", "nowhere"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == InputError.exit_code
    with sys.stdin, sys.stderr:
        assert sys.stdin.read() == ""
    sys.stdout.write("run folder: Übung")
    sys.stdout.flush()
    assert shown.getvalue() == rb"run folder: \xdcbung"


@pytest.mark.usefixtures("hurried")
@pytest.mark.parametrize("command", ["fly", "preflight"])
def test_no_vehicle_is_said_within_ten_seconds(command: str, tmp_path: Path) -> None:
    out = ("--out", tmp_path / "run") if command == "fly" else ()
    code, shown, said = answered(command, HILLS / "mission.toml", *out, *connect(free_port()))
    assert code == 1
    told = " ".join((said if command == "fly" else shown).split())
    assert all(words in told for words in ("no vehicle was heard", Reason.NO_VEHICLE.remedy))
    assert ("--connect = 'udpin:127.0.0.1:" in said) == (command == "fly")
    assert len(said.splitlines()) == 1


@pytest.mark.usefixtures("hurried")
def test_what_was_kept_and_cannot_be_read_is_said_and_gone_on_without(tmp_path: Path) -> None:
    """Whatever is wrong with it: tests/telemetry/test_resume.py.

    The mission is the folder's own, whatever has become of the file that it was given as.
    """
    folder = kept(tmp_path / "run", b'{"schema":"companion-resume","vers')
    (folder / "journal.jsonl").write_bytes(b'{"schema":"companion-journal","version":3}\n{"t_')
    (folder / "flight.tlog").write_bytes(b"\x00\x01")
    options = ("--out", folder, "--resume", *connect(free_port()))
    code, said, errors = answered("fly", tmp_path / "gone.toml", *options)
    assert code == 75, errors  # it has flown: a service is to try again
    assert len(errors.splitlines()) == 1
    assert "no vehicle was heard" in errors
    assert said.count("warning: taking over without memory of the flight: resume.json") == 1
    journal = (folder / "journal.jsonl").read_text(encoding="utf-8").splitlines()
    [resumed] = [each for each in map(json.loads, journal) if each.get("kind") == "resumed"]
    assert "resume.json" in resumed["lost"]


def test_a_planner_that_dies_before_a_vehicle_is_heard_is_not_taken_for_a_lack_of_one() -> None:
    session = Session(load_mission("valley"), seed=1, lockstep=False)
    session.part_died("planner", "made up")
    flown = FlightSummary(session=session, end=session.run().end)
    with pytest.raises(FlightFailed, match="planner: made up"):
        cli._exit_as_it_ended(flown, "udpin:127.0.0.1:1")


# --- with a vehicle


@pytest.fixture
def simulated(tmp_path: Path) -> Iterator[int]:
    """The port that a simulated PX4 calls, ten times as fast as real time."""
    port = free_port()
    program, options = COMPANION.with_name("vehicle-sim"), ("--speedup", "10", "--out", tmp_path)
    command = [program, "sitl-px4", *options, "--connect", f"udpout:127.0.0.1:{port}"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
        yield port
        process.kill()


def test_whether_a_vehicle_may_fly_is_told(simulated: int) -> None:
    code, shown, said = answered("preflight", "sitl-px4", *connect(simulated))
    assert (code, said) == (0, "")
    assert "PX4 multicopter, system 1" in shown
    assert "refused" not in shown
    code, shown, said = answered("preflight", "sitl-arducopter", *connect(simulated))
    assert code == 1
    assert "none that this mission is for" in shown
    assert said == "error: 1 of 1 checks refuse the flight\n"


def test_a_shadow_watches_and_never_commands(simulated: int, tmp_path: Path) -> None:
    truth, out = tmp_path / "truth.jsonl", tmp_path / "run"
    journal = out / "journal.jsonl"
    command = (COMPANION, "fly", "sitl-px4", *connect(simulated), "--shadow", "--out", out)
    program = Program("companion", *command, folder=tmp_path, environment=dict(os.environ))
    try:
        program.until(lambda: journal.exists() and b'"phase":"shadow"' in journal.read_bytes())
        rows = len(truth.read_bytes().splitlines())
        later = rows + 150  # ten in a second of the vehicle's
        program.until(lambda: len(truth.read_bytes().splitlines()) > later)
        program.process.send_signal(signal.SIGINT)
        program.expect("outcome")
        assert program.interrupt(60.0) == 130, program.transcript  # while it draws the picture
    finally:
        program.end()
    assert program.transcript.endswith(f"run folder: {out}\n")
    lines = journal.read_text(encoding="utf-8").splitlines()
    kinds = {json.loads(line).get("kind") for line in lines}
    assert not kinds & {"arm", "take off", "set mode"}
