"""Experiments with a simulated PX4: mission and fence (px4.md 7)."""

import functools
from typing import Any, Final

from harness import GROUND_AMSL_M, NAN, OFFBOARD, Seen, Vector, local, place
from px4_flights import GROUND_STATION, hover, north
from pymavlink.dialects.v20 import all as mavlink


def item(seq: int, command: int, p1: float, point: Vector, *, frame: int, kind: int) -> Any:
    x, y = (round(value * 1e7) for value in place(*point[:2]))
    return mavlink.MAVLink_mission_item_int_message(
        1, 1, seq, frame, command, 0, 1, p1, 0, 0, NAN, x, y, point[2], kind
    )


WAYPOINTS: Final = [
    item(0, 22, 0.0, (0.0, 0.0, 15.0), frame=6, kind=0),
    item(1, 16, 0.0, (40.0, 0.0, GROUND_AMSL_M + 15.0), frame=5, kind=0),
    item(2, 16, 0.0, (40.0, 40.0, 15.0), frame=6, kind=0),
    item(3, 16, 0.0, (0.0, 40.0, 15.0), frame=6, kind=0),
]


def circle(north_m: float, radius_m: float) -> list[Any]:
    return [item(0, 5004, radius_m, (north_m, 0.0, 0.0), frame=0, kind=1)]


@functools.cache
def mission() -> Seen:
    """Uploaded in OFFBOARD, started, left for OFFBOARD again, cleared.

    Left: results and modes; items_after: of the mission and of the fence.
    """
    flight = hover()
    uploaded = flight.upload(WAYPOINTS, 0)
    flight.upload(circle(500.0, 20.0), 1)
    frames = [each.frame for each in flight.download(0)]
    result = flight.command(300, 0, 0)
    flight.run(3.0)
    started = (result, flight.mode)
    result = flight.set_mode(OFFBOARD)
    flight.run(1.0)
    left, since_s = (result, flight.mode), flight.now_s
    flight.send(mavlink.MAVLink_mission_clear_all_message(1, 1, 0))
    flight.run(0.5)
    cleared = int(flight.of("MISSION_ACK", since_s)[-1].type)
    items_after = (len(flight.download(0)), len(flight.download(1)))
    return {
        "uploaded": uploaded,
        "frames": frames,
        "started": started,
        "left": left,
        "cleared": cleared,
        "items_after": items_after,
    }


@functools.cache
def fence() -> Seen:
    """At 4 m/s towards an exclusion circle of 20 m.

    Hold_s: from crossing.
    """
    flight = hover()
    flight.heartbeats = (GROUND_STATION,)
    flight.aim = lambda _: local((0.0, 0.0, -15.0), yaw=0.0)
    uploaded = flight.upload(circle(60.0, 20.0), 1)
    flight.aim = north(4.0)
    flight.until(lambda: flight.position[0] > 40.0, 30.0)
    crossed_s = flight.now_s
    flight.until(lambda: flight.mode != OFFBOARD, 5.0)
    hold_s, mode = flight.now_s - crossed_s, flight.mode
    flight.run(8.0)
    inside_m, with_stream = flight.position[0] - 40.0, flight.mode
    result = flight.set_mode(OFFBOARD)
    flight.aim = north(8.0)
    flight.run(3.0)
    deeper_m = flight.position[0] - 40.0 - inside_m
    told = any("Geofence: approaching or outside geofence" in text for text in flight.texts())
    return {
        "uploaded": uploaded,
        "hold_s": hold_s,
        "mode": mode,
        "inside_m": inside_m,
        "told": told,
        "mode_with_stream": with_stream,
        "commanded": result,
        "deeper_m": deeper_m,
    }
