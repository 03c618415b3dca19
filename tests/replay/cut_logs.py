"""Recorded flights cut, changed and written anew, as logs of MAVLink frames."""

import functools
import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from recordings import recording

from companion.config import load_mission
from companion.mavlink.dialect import Message, wire
from companion.mavlink.frames import number_of, sender_of
from companion.mission.mission import Mission
from companion.replay.shadow import watch
from companion.replay.shadow_report import ShadowReport
from companion.telemetry.logs import Record, open_log

MISSION = str(Path(__file__).with_name("mission.toml"))
ZURICH = "origin.latitude_deg=47.397742 origin.longitude_deg=8.545594 "
"""Where PX4's simulations begin."""
PLANE = """
    vehicle.kind=plane vehicle.acceleration_m_s2=2.0 vehicle.climb_rate_m_s=2.5
    vehicle.climb_angle_deg=6.0 vehicle.dive_angle_deg=4.0 vehicle.loiter_radius_m=100.0
    vehicle.tracking_error_m=15.0 planner.scan_range_m=2000.0 planner.safety_distance_m=10.0
"""
MISSIONS = {
    "copter-canberra": "",
    "copter-zurich": ZURICH
    + "altitude.floor_amsl_m=492.0 altitude.ceiling_amsl_m=638.0 terrain.highest_amsl_m=476.0 "
    + "vehicle.tracking_error_m=2.0 planner.safety_distance_m=3.0",
    "plane-canberra": PLANE
    + "altitude.floor_amsl_m=609.0 altitude.ceiling_amsl_m=834.0 terrain.highest_amsl_m=554.0 "
    + "vehicle.speed_m_s=22.0 vehicle.turn_radius_m=250.0",
    "plane-zurich": ZURICH
    + PLANE
    + "altitude.floor_amsl_m=508.0 altitude.ceiling_amsl_m=738.0 terrain.highest_amsl_m=458.0 "
    + "vehicle.speed_m_s=14.0 vehicle.turn_radius_m=85.0",
}
"""By vehicle and place, what differs from the copter's mission near Canberra."""
VEHICLE = (1, 1)
COMPANION = (1, 191)
STATION = (255, 190)


def alone(path: Path, system_id: int | None = None) -> ShadowReport:
    """The health of a log."""
    return watch(path, None, system_id=system_id)


@functools.cache
def whole(name: str) -> ShadowReport:
    """The health of a recorded flight."""
    return alone(recording(name))


def mission(name: str, *, evaluations: int | None = None) -> Mission:
    """A mission for a recorded flight, with so many candidates to a plan."""
    chosen = load_mission(MISSION, settings=MISSIONS[name].split())
    settings = chosen.task.settings
    quick = replace(settings, evaluations=evaluations or settings.evaluations)
    return replace(chosen, task=replace(chosen.task, settings=quick))


def recorded(name: str, *, from_s: float = 0.0, until_s: float = 1e9) -> Iterator[Record]:
    """A recorded flight between two times, seconds after its first record."""
    records = _records(name)
    for record in records:
        at_s = (record.time_us - records[0].time_us) * 1e-6
        if at_s > until_s:
            return
        if at_s >= from_s:
            yield record


@functools.cache
def _records(name: str) -> list[Record]:
    return list(open_log(recording(name)).records())


def written(path: Path, records: Iterable[Record]) -> Path:
    """A .tlog of these."""
    with path.open("wb") as file:
        for record in records:
            file.write(struct.pack(">Q", record.time_us) + record.frame)
    return path


def without(records: Iterable[Record], *numbers: int) -> Iterator[Record]:
    """What is left if the vehicle never says some messages."""
    for record in records:
        if number_of(record.frame) not in numbers or sender_of(record.frame) != VEHICLE:
            yield record


def thinned(records: Iterable[Record], number: int, keep_every: int) -> Iterator[Record]:
    """Only every so manyth of one kind of message."""
    count = 0
    for record in records:
        if number_of(record.frame) == number:
            count += 1
            if count % keep_every:
                continue
        yield record


def changed(
    records: Iterable[Record], number: int, change: Callable[[Message], None]
) -> Iterator[Record]:
    """Each message of one kind changed in place, and packed anew."""
    reader = wire.MAVLink(None)
    for record in records:
        if number_of(record.frame) != number or sender_of(record.frame) != VEHICLE:
            yield record
            continue
        message = reader.decode(bytearray(record.frame))
        change(message)
        yield Record(record.time_us, packed(message, VEHICLE))


def packed(message: Message, sender: tuple[int, int]) -> bytes:
    """A message as a frame of somebody's."""
    codec = wire.MAVLink(None, srcSystem=sender[0], srcComponent=sender[1])
    return bytes(message.pack(codec))
