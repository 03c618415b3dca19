"""The pictures of flights: planned without a vehicle, or flown."""

import math
from pathlib import Path

import numpy as np

from companion.geodesy import FloatArray
from companion.mission.mission import Mission
from companion.planner.offline import OfflineFlight
from companion.planner.procedure import Leg
from companion.telemetry.flight_summary import FlightSummary
from companion.world.known_map import KnownMap

_SPACING_M = 100.0


def draw_offline(flight: OfflineFlight, mission: Mission, truth: KnownMap, path: Path) -> float:
    """Draw a flight without a vehicle over the true terrain; its length in metres."""
    from companion.views.figure import FlightFigure, draw  # slow to import

    lines = _flown_lines(tuple(flight.legs), mission)
    length_m = sum(float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum()) for line in lines)
    shown = FlightFigure.of(
        mission,
        truth,
        legs_nea_m=lines,
        scans_nea_m=tuple(flight.scans_nea_m),
        start_nea_m=flight.scans_nea_m[0],
        caption=f"planned without a vehicle: {len(lines)} subpaths, {length_m / 1000:.1f} km",
    )
    draw(shown, path)
    return length_m


def draw_flown(flown: FlightSummary, path: Path) -> None:
    """Draw a flight over the terrain that it came to know."""
    from companion.views.figure import FlightFigure, draw  # slow to import

    session = flown.session
    legs = tuple(Leg.of(planned, number) for number, planned in enumerate(flown.plans, start=1))
    end = "in flight" if flown.end is None else f"{flown.end.outcome.value}: {flown.end.reason}"
    shown = FlightFigure.of(
        session.mission,
        session.state.flight.known,
        legs_nea_m=_flown_lines(legs, session.mission),
        scans_nea_m=tuple(flown.scans_nea_m),
        start_nea_m=flown.track_nea_m[0] if flown.track_nea_m else (0.0, 0.0, 0.0),
        track_nea_m=np.array(flown.track_nea_m) if len(flown.track_nea_m) > 1 else None,
        caption=f"{end}, after {session.now_s:,.0f} s; terrain as far as it was seen",
    )
    draw(shown, path)


def _flown_lines(legs: tuple[Leg, ...], mission: Mission) -> tuple[FloatArray, ...]:
    """The part of each leg before its successor, every 100 m: (S, 3) each."""
    lines = []
    for leg in legs:
        last = leg is legs[-1] or leg.reaches_target
        end_m = leg.subpath.length_m if last else leg.successor_at_m(mission.task)
        steps = np.linspace(0.0, end_m, max(math.ceil(end_m / _SPACING_M), 1) + 1)
        lines.append(np.array([leg.subpath.pose(step).position_nea_m for step in steps]))
    return tuple(lines)
