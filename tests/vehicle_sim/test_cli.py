"""A world file and the command line: what they say is flown, or one line says what is wrong.

Also with files and disks that cannot be used, and until a signal ends it.
"""

import itertools
import json
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from clients import Client, Process
from harness import NAN, world

from vehicle_sim import cli
from vehicle_sim.errors import InputError
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import parse_world, read_world

Start, Run = Callable[..., Process], Callable[..., Any]
Table = dict[str, Any]

# --- world files ----------------------------------------------------------------------------------

TREE: Table = {"north_m": 9.0, "east_m": 0.0, "radius_m": 0.5, "height_m": 9.0}
WOOD: Table = {"seed": 1, "spacing_m": [4.0, 8.0], "radius_m": [0.2, 0.4], "height_m": [10.0, 20.0]}
WOOD |= {"north_min_m": 0.0, "north_max_m": 90.0, "east_min_m": 0.0, "east_max_m": 90.0}
PEAK: Table = {"north_m": 0.0, "east_m": 0.0, "height_amsl_m": 9.0, "spread_north_m": 9.0}
SOUTH = dict.fromkeys(("north_min_m", "north_max_m", "east_min_m", "east_max_m"), 1)


def vehicle(**changes: Any) -> Table:
    return {"vehicle": {"kind": "copter", "autopilot": "ideal"} | changes}


def wood(**changes: Any) -> Table:
    return {"woods": [WOOD | changes]}


def lidar(which: str = "lidar", **fields: Any) -> Table:
    return {which: {"range_m": 9.0} | fields}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        # any value: known, there, in its range, finite, one of its names
        ({"colour": 1}, "colour = 1 ... no such key. Leave it out."),
        (vehicle(speed_mx_m_s=1.0), "vehicle.speed_mx_m_s ... speed_max_m_s"),
        ({"trees": [{"north_m": 1.0}]}, "trees.0.east_m ... missing"),
        (vehicle(speed_max_m_s=-1.0), "speed_max_m_s = -1.0 ... greater than 0"),
        (vehicle(kind="balloon"), "kind = 'balloon' ... 'copter'"),
        (lidar(range_m=NAN), "lidar.range_m ... finite"),
        ({"terrain": {"peaks": [PEAK | {"spread_east_m": 1e-300}]}}, "1e-300 ... 0.01. Correct"),
        # whatever a key is
        ({"co\nlour": 1}, r"co\nlour = 1: no such key. Leave it out."),
        (vehicle(parameters={"GUID\nX": 1.0}), r"GUID\nX = 1.0"),
        # what does not go together
        (vehicle(bank_max_deg=30.0), "bank_max_deg = 30.0 ... no such limit"),
        ({"terrain": {"file": "a.tif", "ground_amsl_m": 1.0}}, "terrain.file ... not both"),
        ({"terrain": {"combine": "sum"}}, "terrain.file = None ... ground_amsl_m"),
        ({"terrain": {"file": "a.tif"}}, "area ... missing"),
        ({"area": SOUTH}, "area = (1 ... Swap"),
        (wood(east_min_m=95.0), "woods.0 ... least must lie below"),
        (wood(spacing_m=[0.01, 1.0]), "woods.0.spacing_m ... 200000 trees"),
        (wood(spacing_m=[8.0, 4.0]), "woods.0.spacing_m ... least first"),
        ({"name": "two\nlines"}, r"name = 'two\nlines': is not printable"),
        (lidar() | lidar("second_lidar"), "lidar.component_id ... another lidar's"),
        (lidar(min_m=9.0), "lidar.min_m = 9.0 ... range_m"),
        (lidar(component_id=100), "lidar.component_id ... radar"),
        # and what only the vehicle knows
        (vehicle(autopilot="px4") | lidar(output="autopilot"), "lidar.output ... px4 none"),
        (vehicle(autopilot="sparow"), "autopilot = 'sparow': must be 'ardupilot' or"),
        (vehicle(parameters={"GUID_TIMOUT": 1.0}), "GUID_TIMOUT = 1.0 ... mean GUID_TIMEOUT?"),
        ({"trees": [TREE | {"north_m": 0.3}]}, "vehicle.north_m ... stands inside"),
    ],
)
def test_a_wrong_world_is_named_with_its_remedy_in_one_line(changes: Table, words: str) -> None:
    table = world(scanner={"component_id": 100, "range_m": 5000.0})
    with pytest.raises(InputError) as caught:
        Simulation(parse_world(table | changes))
    message = str(caught.value)
    assert "\n" not in message
    assert all(word in message for word in words.split(" ... ")), message


def test_what_is_no_world_file_is_refused_in_one_line(tmp_path: Path) -> None:
    contents = (b"not toml [", b"[targets]\nx = 1\n", b"", b"\xff\xfe\x00", b"a = " + b"[" * 5000)
    paths = [tmp_path, tmp_path / "absent.toml"]
    for number, content in enumerate(contents):
        paths.append(tmp_path / f"{number}.toml")
        paths[-1].write_bytes(content)
    for path in paths:
        with pytest.raises(InputError, match=r"\A.*(cannot be read|no such key|missing).*\Z"):
            read_world(path)


