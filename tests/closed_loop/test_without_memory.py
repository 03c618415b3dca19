"""A companion that is killed in flight, and whose memory cannot be read by the one that follows."""

import contextlib
import itertools
import json
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from flights import ROOT, Flight, free_port, run, warm_up
from pymavlink.dialects.v20 import all as wire

pytestmark = pytest.mark.closed_loop

PATIENCE_S = 120.0
LOOK_S = 0.01


@pytest.fixture
def processes() -> Iterator[list[subprocess.Popen[str]]]:
    started: list[subprocess.Popen[str]] = []
    yield started
    for process in started:
        if process.poll() is None:
            process.kill()
            process.communicate()


def truncate(folder: Path) -> None:
    file = folder / "resume.json"
    file.write_bytes(file.read_bytes()[:300])


def another_version(folder: Path) -> None:
    file = folder / "resume.json"
    file.write_text(json.dumps({**json.loads(file.read_bytes()), "version": 99}), encoding="utf-8")
    (folder / "known.npz").write_bytes(b"")


def is_in_a_leg(folder: Path) -> bool:
    try:
        now = json.loads((folder / "resume.json").read_bytes())["values"]
    except (OSError, ValueError):
        return False
    return bool(now["phase"] == "FLYING" and now["leg"] is not None and now["legs_flown"] >= 1)


def mission_in(folder: Path, name: str) -> Path:
    text = (ROOT / "companion" / "environments" / name / "mission.toml").read_text("utf-8")
    file = folder / f"{name}.toml"
    file.write_text(text + "\n[battery]\nreserve_percent = 2\n", encoding="utf-8")
    return file


def logged(folder: Path) -> list[Any]:
    data, at, found = (folder / "flight.tlog").read_bytes(), 0, []
    parser = wire.MAVLink(None)
    while at < len(data):
        size = 12 + data[at + 9]
        found.append(parser.decode(bytearray(data[at + 8 : at + 8 + size])))
        at += 8 + size
    assert at == len(data)
    return found


@pytest.mark.parametrize(
    ("name", "damage"),
    [
        ("sitl-arducopter", truncate),
        pytest.param("sitl-px4", another_version, marks=pytest.mark.nightly),
    ],
)
def test_it_takes_over_says_so_never_arms_and_arrives(
    tmp_path: Path,
    processes: list[subprocess.Popen[str]],
    name: str,
    damage: Callable[[Path], None],
) -> None:
    warm_up()
    folder, mission, port = tmp_path / "run", mission_in(tmp_path, name), free_port()

    def companion() -> subprocess.Popen[str]:
        options = ("--lockstep", "--out", folder, "--resume", "--system", "1")
        processes.append(
            run("companion", "fly", mission, *options, "--connect", f"udpin:127.0.0.1:{port}")
        )
        return processes[-1]

    first = companion()
    connect = ("--connect", f"udpout:127.0.0.1:{port}")
    simulator = run("vehicle-sim", name, "--lockstep", "--out", folder, *connect)
    processes.append(simulator)
    give_up_s = time.monotonic() + PATIENCE_S
    while not is_in_a_leg(folder):
        assert time.monotonic() < give_up_s
        with contextlib.suppress(subprocess.TimeoutExpired):  # a file has no event to wait for
            first.wait(LOOK_S)
            raise AssertionError(first.communicate()[0])
    first.send_signal(signal.SIGKILL)
    first.communicate()
    log, journal = folder / "flight.tlog", folder / "journal.jsonl"
    recorded = (log.read_bytes(), journal.read_bytes())
    damage(folder)
    torn, known = (folder / "resume.json").read_bytes(), (folder / "known.npz").read_bytes()

    flight = Flight(folder=folder, companion=companion(), simulator=simulator)
    flight.wait()
    said = flight.said["companion"]
    assert flight.companion.returncode == 0, said
    assert said.count("warning: taking over without memory of the flight: resume.json") == 1
    assert flight.outcome == "arrived"
    assert (folder / "resume.lost-1.json").read_bytes() == torn
    assert (folder / "known.lost-1.npz").read_bytes() == known
    for file, before in zip((log, journal), recorded, strict=True):
        whole = before[: before.rindex(b"\n") + 1] if file is journal else before[:-288]
        assert file.read_bytes().startswith(whole), f"{file.name} was written over"

    heads = [k for k, entry in enumerate(flight.journal) if "schema" in entry]
    later = flight.journal[heads[1] :]
    assert later[0]["resumed"] == 1
    assert not [entry for entry in later if entry.get("kind") in ("arm", "take off")]
    [warning] = [
        entry["text"]
        for entry in later
        if entry.get("kind") == "say" and "without memory" in entry["text"]
    ]
    frames = logged(folder)
    texts = "".join(each.text for each in frames if each.get_type() == "STATUSTEXT")
    assert warning in texts
    armed = [row["armed"] for row in flight.truth]
    assert [after for before, after in itertools.pairwise(armed) if before != after][:1] == [True]
