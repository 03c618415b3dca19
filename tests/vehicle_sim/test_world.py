import copy
from pathlib import Path
from typing import Any

import pytest

from vehicle_sim.dynamics.copter import Copter
from vehicle_sim.errors import InputError
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import parse_world, read_world

Table = dict[str, Any]


def refused(table: Table) -> str:
    """The one line that says why."""
    with pytest.raises(InputError) as caught:
        parse_world(table)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def changed(table: Table, path: str, value: Any, without: str = "") -> Table:
    """The same with this key, and without another beside it."""
    table = copy.deepcopy(table)
    *parts, key = path.split(".")
    place: Any = table
    for part in parts:
        place = place[int(part)] if part.isdigit() else place[part]
    place.pop(without, None)
    place[key] = value
    return table


def test_a_world_is_what_its_file_says(world_file: Path) -> None:
    world = read_world(world_file)
    assert world.origin.latitude_deg == 47.0
    assert world.terrain.peaks[0].height_amsl_m == 1200.0
    assert world.radars[0].name == "radar 1"
    assert world.vehicle.parameters == {"GUID_TIMEOUT": 3.0}
    assert world.truth().height_at_amsl_m(3000.0, 4000.0) == 1200.0


NAN = float("nan")


@pytest.mark.parametrize(
    ("path", "value", "without", "words"),
    [
        ("vehicle.speed_mx_m_s", 1.0, "speed_max_m_s", "vehicle.speed_mx_m_s ... speed_max_m_s"),
        ("vehicle.parameters.GUID_TIMEOUT", "3", "", "GUID_TIMEOUT = '3' ... number"),
        ("vehicle.bank_max_deg", 30.0, "", "bank_max_deg = 30.0 ... no such limit"),
        ("colour", 1, "", "colour = 1 ... no such key. Leave it out."),
        ("terrain.ground_m", 0.0, "ground_amsl_m", "no such key ... ground_amsl_m"),
        ("terrain.peaks.0.height_agl_m", 9.0, "height_amsl_m", "no such key ... height_amsl_m"),
        ("radars.0.altitude_m", 0.0, "altitude_amsl_m", "radars.0 ... altitude_amsl_m"),
        ("vehicle.speed_max_m_s", -1.0, "", "speed_max_m_s = -1.0 ... greater than 0"),
        ("vehicle.speed_max_m_s", "fast", "", "speed_max_m_s = 'fast' ... number"),
        ("vehicle.system_id", 255, "", "system_id = 255 ... 254"),
        ("vehicle.kind", "balloon", "", "kind = 'balloon' ... 'copter'"),
        ("origin.latitude_deg", NAN, "", "latitude_deg ... finite"),
        ("terrain.combine", "mean", "", "combine = 'mean' ... 'maximum' or 'sum'"),
        ("schema", 2, "", "schema = 2 ... 1"),
    ],
)
def test_what_is_wrong_is_named_with_its_remedy(
    world_table: Table, path: str, value: Any, without: str, words: str
) -> None:
    message = refused(changed(world_table, path, value, without))
    assert all(word in message for word in words.split(" ... ")), message


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
TREE: Table = {"north_m": 9.0, "east_m": 0.0, "radius_m": 0.5, "height_m": 9.0}
NO_AREA = dict.fromkeys(("north_min_m", "north_max_m", "east_min_m", "east_max_m"), 1)


def wood(**changes: Any) -> Table:
    return {"woods": [WOOD | changes]}


def lidar(which: str = "lidar", **fields: Any) -> Table:
    return {which: {"range_m": 9.0} | fields}


