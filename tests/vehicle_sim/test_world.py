import copy
from pathlib import Path
from typing import Any

import pytest

from vehicle_sim.dynamics.copter import Copter
from vehicle_sim.errors import InputError
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import parse_world, read_world

Table = dict[str, Any]


def test_a_world_is_what_its_file_says(world_file: Path) -> None:
    world = read_world(world_file)
    assert world.origin.latitude_deg == 47.0
    assert world.terrain.peaks[0].height_amsl_m == 1200.0
    assert world.radars[0].name == "radar 1"
    assert world.vehicle.parameters == {"GUID_TIMEOUT": 3.0}
    assert world.truth().height_at_amsl_m(3000.0, 4000.0) == 1200.0


def changed(table: Table, path: str, key: str, value: Any, instead_of: str | None = None) -> Table:
    table = copy.deepcopy(table)
    place: Any = table
    for part in path.split(".") if path else []:
        place = place[int(part)] if part.isdigit() else place[part]
    if instead_of is not None:
        del place[instead_of]
    place[key] = value
    return table


@pytest.mark.parametrize(
    ("path", "key", "value", "instead_of", "words"),
    [
        (
            "vehicle",
            "speed_mx_m_s",
            1.0,
            "speed_max_m_s",
            ["vehicle.speed_mx_m_s", "speed_max_m_s"],
        ),
        ("vehicle.parameters", "GUID_TIMEOUT", "3", None, ["GUID_TIMEOUT = '3'", "a number"]),
        ("vehicle", "bank_max_deg", 30.0, None, ["bank_max_deg = 30.0", "no such limit"]),
        ("", "colour", 1, None, ["colour = 1", "no such key. Leave it out."]),
        ("terrain", "ground_m", 0.0, "ground_amsl_m", ["datum", "Write ground_amsl_m"]),
        ("terrain.peaks.0", "height_agl_m", 9.0, "height_amsl_m", ["datum", "height_amsl_m"]),
        ("radars.0", "altitude_m", 0.0, "altitude_amsl_m", ["radars.0", "datum"]),
        ("vehicle", "speed_max_m_s", -1.0, None, ["speed_max_m_s = -1.0", "greater than 0"]),
        ("vehicle", "speed_max_m_s", "fast", None, ["speed_max_m_s = 'fast'", "a number"]),
        ("vehicle", "system_id", 256, None, ["system_id = 256", "255"]),
        ("vehicle", "kind", "balloon", None, ["kind = 'balloon'", "'copter'"]),
        ("origin", "latitude_deg", float("nan"), None, ["latitude_deg", "finite"]),
        ("terrain", "combine", "mean", None, ["combine = 'mean'", "'maximum' or 'sum'"]),
        ("", "schema", 2, None, ["schema = 2", "1"]),
    ],
)
def test_what_is_wrong_is_named_with_its_remedy(
    world_table: Table, path: str, key: str, value: Any, instead_of: str | None, words: list[str]
) -> None:
    with pytest.raises(InputError) as caught:
        parse_world(changed(world_table, path, key, value, instead_of))
    message = str(caught.value)
    assert "\n" not in message
    assert all(word in message for word in words), message


WOOD: Table = {
    "seed": 1,
    "north_min_m": 0.0,
    "north_max_m": 90.0,
    "east_min_m": 0.0,
    "east_max_m": 90.0,
    "spacing_m": [4.0, 8.0],
    "radius_m": [0.2, 0.4],
    "height_m": [10.0, 20.0],
}


