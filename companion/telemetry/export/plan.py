"""QGroundControl's .plan: the path as waypoints, zones as a geofence, rally points.

The format is that of QGroundControl's developer guide, "Plan File Format"; `sources.plan_file`
reads it.  Altitudes are AMSL.  A plan has no radars and no terrain: an autopilot that flies it by
itself keeps to the path only as well as these waypoints do.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np

from companion.errors import InputError
from companion.geodesy import FloatArray, LocalFrame
from companion.mavlink.autopilots import FIRMWARES
from companion.mavlink.dialect import wire
from companion.mission.mission import EndAction
from companion.mission.state import Phase
from companion.telemetry.export import shapes
from companion.telemetry.export.flight import RecordedFlight
from companion.world.threats import CircleZone, Zone

Json = dict[str, Any]
Source = Literal["flown", "planned"]

_MAX_WAYPOINTS = 300
"""Autopilots hold some 500 to 700 mission items."""
_FINEST_M = 2.0
_ABSOLUTE = 2
"""QGroundControl's AltitudeMode: above mean sea level."""
_IN_AIR = tuple(
    phase.value for phase in (Phase.FLYING, Phase.HOLDING, Phase.ARRIVED, Phase.RETURNING)
)
_TYPES = {"copter": wire.MAV_TYPE_QUADROTOR, "plane": wire.MAV_TYPE_FIXED_WING}
_FIRMWARE = {None: wire.MAV_AUTOPILOT_GENERIC} | {each.name: each.number for each in FIRMWARES}


def write_plan(flight: RecordedFlight, file: Path, source: Source) -> tuple[str, ...]:
    """Write the flown or the planned path; what people should know of it.

    Raises OSError if that cannot be done, InputError if there is no such path.
    """
    content, notes = plan_of(flight, source)
    file.write_text(json.dumps(content, indent=4) + "\n", encoding="utf-8")
    return notes


def plan_of(flight: RecordedFlight, source: Source) -> tuple[Json, tuple[str, ...]]:
    """The content of a .plan, and what people should know of it."""
    path_nea_m = _flown(flight) if source == "flown" else _planned(flight)
    waypoints_nea_m, error_m = _waypoints(path_nea_m)
    frame, limits = flight.mission.frame, flight.mission.task.limits
    plan = {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "companion",
        "mission": {
            "version": 2,
            "firmwareType": _FIRMWARE[flight.mission.autopilot],
            "vehicleType": _TYPES[flight.mission.kind],
            "hoverSpeed": limits.speed_m_s,
            "cruiseSpeed": limits.speed_m_s,
            "globalPlanAltitudeMode": _ABSOLUTE,
            "plannedHomePosition": _home(flight),
            "items": list(_items(flight, shapes.of_points(waypoints_nea_m, frame))),
        },
        "geoFence": {"version": 2, **_fence(flight.zones, frame)},
        "rallyPoints": {"version": 2, "points": _rally(flight)},
    }
    notes = [f"{len(waypoints_nea_m)} waypoints, at most {error_m:g} m off the {source} path"]
    if radars := len(flight.mission.task.radars):
        notes.append(f"left out: {radars} x radar (a plan has none)")
    return plan, tuple(notes)


# --- the path


def _flown(flight: RecordedFlight) -> FloatArray:
    """Where the vehicle was, from the end of the climb-out.  -> (N, 3) north, east, altitude."""
    in_air = [part for phase, part in flight.segments() if phase in _IN_AIR]
    if not in_air:
        rule = "no position in flight was recorded"
        raise InputError("--path", "flown", rule, "Give --path planned, or another format.")
    chosen = np.concatenate([shapes.thinned(part, len(flight.track)) for part in in_air])
    return shapes.local_nea_m(flight.track.part(chosen), flight.mission.frame)


def _planned(flight: RecordedFlight) -> FloatArray:
    """The subpaths that were begun, each up to where the next one begins.  -> (N, 3)."""
    legs_nea_m = flight.legs_nea_m()
    if not legs_nea_m:
        raise InputError("--path", "planned", "no subpath was flown", "Give another format.")
    if not len(flight.track):
        rule = "where home is was not recorded"
        raise InputError("--path", "planned", rule, "Give --format kml.")
    return np.concatenate(legs_nea_m)


