"""Experiments with a simulated PX4: mission, fence, loss of GPS (px4.md 7, 8)."""

import functools
import math
from typing import Any, Final, NamedTuple

from px4_flights import GROUND_STATION, hover, north, positions
from px4_wire import GROUND_AMSL_M, NAN, OFFBOARD, Companion, Vector, local, place
from pymavlink.dialects.v20 import all as mavlink

# --- 7: mission and fence -------------------------------------------------------------------------


def item(seq: int, command: int, p1: float, point: Vector, *, frame: int, kind: int) -> Any:
    x, y = (round(value * 1e7) for value in place(*point[:2]))
    return mavlink.MAVLink_mission_item_int_message(
        1, 1, seq, frame, command, 0, 1, p1, 0, 0, NAN, x, y, point[2], kind
    )


def upload(flight: Companion, items: list[Any], kind: int) -> int | None:
    """Result of an upload that answers every MISSION_REQUEST_INT."""
    since_s = flight.now_s
    flight.send(mavlink.MAVLink_mission_count_message(1, 1, len(items), kind))
    answered = 0
    while flight.now_s - since_s < 3.0:
        flight.step()
        requests = flight.of("MISSION_REQUEST_INT", since_s)
        for request in requests[answered:]:
            flight.send(items[request.seq])
        answered = len(requests)
        if acks := flight.of("MISSION_ACK", since_s):
            return int(acks[0].type)
    return None


def download(flight: Companion, kind: int) -> list[Any]:
    since_s = flight.now_s
    flight.send(mavlink.MAVLink_mission_request_list_message(1, 1, kind))
    flight.run(0.2)
    count = flight.of("MISSION_COUNT", since_s)[-1].count
    for seq in range(count):
        flight.send(mavlink.MAVLink_mission_request_int_message(1, 1, seq, kind))
        flight.run(0.1)
    flight.send(mavlink.MAVLink_mission_ack_message(1, 1, 0, kind))
    return flight.of("MISSION_ITEM_INT", since_s)


WAYPOINTS: Final = [
    item(0, 22, 0.0, (0.0, 0.0, 15.0), frame=6, kind=0),
    item(1, 16, 0.0, (40.0, 0.0, GROUND_AMSL_M + 15.0), frame=5, kind=0),
    item(2, 16, 0.0, (40.0, 40.0, 15.0), frame=6, kind=0),
    item(3, 16, 0.0, (0.0, 40.0, 15.0), frame=6, kind=0),
]


def circle(north_m: float, radius_m: float) -> list[Any]:
    return [item(0, 5004, radius_m, (north_m, 0.0, 0.0), frame=0, kind=1)]


class Mission(NamedTuple):
    """Uploaded in OFFBOARD, started, left for OFFBOARD again, cleared."""

    uploaded: int | None
    frames: list[int]
    started: int | None
    mode: int
    left: int | None
    mode_after: int
    cleared: int
    items_after: tuple[int, int]
    """Of the mission and of the fence."""


@functools.cache
def mission() -> Mission:
    flight = hover()
    uploaded = upload(flight, WAYPOINTS, 0)
    upload(flight, circle(500.0, 20.0), 1)
    frames = [each.frame for each in download(flight, 0)]
    started = flight.command(300, 0, 0)
    flight.run(3.0)
    mode = flight.mode
    left = flight.set_mode(OFFBOARD)
    flight.run(1.0)
    since_s = flight.now_s
    flight.send(mavlink.MAVLink_mission_clear_all_message(1, 1, 0))
    flight.run(0.5)
    cleared = int(flight.of("MISSION_ACK", since_s)[-1].type)
    left_items = (len(download(flight, 0)), len(download(flight, 1)))
    return Mission(uploaded, frames, started, mode, left, flight.mode, cleared, left_items)


class Fence(NamedTuple):
    """At 4 m/s towards an exclusion circle of 20 m."""

    uploaded: int | None
    hold_s: float
    """From crossing."""
    mode: int
    inside_m: float
    texts: list[str]
    mode_with_stream: int
    commanded: int | None
    deeper_m: float


