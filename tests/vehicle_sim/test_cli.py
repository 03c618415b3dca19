"""The program as a person or a script starts it."""

import json
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from clients import Client, Process

from vehicle_sim import cli

Start = Callable[..., Process]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Any]:
    """main() in this process -> exit code, stdout, stderr."""

    def begin(*arguments: object) -> tuple[Any, str, str]:
        monkeypatch.setattr("sys.argv", ["vehicle-sim", *map(str, arguments)])
        with pytest.raises(SystemExit) as exited:
            cli.main()
        said = capsys.readouterr()
        return exited.value.code, said.out, said.err

    return begin


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["atlantis"], ["WORLD = 'atlantis'", "environment-1", "environment-2"]),
        (["WORLD", "--connect", "tcp:1.2.3.4:5"], ["--connect = 'tcp:1.2.3.4:5'", "udpout:HOST"]),
        (["WORLD", "--connect", "udpout:no.such.host.invalid:5"], ["no.such.host.invalid"]),
        (["WORLD", "--lockstep", "--speedup", "2"], ["--speedup = 2.0", "Leave out one"]),
        (["WORLD", "--speedup", "0"], ["--speedup = 0.0", "0.01"]),
        (["WORLD", "--out", "FILE/below"], ["--out", "cannot be written"]),
        (["WORLD", "--nonsense"], ["--nonsense"]),
        (["WORLD", "--autopilot", "px4"], ["--autopilot = 'px4'", "Leave out one"]),
        (["--autopilot", "betaflight"], ["'--autopilot'", "'betaflight'", "'px4'"]),
        (["--home", "47,8"], ["--home = '47,8'", "LAT,LON,ALT,HEADING"]),
        (["--home", "97,8,0,0"], ["--home = '97,8,0,0'", "85 deg"]),
        (["--param", "GUID_TIMEOUT"], ["--param = 'GUID_TIMEOUT'", "NAME=VALUE"]),
        (["--param", "GUID_TIMEOUTS=1"], ["GUID_TIMEOUTS = 1.0", "Did you mean GUID_TIMEOUT?"]),
        (["--param", "MAV_SYSID=4.5"], ["MAV_SYSID = 4.5", "whole number"]),
        (["--autopilot", "px4", "--param", "MAV_COMP_ID=255"], ["MAV_COMP_ID = 255.0", "1 to 254"]),
        (["--param", "MAV_SYSID=200", "--count", "99"], ["--count = 99", "end at 254"]),
        (["--param", "MAV_SYSID=253", "--count", "5"], ["must be from 1 to 2:", "Give another"]),
        (["--faults", "no-such-file"], ["--faults = 'no-such-file'", "cannot be read"]),
        (["--faults", "WORLD"], ["world.toml:1", "Write for example"]),
    ],
)
def test_what_cannot_be_done_is_one_line_and_exit_code_2(
    run: Callable[..., Any], world_file: Path, arguments: list[str], words: list[str]
) -> None:
    named = [
        a.replace("WORLD", str(world_file)).replace("FILE", str(world_file)) for a in arguments
    ]
    code, out, err = run(*named)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert err.startswith("error: ")
    assert all(word in err for word in words), err


def test_a_run_ends_after_its_duration_with_its_figures_and_its_truth(
    run: Callable[..., Any], world_file: Path, companion: Client, tmp_path: Path
) -> None:
    folder = tmp_path / "new" / "run"
    code, out, err = run(
        *(world_file, "--connect", companion.endpoint),
        *("--speedup", "50", "--duration", "5", "--out", folder, "--seed", "7"),
    )
    assert (code, err) == (0, "")
    first, *_, last = out.splitlines()
    assert first.startswith("test: copter with ideal as system 1")
    assert "5.0 s of vehicle time" in last
    assert "STABILIZE, disarmed, on the ground" in last
    header, *rows = map(json.loads, (folder / "truth.jsonl").read_text("utf-8").splitlines())
    assert (header["seed"], len(rows), rows[-1]["t_s"]) == (7, 51, 5.0)
    code, _, err = run(world_file, "--out", folder)  # nothing recorded is written over
    assert (code, "truth.jsonl of another flight" in err) == (2, True)


def test_a_full_disk_does_not_end_a_flight(
    start: Start, run: Callable[..., Any], world_file: Path, tmp_path: Path
) -> None:
    """Neither that of its truth, which is cut, nor that of what it prints."""
    arguments = (world_file, "--speedup", "50", "--duration", "20", "--out", tmp_path)
    with Path("/dev/full").open("w") as full:
        (tmp_path / "truth.jsonl").symlink_to(full.name)
        assert start(*arguments, stdout=full).result() == (0, None, "")
    code, out, err = run(*arguments)
    assert (code, err) == (0, "")
    assert out.count("truth.jsonl stopped: No space left on device") == 1


@pytest.mark.parametrize(
    ("number", "clock"), [(signal.SIGTERM, ["--lockstep"]), (signal.SIGINT, [])]
)
def test_a_signal_ends_it_cleanly_even_where_sigint_was_ignored(
    start: Start, world_file: Path, companion: Client, tmp_path: Path, number: int, clock: list[str]
) -> None:
    process = start(
        *(world_file, "--connect", companion.endpoint, "--out", tmp_path, *clock),
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN),
    )
    companion.wait_for(lambda m: m.get_type() == "HEARTBEAT")
    process.send_signal(number)
    code, out, err = process.result()
    assert (code, err) == (0, "")
    assert "x real time" in out.splitlines()[-1]
    lines = (tmp_path / "truth.jsonl").read_text(encoding="utf-8").splitlines()
    assert len(lines) >= 2
    assert all(json.loads(line) for line in lines)
