"""Two companions with the same ids on one port; and a router that sends back what it is given."""

import contextlib
import json
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from flights import run, warm_up
from router import Router

pytestmark = [pytest.mark.closed_loop, pytest.mark.xdist_group("two companions")]

PATIENCE_S = 120.0
LOOK_S = 0.05
WHY = "another companion with our ids is on the link"


@pytest.fixture
def processes() -> Iterator[list[subprocess.Popen[str]]]:
    started: list[subprocess.Popen[str]] = []
    yield started
    for process in started:
        if process.poll() is None:
            process.kill()
            process.communicate()


def journal_of(folder: Path) -> list[dict[str, Any]]:
    try:
        lines = (folder / "journal.jsonl").read_text(encoding="utf-8").splitlines()
    except OSError:
        return []
    return [json.loads(line) for line in lines if line.endswith("}")]


def until(folder: Path, companion: subprocess.Popen[str], **wanted: Any) -> None:
    """Wait for a journal entry with these values."""
    give_up_s = time.monotonic() + PATIENCE_S
    while not [entry for entry in journal_of(folder) if wanted.items() <= entry.items()]:
        assert time.monotonic() < give_up_s, wanted
        with contextlib.suppress(subprocess.TimeoutExpired):  # a file has no event to wait for
            companion.wait(LOOK_S)
            raise AssertionError(companion.communicate()[0])


def frames_of(datagram: bytes) -> Iterator[bytes]:
    """The frames in it: unsigned, of the second protocol."""
    while datagram:
        size = 12 + datagram[1]
        yield datagram[:size]
        datagram = datagram[size:]


def test_a_router_that_reflects_raises_no_alarm(
    tmp_path: Path, processes: list[subprocess.Popen[str]]
) -> None:
    warm_up()
    folder = tmp_path / "run"
    with Router(reflects=True) as router:
        port = f"udpout:127.0.0.1:{router.port}"
        companion = run("companion", "fly", "sitl-px4", "--connect", port, "--out", folder)
        processes.append(companion)
        speed = ("--speedup", "3", "--out", tmp_path / "truth")
        processes.append(run("vehicle-sim", "sitl-px4", "--connect", port, *speed))
        until(folder, companion, kind="plan asked", plan_id=2)
        companion.send_signal(signal.SIGINT)
        companion.communicate(timeout=PATIENCE_S)
    assert companion.returncode == 130
    assert "another companion" not in {entry.get("kind") for entry in journal_of(folder)}
    sent = [each for data in router.passed for each in frames_of(data) if each[6] == 195]
    heard = (folder / "flight.tlog").read_bytes()
    back = [frame for frame in sent if heard.count(frame) == 2]  # as it was sent, and as it came
    assert len(back) > 0.9 * len(sent) > 100


def test_the_second_companion_ends_and_the_first_flies_on(
    tmp_path: Path, processes: list[subprocess.Popen[str]]
) -> None:
    warm_up()
    with Router() as router:
        port = f"udpout:127.0.0.1:{router.port}"

        def flies(name: str) -> subprocess.Popen[str]:
            options = ("--connect", port, "--out", tmp_path / name, "--system", "1")
            processes.append(run("companion", "fly", "sitl-px4", *options))
            return processes[-1]

        first = flies("first")
        speed = ("--speedup", "2", "--out", tmp_path / "truth")
        processes.append(run("vehicle-sim", "sitl-px4", "--connect", port, *speed))
        until(tmp_path / "first", first, kind="leg", number=1)

        second = flies("second")
        said, _ = second.communicate(timeout=PATIENCE_S)
        assert second.returncode == 1
        assert f"error: {WHY}. End one of the two" in said
        looks = run("companion", "preflight", "sitl-px4", "--connect", port, "--system", "1")
        processes.append(looks)
        said, _ = looks.communicate(timeout=PATIENCE_S)
        assert looks.returncode == 1
        assert "another companion with our ids" in said

        until(tmp_path / "first", first, kind="another companion")
        assert first.poll() is None
        first.send_signal(signal.SIGINT)
        first.communicate(timeout=PATIENCE_S)
    kinds = [entry.get("kind") for entry in journal_of(tmp_path / "second")]
    assert not {"set mode", "arm", "take off", "setpoint refused"} & set(kinds)
    mine = journal_of(tmp_path / "first")
    heard = next(k for k, entry in enumerate(mine) if entry.get("kind") == "another companion")
    stopped = next(k for k, entry in enumerate(mine) if entry.get("kind") == "stop asked")
    held = [entry for entry in mine[heard:stopped] if entry.get("phase") == "holding"]
    assert held == []
    says = [entry for entry in mine[:stopped] if WHY in entry.get("text", "")]
    assert 1 <= len(says) <= 2  # the second, then preflight