@pytest.mark.parametrize(
    ("near", "words"),
    [
        ({"trees": [{"north_m": 1.0}]}, ["trees.0.east_m", "missing"]),
        (
            {"trees": [{"north_m": 9.0, "east_m": 0.0, "radius_m": 0.0, "height_m": 9.0}]},
            ["trees.0.radius_m = 0.0", "greater than 0"],
        ),
        ({"walls": [{"points_ne_m": [[0.0, 1.0]]}]}, ["walls.0.points_ne_m", "at least 2"]),
        ({"wires": [{"ends_ne_m": [[0.0, 1.0]], "height_m": 3.0}]}, ["wires.0.ends_ne_m"]),
        ({"woods": [WOOD | {"spacing_m": [8.0, 4.0]}]}, ["woods.0.spacing_m", "least first"]),
        ({"woods": [WOOD | {"north_max_m": -5.0}]}, ["woods.0", "least must lie below"]),
        ({"woods": [WOOD | {"spacing_m": [0.01, 1.0]}]}, ["woods.0.spacing_m", "200000 trees"]),
        ({"woods": [WOOD | {"radus_m": 1.0}]}, ["woods.0.radus_m", "radius_m"]),
        (
            {"woods": [WOOD | {"clearings": [{"north_m": 1.0, "east_m": 1.0}]}]},
            ["woods.0.clearings.0.radius_m", "missing"],
        ),
        (
            {"terrain": {"file": "terrain.tif", "vertical_datum": "WGS84"}},
            ["terrain.vertical_datum", "'NAVD88'"],
        ),
        (
            {"terrain": {"file": "a.tif", "ground_amsl_m": 1.0}},
            ["terrain.file = 'a.tif'", "Leave out one"],
        ),
        ({"terrain": {"ground_amsl_m": 1.0}}, ["terrain.combine", "missing"]),
        ({"terrain": {"file": "a.tif"}}, ["area", "missing"]),
        (
            {"area": dict.fromkeys(("north_min_m", "north_max_m", "east_min_m", "east_max_m"), 1)},
            ["area = (1", "Swap"],
        ),
        ({"woods": [WOOD | {"east_min_m": 95.0}]}, ["woods.0", "least must lie below"]),
        (
            {"second_lidar": {"range_m": 9.0, "output": "autopilot"}},
            ["second_lidar.output = 'autopilot'", "beside a [lidar]"],
        ),
        (
            {"lidar": {"range_m": 9.0}, "second_lidar": {"range_m": 9.0, "output": "driver"}},
            ["second_lidar.output = 'driver'", "Write second_lidar.output"],
        ),
        ({"lidar": {"range_m": float("nan")}}, ["lidar.range_m", "finite"]),
        ({"lidar": {"range_m": 9.0, "min_m": 9.0}}, ["lidar.min_m = 9.0", "range_m"]),
        ({"lidar": {"range_m": 9.0, "kind": "flash"}}, ["lidar.kind = 'flash'", "'spinning'"]),
        ({"lidar": {"range_m": 9.0, "turns_s": 9.0}}, ["lidar.turns_s", "turns_1_s"]),
        ({"lidar": {"range_m": 9.0, "component_id": 100}}, ["lidar.component_id", "radar"]),
    ],
)
def test_near_things_that_cannot_be_are_refused_in_one_line(
    world_table: Table, near: Table, words: list[str]
) -> None:
    with pytest.raises(InputError) as caught:
        parse_world(world_table | near)
    message = str(caught.value)
    assert "\n" not in message
    assert all(word in message for word in words), message


def test_px4_has_no_lidar_of_its_own(world_table: Table) -> None:
    table = changed(world_table, "vehicle", "autopilot", "px4")
    with pytest.raises(InputError, match=r"lidar\.output = 'autopilot'.*px4"):
        Simulation(parse_world(table | {"lidar": {"range_m": 9.0, "output": "autopilot"}}))


def test_nobody_starts_inside_a_tree(world_table: Table) -> None:
    tree = {"north_m": 0.3, "east_m": 0.0, "radius_m": 0.5, "height_m": 9.0}
    with pytest.raises(InputError, match=r"vehicle\.north_m.*stands inside"):
        Simulation(parse_world(world_table | {"trees": [tree]}))


@pytest.mark.parametrize("text", ["not toml [", "[targets]\nx = 1\n", "", "name = 'x'\n"])
def test_what_is_no_world_file_is_refused_in_one_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "other.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_world(path)
    assert "\n" not in str(caught.value)


def test_a_file_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    for path in (binary, tmp_path / "absent.toml", tmp_path):
        with pytest.raises(InputError, match="cannot be read"):
            read_world(path)


def test_a_parameter_that_the_autopilot_does_not_have_is_named(world_table: Table) -> None:
    table = changed(world_table, "vehicle.parameters", "GUID_TIMOUT", 1.0)
    with pytest.raises(InputError, match=r"GUID_TIMOUT = 1\.0.*Did you mean GUID_TIMEOUT\?"):
        Simulation(parse_world(table))


def test_limits_that_a_file_gives_become_the_autopilots(world_table: Table) -> None:
    parameters = Simulation(parse_world(world_table)).parameters
    assert parameters["WPNAV_SPEED_UP"] == parameters["WPNAV_SPEED_DN"] == 2500.0
    assert (parameters["ANGLE_MAX"], parameters["WPNAV_ACCEL_Z"]) == (8000.0, 500.0)
    world_table["vehicle"]["parameters"] = {"WPNAV_SPEED_UP": 300.0}
    assert Simulation(parse_world(world_table)).parameters["WPNAV_SPEED_UP"] == 300.0


@pytest.mark.parametrize(
    ("changes", "drag_1_s"),
    [({}, 0.0), ({"drag_1_s": 0.3}, 0.3), ({"drag_1_s": 0.3, "speed_max_m_s": None}, 0.3)],
)
@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_the_drag_that_a_file_gives_is_flown(
    world_table: Table, autopilot: str, changes: Table, drag_1_s: float
) -> None:
    vehicle = world_table["vehicle"] | {"autopilot": autopilot} | changes
    del vehicle["parameters"]
    world_table["vehicle"] = {key: value for key, value in vehicle.items() if value is not None}
    simulation = Simulation(parse_world(world_table))
    for _ in range(10):
        simulation.step()
    copter = simulation.vehicle
    assert isinstance(copter, Copter)
    assert (copter.drag_1_s, copter.drag_1_m) == (drag_1_s, 0.0)