@functools.cache
def fence() -> Fence:
    flight = hover()
    flight.heartbeats = (GROUND_STATION,)
    flight.aim = lambda _: local((0.0, 0.0, -15.0), yaw=0.0)
    uploaded = upload(flight, circle(60.0, 20.0), 1)
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
    texts = flight.texts()
    return Fence(uploaded, hold_s, mode, inside_m, texts, with_stream, result, deeper_m)


def reposition_into_fence() -> int | None:
    flight = hover()
    upload(flight, circle(60.0, 20.0), 1)
    return flight.command_at(192, (60.0, 0.0, GROUND_AMSL_M + 15.0), -1, 1, 0, NAN)


# --- 8: GPS loss ----------------------------------------------------------------------------------

LOST_S = 30.0
"""Without GPS, from 40 m up: the flight ends above the ground."""


class GpsLoss(NamedTuple):
    """At 6 m/s; times after the loss, or after the fix is back."""

    fix_s: float
    modes: list[tuple[float, int]]
    status: int
    """In the descent."""
    events: dict[int, float]
    flags: dict[int, int]
    """ESTIMATOR_STATUS by second."""
    accuracy_m: dict[int, float]
    sinks_m_s: float
    moves_m_s: float
    """As LOCAL_POSITION_NED says, from 15 s on."""
    rates_hz: tuple[float, float]
    """LOCAL_POSITION_NED and GLOBAL_POSITION_INT from 6 s on."""
    back_events: dict[int, float]
    jump_m: float
    """Within a second: the recorded output follows the jump so."""
    jump_s: float
    flags_back: int
    offboard_s: float
    climbs_m: float


@functools.cache
def gps_loss() -> GpsLoss:
    flight = hover(40.0)
    began_s = flight.now_s
    flight.aim = lambda t: local((6.0 * (t - began_s), 0.0, -40.0), (6.0, 0.0, 0.0), yaw=0.0)
    flight.command(511, 33, 0)
    flight.run(8.0)
    flight.set_parameter("SIM_GPS_USED", 0)
    lost_s = flight.now_s
    flight.run(6.0)
    blind_s, truth = flight.now_s, flight.simulation.vehicle
    height_m = truth.altitude_amsl_m
    flight.run(LOST_S - 6.0)
    status, sunk_m = flight.status, height_m - truth.altitude_amsl_m
    blind = [h.message for h in positions(flight, lost_s + 15.0)]
    moves_m_s = sum(math.hypot(m.vx, m.vy) for m in blind) / len(blind)
    counted = tuple(
        len(flight.of(kind, blind_s)) / (LOST_S - 6.0)
        for kind in ("LOCAL_POSITION_NED", "GLOBAL_POSITION_INT")
    )
    modes = [(t - lost_s, mode) for t, mode in flight.modes(lost_s)]
    reports = {round(h.t_s - lost_s): h.message for h in flight.times("ESTIMATOR_STATUS", lost_s)}
    events = {number: t - lost_s for number, t in flight.events(lost_s).items()}
    flight.set_parameter("SIM_GPS_USED", 10)
    back_s, low_m = flight.now_s, truth.altitude_amsl_m
    flight.run(12.0)
    track = positions(flight, back_s)
    early = [heard for heard in track if heard.t_s - back_s < 2.5]
    jumps = [
        (math.hypot(b.message.x - a.message.x, b.message.y - a.message.y), a.t_s - back_s)
        for a, b in zip(early, early[30:], strict=False)
    ]
    offboard = [t - back_s for t, mode in flight.modes(back_s) if mode == OFFBOARD]
    flags_back = [h.message.flags for h in flight.times("ESTIMATOR_STATUS", back_s + 2.5)]
    return GpsLoss(
        min(h.t_s for h in flight.times("GPS_RAW_INT", lost_s) if h.message.fix_type == 0) - lost_s,
        modes,
        status,
        events,
        {second: message.flags for second, message in reports.items()},
        {second: message.pos_horiz_accuracy for second, message in reports.items()},
        sunk_m / (LOST_S - 6.0),
        moves_m_s,
        (counted[0], counted[1]),
        {number: t - back_s for number, t in flight.events(back_s).items()},
        *max(jumps),
        flags_back[0],
        min(offboard, default=NAN),
        truth.altitude_amsl_m - low_m,
    )


def blind_modes() -> list[int]:
    return [mode for _, mode in gps_loss().modes]
