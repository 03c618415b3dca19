"""Files that people give: one of each kind, changed by edits, and what is said of a bad one."""

import copy
import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from rasterio.transform import Affine

from companion.config import load_mission, load_world, read_mission, world_table
from companion.errors import InputError
from companion.mission.mission import Mission
from companion.sources.files import toml_text

RING = [[8.0, 47.0], [8.1, 47.0], [8.1, 47.2], [8.0, 47.0]]
HOLE = [[8.04, 47.02], [8.08, 47.02], [8.08, 47.1], [8.04, 47.02]]
STEP_DEG = 1 / 1200
AREA_M = (-2_000.0, 3_000.0, -4_000.0, 1_500.0)
HEIGHTS_M = np.random.default_rng(4).integers(300, 800, (200, 240)).astype(np.int16)
"""Every 3 seconds over more than the map of the mission, about its origin."""
ABOUT_THE_ORIGIN = (STEP_DEG, 0, 8 - 120 * STEP_DEG, 0, -STEP_DEG, 47 + 100 * STEP_DEG)


def edited(document: Any, *edits: str) -> Any:
    """A copy with other values: "a.b.0 = JSON" puts one in its place, "a.b" takes one out."""
    document = copy.deepcopy(document)
    for edit in edits:
        path, sign, value = edit.partition(" = ")
        *above, last = [int(step) if step.isdigit() else step for step in path.split(".")]
        here = document
        for step in above:
            here = here[step] if isinstance(step, int) else here.setdefault(step, {})
        if not sign:
            del here[last]
        elif last == len(here):
            here.append(json.loads(value))
        else:
            here[last] = json.loads(value)
    return document


def feature(shape: str, coordinates: Any, **properties: Any) -> dict[str, Any]:
    """A feature of GeoJSON."""
    geometry = {"type": shape, "coordinates": coordinates}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def collection(*features: Any, **more: Any) -> dict[str, Any]:
    """They, as a file has them."""
    return {"type": "FeatureCollection", "features": list(features), **more}


def item(command: int, *params: float | None, frame: int = 3, **more: Any) -> dict[str, Any]:
    """A mission item as QGroundControl saves it."""
    numbers = [*params]
    return {"type": "SimpleItem", "command": command, "frame": frame, "params": numbers, **more}


def waypoint(
    north_deg: float = 0.01, altitude_m: float | None = 50.0, frame: int = 3, **more: Any
) -> dict[str, Any]:
    """So far north of launch, and so high above it."""
    return item(16, 0, 0, 0, None, 47.0 + north_deg, 8.0, altitude_m, frame=frame, **more)


def plan(*items: Any, speed_m_s: float = 5) -> dict[str, Any]:
    """A plan of a copter without zones."""
    mission = {"version": 2, "vehicleType": 2, "hoverSpeed": speed_m_s, "items": list(items)}
    mission["plannedHomePosition"] = [47.0, 8.0, 400]
    fence = {"circles": [], "polygons": [], "version": 2}
    rally = {"points": [], "version": 2}
    parts = {"mission": mission, "geoFence": fence, "rallyPoints": rally}
    return {"fileType": "Plan", "version": 1, **parts}


