"""A sensor is one class and one row of a table: all that it says of itself is done, and no more."""

from collections.abc import Iterator
from dataclasses import replace
from types import NoneType
from typing import Any, Final, get_args, get_type_hints

import pytest
from scripted_vehicle import MISSION, Pair, Vehicle
from wires import heard, wire

from companion.config import load_mission
from companion.mavlink import sensors
from companion.mavlink.checks import Check, check
from companion.mavlink.near_sensing import NearScanner
from companion.mavlink.poses import Poses
from companion.mavlink.preflight import checks_of
from companion.mavlink.rangefinder import Rangefinder
from companion.mavlink.sensors import SENSORS, others_of, scanner_of
from companion.mavlink.terrain_download import TerrainRadar
from companion.mission.changes import HANDLERS
from companion.mission.events import GroundSeen
from companion.mission.mission import Mission
from companion.session import Session

FIELD = "endurance_s"
"""Stands for the field of a sensor that a mission may have."""
WIND, BEAM = wire.MAVLINK_MSG_ID_WIND, wire.MAVLINK_MSG_ID_DISTANCE_SENSOR
"""Of what autopilots stream and nobody else reads (`frames.IGNORED_MESSAGES`)."""


class Further:
    """Reads one kind of the autopilot and another of component 77, and says so after both."""

    streams_hz: Final = {WIND: 7.0, wire.MAVLINK_MSG_ID_SYS_STATUS: 0.1}

    def __init__(self, mission: Mission, _poses: Poses) -> None:
        self.is_for = getattr(mission, FIELD)
        self.reads = {(1, WIND): self._read, (77, BEAM): self._read}
        self.heard: list[tuple[int, str, float]] = []

    def _read(self, message: Any, now_s: float) -> None:
        self.heard.append((message.get_srcComponent(), message.get_type(), now_s))

    def seen(self, now_s: float, _known: object) -> GroundSeen | None:
        return GroundSeen(time_s=now_s, above_m=5.0) if len(self.heard) == 2 else None

    def checks(self, *_: object) -> Iterator[Check]:
        yield check("further", False, "made up", "Take it off.")


def flown(mission: Mission) -> tuple[Pair, list[Any]]:
    """It is prepared, and each component says each of both; further sensors."""
    it = Pair(Session(mission, seed=1, lockstep=True), Vehicle()).run_for(5.0)
    for component in (1, 77, 78, 100):
        for name in ("WIND", "DISTANCE_SENSOR"):
            it.feed(bytes(heard(name, (1, component)).get_msgbuf()))
    return it, [each for each in it.session.sensors if isinstance(each, Further)]


def test_a_further_sensor_is_one_class_and_one_row(monkeypatch: pytest.MonkeyPatch) -> None:
    """Heard, and nothing else of them; asked for; checked; what it says reaches the mission."""
    monkeypatch.setitem(sensors.SENSORS, FIELD, Further)
    it, [further] = flown(replace(MISSION, **{FIELD: 900.0}))
    assert further.is_for == 900.0
    now_s = it.session.now_s
    assert further.heard == [(1, "WIND", now_s), (77, "DISTANCE_SENSOR", now_s)]
    asked = {m.param1: m.param2 for m in it.sent("COMMAND_LONG") if m.command == 511}
    assert asked[WIND] == pytest.approx(1e6 / 7.0)
    assert asked[wire.MAVLINK_MSG_ID_SYS_STATUS] == 1e6  # others want it more often
    assert it.session.vehicle is not None
    assert it.session.vehicle.streams.missing == []  # it may have nothing to say
    assert "further" in [each.name for each in checks_of(it.session)]
    assert it.session.state.vehicle.ground_above_m == 5.0
    assert flown(replace(MISSION, **{FIELD: None}))[1] == []


def lidar(kind: str, component: int) -> Mission:
    mission: Any = load_mission("forest")
    near = replace(mission.near, kind=kind, component_id=component)
    changed: Mission = replace(mission, near=near)
    return changed


RADAR = TerrainRadar, {(100, 134), (100, 136)}, {}
FINDER = Rangefinder, {(1, 30), (1, 132)}, {30: 20.0, 132: 10.0}


@pytest.mark.parametrize(
    ("mission", "sensors_of"),
    [
        (lidar("obstacle_distance", 196), [(NearScanner, {(1, 30), (196, 330)}, {30: 20.0})]),
        (lidar("distance_sensor", 158), [(NearScanner, {(1, 30), (158, 132), (1, 1)}, {30: 20.0})]),
        (
            lidar("distance_sensor", 1),
            [(NearScanner, {(1, 30), (1, 132), (1, 1)}, {30: 20.0, 132: 20.0})],
        ),
        (MISSION, [RADAR]),
        (replace(MISSION, scanner_component_id=None), [(TerrainRadar, set(), {})]),
        (replace(MISSION, rangefinder_error_m=1.0), [RADAR, FINDER]),
    ],
)
def test_a_mission_has_one_scanner_and_what_it_names(mission: Mission, sensors_of: Any) -> None:
    """Each reads what it needs, poses too, and has the autopilot asked for its share of it."""
    poses = Poses(mission.frame)
    made = scanner_of(mission, poses), *others_of(mission, poses)
    assert [(type(each), {*each.reads}, {**each.streams_hz}) for each in made] == sensors_of


@pytest.mark.parametrize("kind", [*SENSORS.values(), NearScanner, TerrainRadar])
def test_what_a_sensor_says_has_an_effect(kind: Any) -> None:
    told = get_type_hints(kind.seen)["return"]
    assert {*(get_args(told) or (told,))} - {NoneType} <= HANDLERS.keys()
