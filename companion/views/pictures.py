"""The pictures of flights: planned without a vehicle, or flown."""

from pathlib import Path

import numpy as np

from companion.mission.mission import Mission
from companion.planner.offline import OfflineFlight
from companion.telemetry.flight import joined_nea_m
from companion.telemetry.flight_summary import FlightSummary
from companion.world.known_map import KnownMap

_SPACING_M = 100.0


def draw_offline(flight: OfflineFlight, mission: Mission, truth: KnownMap, path: Path) -> float:
    """Draw a flight without a vehicle over the true terrain; its length in metres."""
    from companion.views.figure import FlightFigure, draw  # slow to import

    route = flight.route_nea_m(_SPACING_M)
    length_m = float(np.linalg.norm(np.diff(route, axis=0), axis=1).sum())
    subpaths = len(flight.legs)
    shown = FlightFigure.of(
        mission,
        truth,
        legs_nea_m=(route,),
        scans_nea_m=tuple(flight.scans_nea_m),
        start_nea_m=flight.scans_nea_m[0],
        caption=f"planned without a vehicle: {subpaths} subpaths, {length_m / 1000:.1f} km",
    )
    draw(shown, path)
    return length_m


def draw_flown(flown: FlightSummary, path: Path) -> None:
    """Draw a flight over the terrain that it came to know."""
    from companion.views.figure import FlightFigure, draw  # slow to import

    session = flown.session
    end = "in flight" if flown.end is None else f"{flown.end.outcome.value}: {flown.end.reason}"
    shown = FlightFigure.of(
        session.mission,
        session.state.flight.known,
        legs_nea_m=tuple(joined_nea_m(planned.subpath for planned in flown.plans)),
        scans_nea_m=tuple(flown.scans_nea_m),
        start_nea_m=flown.track_nea_m[0] if flown.track_nea_m else (0.0, 0.0, 0.0),
        track_nea_m=np.array(flown.track_nea_m) if len(flown.track_nea_m) > 1 else None,
        caption=f"{end}, after {session.now_s:,.0f} s; terrain as far as it was seen",
    )
    draw(shown, path)