COPTER = tomllib.loads("""
schema = 1
name = "test"
origin = { latitude_deg = 47.0, longitude_deg = 8.0 }
area = { north_min_m = -4000.0, north_max_m = 6000.0, east_min_m = -4000.0, east_max_m = 6000.0 }
altitude = { floor_amsl_m = 900.0, ceiling_amsl_m = 1100.0 }
planner = { scan_range_m = 2000.0, safety_distance_m = 40.0, planning_time_s = 3.0 }
targets = [{ north_m = 3000.0, east_m = 2000.0 }]
end = { action = "hold" }
[vehicle]
kind = "copter"
speed_m_s = 8.0
acceleration_m_s2 = 2.0
climb_rate_m_s = 2.5
turn_radius_m = 25.0
climb_angle_deg = 17.0
dive_angle_deg = 17.0
""")
EVERYTHING = (
    *('vehicle.autopilot = "px4"', "vehicle.system_id = 7", "vehicle.yaw_deg = 270.0"),
    *("vehicle.scanner_component_id = 101", "vehicle.position_rate_hz = 200.0"),
    *("vehicle.tracking_error_m = 9.5", "vehicle.navigation_error_m = 7.5"),
    *("vehicle.dead_man_s = 2.0", "scanner.complete = false", 'end.action = "return"'),
    *('fallback = {"action": "land", "attempts": 2}', "from_vehicle.fence = false"),
    *("battery.reserve_percent = 35.0", "battery.endurance_s = 900.0"),
    *('link.commanders = ["255/0", "7/190"]', "link.sets_parameters = false"),
    *('rally_points = [{"north_m": 10.0, "east_m": -20.0}]', 'threats = "threats.geojson"'),
    'keep_ins = [{"name": "b", "north_m": 0.0, "east_m": 0.0, "radius_m": 9000.0}]',
)
"""That a mission can say beside what it must."""
PLANE = edited(
    COPTER, 'vehicle.kind = "plane"', "vehicle.loiter_radius_m = 80.0",
    "vehicle.speed_m_s = 18.0", "vehicle.turn_radius_m = 80.0",
)  # fmt: skip
KNOWN = edited(COPTER, 'terrain = {"file": "dem.tif", "vertical_datum": "EGM96"}')
STATED = edited(COPTER, "terrain.highest_amsl_m = 840.0")
BLIND = edited(STATED, "vehicle.scanner = false")
FOREST = tomllib.loads(read_mission("forest").text)
DOCUMENTS: dict[str, tuple[str, Any]] = {
    "mission": ("mission.toml", COPTER),
    "mission of a plane": ("mission.toml", PLANE),
    "mission that knows the ground": ("mission.toml", KNOWN),
    "mission without a radar": ("mission.toml", BLIND),
    "mission by a lidar": ("mission.toml", FOREST),
    "all of a mission": ("mission.toml", edited(COPTER, *EVERYTHING)),
    "plan": ("x.plan", plan(waypoint(), waypoint(0.02))),
    "mission that names a plan": ("mission.toml", {"plan": "fenced.plan"}),
    "list": ("x.txt", ["QGC WPL 110", "0 1 0 16 0 0 0 0 47 8 9 1", "1 0 3 16 0 0 0 0 47 8.01 9 1"]),
    "GeoJSON": (
        "x.geojson",
        collection(feature("Polygon", [RING]), feature("Polygon", [HOLE], name="x")),
    ),
    "elevation file": ("x.tif", {"crs": "EPSG:4326"}),
    "world": ("world.toml", world_table("environment-1")),
    "world of a file": (
        "world.toml",
        edited(world_table("valley"), 'terrain.file = "terrain.tif"'),
    ),
}
"""By the names that tables have for them: the name of the file, and what is in it."""


def table_of(name: str) -> dict[str, list[tuple[list[str], str]]]:
    """Edits of each file and what is said of it, by the kind of the file; without edits: as it is.

    A row is "edit ; edit → said", below "# kind".
    """
    table: dict[str, list[tuple[list[str], str]]] = {}
    for row in (Path(__file__).parent / name).read_text("utf-8").splitlines():
        if row.startswith("# "):
            of_kind = table.setdefault(row.removeprefix("# "), [])
        else:
            edits, said = row.split("→ ")
            of_kind.append((edits.strip().split(" ; ") if edits else [], said))
    return table


def written(folder: Path, kind: str, *edits: str, content: Any = None) -> Path:
    """A file of that kind; content: instead of its document."""
    name, document = DOCUMENTS[kind]
    path, document = folder / name, edited(document, *edits) if content is None else content
    match path.suffix:
        case ".tif":
            terrain(path, HEIGHTS_M * document.pop("times", 1), **document)
        case ".txt":
            path.write_text("\n".join(document), encoding="utf-8")
        case ".toml":
            path.write_text(toml_text(document), encoding="utf-8")
        case _:
            path.write_text(json.dumps(document), encoding="utf-8")
    return path


def terrain(
    path: Path,
    heights_m: NDArray[Any] = HEIGHTS_M,
    *,
    transform: tuple[float, ...] = ABOUT_THE_ORIGIN,
    units: str = "",
    scale: float = 1.0,
    **changes: Any,
) -> None:
    """A GeoTIFF about the origin, rows to the south; changes: of how it is written."""
    rows, columns = heights_m.shape
    usual = {"height": rows, "width": columns, "count": 1, "dtype": heights_m.dtype}
    usual |= {"crs": "EPSG:4326", "transform": Affine(*transform), "driver": "GTiff"}
    with rasterio.open(path, "w", **(usual | changes)) as file:
        for band in range(file.count):
            file.write(heights_m, band + 1)
        file.units, file.scales = [units] * file.count, [scale] * file.count


def loaded(path: Path) -> object:
    """What a file says, by itself or named by a mission or a world."""
    if path.suffix == ".geojson":
        path = written(path.parent, "mission", f'threats = "{path.name}"')
    elif path.suffix == ".tif":
        here = f"origin = {json.dumps(COPTER['origin'])}", 'terrain.vertical_datum = "NAVD88"'
        area = f"area = {json.dumps(dict(zip(COPTER['area'], AREA_M, strict=True)))}"
        path = written(path.parent, "world of a file", *here, area, 'terrain.file = "x.tif"')
    return (load_world if path.name == "world.toml" else load_mission)(str(path))


def mission(folder: Path, kind: str, *edits: str) -> Mission:
    """What a file of that kind says, by itself or named by a mission."""
    return load_mission(str(written(folder, kind, *edits)))


def refusal(read: Callable[..., object], *arguments: Any) -> str:
    """The one line that is said."""
    with pytest.raises(InputError) as caught:
        read(*arguments)
    message = str(caught.value)
    assert len(message.splitlines()) == 1
    return message