def test_limits_and_drag_of_a_file_are_flown_and_with_limits_there_is_no_other_drag() -> None:
    limits = {"acceleration_max_m_s2": 10.0, "speed_vertical_max_m_s": 25.0}
    limits["acceleration_vertical_max_m_s2"] = 5.0
    for own, up_cm_s in ({}, 2500.0), ({"WPNAV_SPEED_UP": 300.0}, 300.0):
        parameters = Simulation(parse_world(world(**limits, **own))).parameters
        assert (parameters["WPNAV_SPEED_UP"], parameters["WPNAV_SPEED_DN"]) == (up_cm_s, 2500.0)
        assert (parameters["ANGLE_MAX"], parameters["WPNAV_ACCEL_Z"]) == (8000.0, 500.0)
    for autopilot, (key, value, drag_1_s) in itertools.product(
        ("ardupilot", "px4"), (("drag_1_s", 0.3, 0.3), ("speed_max_m_s", 9.0, 0.0))
    ):
        simulation = Simulation(parse_world(world(autopilot, **{key: value})))
        for _ in range(10):
            simulation.step()
        copter: Any = simulation.vehicle
        assert (copter.drag_1_s, copter.drag_1_m) == (drag_1_s, 0.0)


# --- the program as a person or a script starts it ------------------------------------------------

WORLD = cli.bundled_worlds()["environment-1"]


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
        ("atlantis", "WORLD = 'atlantis' ... environment-1 ... environment-2"),
        ("WORLD --connect tcp:1.2.3.4:5", "--connect = 'tcp:1.2.3.4:5' ... udpout:HOST"),
        ("WORLD --connect udpout:no.such.host.invalid:5", "no.such.host.invalid"),
        ("WORLD --lockstep --speedup 2", "--speedup = 2.0 ... Leave out one"),
        ("WORLD --speedup 0", "--speedup = 0.0 ... 0.01"),
        ("WORLD --out WORLD/below", "--out ... cannot be written"),
        ("WORLD --nonsense", "--nonsense"),
        ("WORLD --autopilot px4", "--autopilot = 'px4' ... Leave out one"),
        ("--autopilot betaflight", "'--autopilot' ... 'betaflight' ... 'px4'"),
        ("--home 47,8", "--home = '47,8' ... LAT,LON,ALT,HEADING"),
        ("--home 97,8,0,0", "--home = '97,8,0,0' ... 85 deg"),
        ("--param GUID_TIMEOUT", "--param = 'GUID_TIMEOUT' ... NAME=VALUE"),
        ("--param MAV_SYSID=4.5", "MAV_SYSID = 4.5 ... whole number"),
        ("--autopilot px4 --param MAV_COMP_ID=255", "MAV_COMP_ID = 255.0 ... 1 to 254"),
        ("--param MAV_SYSID=200 --count 99", "--count = 99: must be from 1 to 55 ... end at 254"),
        ("--faults no-such-file", "--faults = 'no-such-file' ... cannot be read"),
        ("--faults WORLD", "world.toml:6 ... Write for example"),
    ],
)
def test_what_cannot_be_done_is_one_line_and_code_2(run: Run, arguments: str, words: str) -> None:
    code, out, err = run(*(each.replace("WORLD", str(WORLD)) for each in arguments.split()))
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert err.startswith("error: ")
    assert all(word in err for word in words.split(" ... ")), err


def test_a_run_ends_with_its_figures_and_truth(run: Run, companion: Client, tmp_path: Path) -> None:
    folder = tmp_path / "new" / "run"
    code, out, err = run(
        *(WORLD, "--connect", companion.endpoint, "--seed", "7"),
        *("--speedup", "50", "--duration", "5", "--out", folder),
    )
    assert (code, err) == (0, "")
    first, *_, last = out.splitlines()
    assert first.startswith("environment-1: copter with ideal as system 1")
    assert "5.0 s of vehicle time" in last
    assert "STABILIZE, disarmed, on the ground" in last
    header, *rows = map(json.loads, (folder / "truth.jsonl").read_text("utf-8").splitlines())
    assert (header["seed"], len(rows), rows[-1]["t_s"]) == (7, 51, 5.0)
    code, _, err = run(WORLD, "--out", folder)  # nothing recorded is written over
    assert (code, "truth.jsonl of another flight" in err) == (2, True)


def test_a_full_disk_does_not_end_a_flight(start: Start, run: Run, tmp_path: Path) -> None:
    """Neither that of its truth, which is cut, nor that of what it prints."""
    arguments = (WORLD, "--speedup", "50", "--duration", "20", "--out", tmp_path)
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
    start: Start, companion: Client, tmp_path: Path, number: int, clock: list[str]
) -> None:
    process = start(
        *(WORLD, "--connect", companion.endpoint, "--out", tmp_path, *clock),
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