def _waypoints(path_nea_m: FloatArray) -> tuple[FloatArray, float]:
    """So few points of a path that an autopilot can hold them, and how far off it they are."""
    error_m = _FINEST_M
    while len(chosen := shapes.corners(path_nea_m, error_m)) > _MAX_WAYPOINTS:
        error_m *= 2.0
    return path_nea_m[chosen], error_m


# --- items


def _home(flight: RecordedFlight) -> list[float]:
    """Latitude, longitude, altitude AMSL: below the first position, at the height of home."""
    longitude, latitude, altitude_m = shapes.of_track(flight.track.part(slice(0, 1)))[0].tolist()
    return [latitude, longitude, altitude_m - float(flight.track.above_home_m[0])]


def _items(flight: RecordedFlight, points: FloatArray) -> Iterator[Json]:
    """The mission items; points: longitude, latitude, altitude AMSL, (N, 3)."""
    number = 0

    def item(command: int, row: list[float], first: float = 0.0) -> Json:
        nonlocal number
        number += 1
        longitude, latitude, altitude_m = row
        return {
            "type": "SimpleItem",
            "autoContinue": True,
            "command": command,
            "doJumpId": number,
            "frame": wire.MAV_FRAME_GLOBAL,
            "params": [first, 0, 0, None, latitude, longitude, altitude_m],
            "AltitudeMode": _ABSOLUTE,
            "Altitude": altitude_m,
            "AMSLAltAboveTerrain": None,
        }

    *rows, last = [
        [round(row[0], 7), round(row[1], 7), round(row[2], 3)] for row in points.tolist()
    ]
    if any(each.phase == Phase.TAKING_OFF.value for _, _, each in flight.states):
        latitude, longitude, _ = _home(flight)
        first_m = (rows or [last])[0][2]
        yield item(wire.MAV_CMD_NAV_TAKEOFF, [longitude, latitude, first_m])
    yield from (item(wire.MAV_CMD_NAV_WAYPOINT, row) for row in rows)
    holds = flight.mission.end_action is EndAction.HOLD
    yield item(wire.MAV_CMD_NAV_LOITER_UNLIM if holds else wire.MAV_CMD_NAV_WAYPOINT, last)
    if flight.mission.end_action is EndAction.LAND:
        home_m = _home(flight)[2]
        yield item(wire.MAV_CMD_NAV_LAND, [*last[:2], home_m])
    elif flight.mission.end_action is EndAction.RETURN:
        yield item(wire.MAV_CMD_NAV_RETURN_TO_LAUNCH, [0.0, 0.0, 0.0]) | {
            "frame": wire.MAV_FRAME_MISSION,
            "params": [0, 0, 0, 0, 0, 0, 0],
        }


# --- what stands around it


def _fence(zones: tuple[Zone, ...], frame: LocalFrame) -> Json:
    circles, polygons = [], []
    for zone in zones:
        if isinstance(zone, CircleZone):
            centre = [round(value, 7) for value in frame.to_geodetic_deg(zone.north_m, zone.east_m)]
            circle = {"center": centre, "radius": zone.radius_m}
            circles.append({"circle": circle, "inclusion": zone.keep_in, "version": 1})
        else:
            edge = shapes.of_zone(zone, frame, 0.0)[:, 1::-1]  # latitude, longitude
            corners = [[round(value, 7) for value in corner] for corner in edge.tolist()]
            polygons.append({"polygon": corners, "inclusion": zone.keep_in, "version": 1})
    return {"circles": circles, "polygons": polygons}


def _rally(flight: RecordedFlight) -> list[list[float]]:
    """Latitude, longitude, and above home the altitude at which the mission begins."""
    frame, above_m = flight.mission.frame, flight.mission.task.take_off_amsl_m - _home(flight)[2]
    return [
        [*(round(value, 7) for value in frame.to_geodetic_deg(*place)), round(above_m, 1)]
        for place in flight.mission.rally_ne_m
    ]
