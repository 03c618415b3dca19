"""The pictures of flights: planned without a vehicle, or flown."""

import math
from pathlib import Path

import numpy as np

from companion.geodesy import FloatArray
from companion.mission.events import Vector
from companion.mission.mission import Mission
from companion.planner.offline import OfflineFlight
from companion.planner.procedure import Leg
from companion.telemetry.flight_summary import FlightSummary
from companion.world.known_map import KnownMap

_SPACING_M = 100.0


def draw_offline(flight: OfflineFlight, mission: Mission, truth: KnownMap, path: Path) -> float:
    """Draw a flight without a vehicle over the true terrain; its length in metres."""
    lines = _flown_lines(tuple(flight.legs), mission)
    length_m = sum(float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum()) for line in lines)
    caption = f"planned without a vehicle: {len(lines)} subpaths, {length_m / 1000:.1f} km"
    _draw(path, mission, truth, lines, tuple(flight.scans_nea_m), flight.scans_nea_m[0], caption)
    return length_m


def draw_flown(flown: FlightSummary, path: Path) -> None:
    """Draw a flight over the terrain that it came to know."""
    session = flown.session
    legs = tuple(Leg.of(planned, number) for number, planned in enumerate(flown.plans, start=1))
    track = np.array(flown.track_nea_m) if len(flown.track_nea_m) > 1 else None
    start = flown.track_nea_m[0] if flown.track_nea_m else (0.0, 0.0, 0.0)
    end = "in flight" if flown.end is None else f"{flown.end.outcome.value}: {flown.end.reason}"
    caption = f"{end}, after {session.now_s:,.0f} s; terrain as far as it was seen"
    lines = _flown_lines(legs, session.mission)
    scans = tuple(flown.scans_nea_m)
    known = session.state.flight.known
    _draw(path, session.mission, known, lines, scans, start, caption, track)


def _flown_lines(legs: tuple[Leg, ...], mission: Mission) -> tuple[FloatArray, ...]:
    """The part of each leg before its successor, every 100 m: (S, 3) each."""
    lines = []
    for leg in legs:
        last = leg is legs[-1] or leg.reaches_target
        end_m = leg.subpath.length_m if last else leg.successor_at_m(mission.task)
        steps = np.linspace(0.0, end_m, max(math.ceil(end_m / _SPACING_M), 1) + 1)
        lines.append(np.array([leg.subpath.pose(step).position_nea_m for step in steps]))
    return tuple(lines)


def _draw(
    path: Path,
    mission: Mission,
    terrain: KnownMap,
    lines: tuple[FloatArray, ...],
    scans_nea_m: tuple[Vector, ...],
    start_nea_m: Vector,
    caption: str,
    track_nea_m: FloatArray | None = None,
) -> None:
    from companion.views.figure import FlightFigure, TerrainPicture, draw  # slow to import

    limits = mission.task.limits
    draw(
        FlightFigure(
            title=f"{mission.name}, profile {mission.task.settings.profile.name}",
            terrain=TerrainPicture.of(terrain),
            radars=mission.task.radars,
            zones=mission.task.zones,
            floor_amsl_m=limits.floor_amsl_m,
            ceiling_amsl_m=limits.ceiling_amsl_m,
            legs_nea_m=lines,
            scans_nea_m=scans_nea_m,
            start_nea_m=start_nea_m,
            targets_ne_m=mission.targets_ne_m,
            track_nea_m=track_nea_m,
            caption=caption,
        ),
        path,
    )