@pytest.mark.parametrize(
    ("near", "words"),
    [
        ({"trees": [{"north_m": 1.0}]}, "trees.0.east_m ... missing"),
        ({"trees": [TREE | {"radius_m": 0.0}]}, "trees.0.radius_m = 0.0 ... greater than 0"),
        ({"walls": [{"points_ne_m": [[0.0, 1.0]]}]}, "walls.0.points_ne_m ... at least 2"),
        ({"wires": [{"ends_ne_m": [[0.0, 1.0]], "height_m": 3.0}]}, "wires.0.ends_ne_m"),
        (wood(spacing_m=[8.0, 4.0]), "woods.0.spacing_m ... least first"),
        (wood(north_max_m=-5.0), "woods.0 ... least must lie below"),
        (wood(east_min_m=95.0), "woods.0 ... least must lie below"),
        (wood(spacing_m=[0.01, 1.0]), "woods.0.spacing_m ... 200000 trees"),
        (wood(radus_m=1.0), "woods.0.radus_m ... radius_m"),
        (
            wood(clearings=[{"north_m": 1.0, "east_m": 1.0}]),
            "woods.0.clearings.0.radius_m ... missing",
        ),
        (
            {"terrain": {"file": "terrain.tif", "vertical_datum": "WGS84"}},
            "terrain.vertical_datum ... 'NAVD88'",
        ),
        (
            {"terrain": {"file": "a.tif", "ground_amsl_m": 1.0}},
            "terrain.file = 'a.tif' ... Leave out one",
        ),
        ({"terrain": {"ground_amsl_m": 1.0}}, "terrain.combine ... missing"),
        ({"terrain": {"file": "a.tif"}}, "area ... missing"),
        ({"area": NO_AREA}, "area = (1 ... Swap"),
        (
            lidar("second_lidar", output="autopilot"),
            "second_lidar.output = 'autopilot' ... beside a [lidar]",
        ),
        (
            lidar() | lidar("second_lidar", output="driver"),
            "second_lidar.output = 'driver' ... Write second_lidar.output",
        ),
        (lidar(range_m=NAN), "lidar.range_m ... finite"),
        (lidar(min_m=9.0), "lidar.min_m = 9.0 ... range_m"),
        (lidar(kind="flash"), "lidar.kind = 'flash' ... 'spinning'"),
        (lidar(turns_s=9.0), "lidar.turns_s ... turns_1_s"),
        (lidar(component_id=100), "lidar.component_id ... radar"),
    ],
)
def test_near_things_that_cannot_be_are_refused_in_one_line(
    world_table: Table, near: Table, words: str
) -> None:
    message = refused(world_table | near)
    assert all(word in message for word in words.split(" ... ")), message


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("vehicle.autopilot", "px4", r"lidar\.output = 'autopilot'.*px4"),
        ("vehicle.autopilot", "sparow", "autopilot = 'sparow': must be 'ardupilot' or"),
        ("vehicle.parameters.GUID_TIMOUT", 1.0, "GUID_TIMOUT = 1.0.*Did you mean GUID_TIMEOUT?"),
        ("trees", [TREE | {"north_m": 0.3}], r"vehicle\.north_m.*stands inside"),
    ],
)
def test_what_only_the_vehicle_knows_is_refused_too(
    world_table: Table, path: str, value: Any, words: str
) -> None:
    table = changed(world_table, path, value) | lidar(output="autopilot")
    with pytest.raises(InputError, match=words):
        Simulation(parse_world(table))


@pytest.mark.parametrize("text", ["not toml [", "[targets]\nx = 1\n", "", "name = 'x'\n"])
def test_what_is_no_world_file_or_cannot_be_read_is_refused_in_one_line(
    tmp_path: Path, text: str
) -> None:
    path, binary = tmp_path / "other.toml", tmp_path / "binary.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_world(path)
    assert "\n" not in str(caught.value)
    binary.write_bytes(b"\xff\xfe\x00")
    for unreadable in (binary, tmp_path / "absent.toml", tmp_path):
        with pytest.raises(InputError, match="cannot be read"):
            read_world(unreadable)


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
    vehicle = world_table["vehicle"] | {"autopilot": autopilot, "parameters": {}} | changes
    world_table["vehicle"] = {key: value for key, value in vehicle.items() if value is not None}
    simulation = Simulation(parse_world(world_table))
    for _ in range(10):
        simulation.step()
    copter = simulation.vehicle
    assert isinstance(copter, Copter)
    assert (copter.drag_1_s, copter.drag_1_m) == (drag_1_s, 0.0)
