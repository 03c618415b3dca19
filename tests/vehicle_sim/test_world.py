"""A world file is the world, or one line says what is wrong with it."""

import itertools
from pathlib import Path
from typing import Any

import pytest

from vehicle_sim.errors import InputError
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import parse_world, read_world

Table = dict[str, Any]
NAN = float("nan")


TREE: Table = {"north_m": 9.0, "east_m": 0.0, "radius_m": 0.5, "height_m": 9.0}
WOOD: Table = {"seed": 1, "spacing_m": [4.0, 8.0], "radius_m": [0.2, 0.4], "height_m": [10.0, 20.0]}
WOOD |= {"north_min_m": 0.0, "north_max_m": 90.0, "east_min_m": 0.0, "east_max_m": 90.0}
SOUTH = dict.fromkeys(("north_min_m", "north_max_m", "east_min_m", "east_max_m"), 1)


def vehicle(**changes: Any) -> Table:
    return {"vehicle": {"kind": "copter", "autopilot": "ideal"} | changes}


def wood(**changes: Any) -> Table:
    return {"woods": [WOOD | changes]}


def peak(**changes: Any) -> Table:
    spreads = {"spread_north_m": 9.0, "spread_east_m": 9.0}
    peaks = [{"north_m": 0.0, "east_m": 0.0, "height_amsl_m": 9.0} | spreads | changes]
    return {"terrain": {"ground_amsl_m": 1.0, "peaks": peaks}}


def lidar(which: str = "lidar", **fields: Any) -> Table:
    return {which: {"range_m": 9.0} | fields}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        # any value: known, there, of its type, in its range, finite, one of its names
        ({"colour": 1}, "colour = 1 ... no such key. Leave it out."),
        (vehicle(speed_mx_m_s=1.0), "vehicle.speed_mx_m_s ... speed_max_m_s"),
        ({"trees": [{"north_m": 1.0}]}, "trees.0.east_m ... missing"),
        (vehicle(speed_max_m_s="fast"), "speed_max_m_s = 'fast' ... number"),
        (vehicle(speed_max_m_s=-1.0), "speed_max_m_s = -1.0 ... greater than 0"),
        (vehicle(kind="balloon"), "kind = 'balloon' ... 'copter'"),
        ({"walls": [{"points_ne_m": [[0.0, 1.0]]}]}, "walls.0.points_ne_m ... at least 2"),
        (lidar(range_m=NAN), "lidar.range_m ... finite"),
        (peak(spread_east_m=1e-300), "peaks.0.spread_east_m = 1e-300 ... 0.01. Correct"),
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
def test_what_is_wrong_is_named_with_its_remedy_in_one_line(
    world_table: Table, changes: Table, words: str
) -> None:
    with pytest.raises(InputError) as caught:
        Simulation(parse_world(world_table | changes))
    message = str(caught.value)
    assert "\n" not in message
    assert all(word in message for word in words.split(" ... ")), message


@pytest.mark.parametrize(
    "content",
    [b"not toml [", b"[targets]\nx = 1\n", b"", b"\xff\xfe\x00", b"a = " + b"[" * 5000],
    ids=range(5),
)
def test_what_is_no_world_file_or_cannot_be_read_is_refused_in_one_line(
    tmp_path: Path, content: bytes
) -> None:
    path = tmp_path / "other.toml"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_world(path)
    assert "\n" not in str(caught.value)
    for unreadable in (tmp_path / "absent.toml", tmp_path):
        with pytest.raises(InputError, match="cannot be read"):
            read_world(unreadable)


def test_limits_and_drag_that_a_file_gives_are_flown_and_with_limits_there_is_no_other_drag(
    world_table: Table,
) -> None:
    parameters = Simulation(parse_world(world_table)).parameters
    assert parameters["WPNAV_SPEED_UP"] == parameters["WPNAV_SPEED_DN"] == 2500.0
    assert (parameters["ANGLE_MAX"], parameters["WPNAV_ACCEL_Z"]) == (8000.0, 500.0)
    world_table["vehicle"]["parameters"] = {"WPNAV_SPEED_UP": 300.0}
    assert Simulation(parse_world(world_table)).parameters["WPNAV_SPEED_UP"] == 300.0
    for autopilot, (key, value, drag_1_s) in itertools.product(
        ("ardupilot", "px4"), (("drag_1_s", 0.3, 0.3), ("speed_max_m_s", 9.0, 0.0))
    ):
        table = world_table | vehicle(autopilot=autopilot, **{key: value})
        simulation = Simulation(parse_world(table))
        for _ in range(10):
            simulation.step()
        copter: Any = simulation.vehicle
        assert (copter.drag_1_s, copter.drag_1_m) == (drag_1_s, 0.0)
