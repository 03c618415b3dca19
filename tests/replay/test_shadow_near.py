"""What a lidar behind a real autopilot saw among posts of known place (recordings/README.md)."""

import io
import math
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cut_logs import recorded, written
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as wire
from recordings import recording
from rich.console import Console

from companion.geodesy import LocalFrame
from companion.mavlink.frames import number_of, sender_of
from companion.replay import shadow_near
from companion.replay.shadow import watch
from companion.replay.shadow_near import NearWatch
from companion.replay.shadow_report import ShadowReport, renderables
from companion.telemetry.logs import open_log
from companion.world.near_map import NearMap, NearSensor

NAME = "arducopter-lidar.tlog"
HOME = LocalFrame(latitude_deg=51.8752066, longitude_deg=14.6487830)
POSTS = np.array([(3 + 10 * i, 2 + 10 * j) for i in range(-10, 10) for j in range(-10, 10)])


@pytest.fixture(scope="module")
def report() -> ShadowReport:
    """Of 40 s about the time when it stood where no post was in reach."""
    with tempfile.TemporaryDirectory() as folder:
        records = recorded(NAME, from_s=210.0, until_s=250.0)
        return watch(written(Path(folder) / "cut.tlog", records), None, plans=False)


def test_times_of_silence_are_told_apart(report: ShadowReport) -> None:
    """219.7 to 244.2 s no sector had an echo, which counts after half a second; it was well."""
    (near,) = report.near_things
    assert near.sensor == "DISTANCE_SENSOR of component 1"
    assert near.range_m == 16.0
    assert near.seconds["NOTHING_THERE"] == pytest.approx(24.0, abs=0.5)
    assert near.seconds["DEAD"] == near.seconds["NEVER_HEARD"] == 0.0


def test_it_stands_in_the_report_that_people_read(report: ShadowReport) -> None:
    file = io.StringIO()
    console = Console(file=file, width=120)
    for part in renderables(report):
        console.print(part)
    words = " ".join(file.getvalue().split())
    assert "near things, by DISTANCE_SENSOR of component 1, up to 16 m," in words
    assert "nothing was in its reach for 24 s" in words


def maps_as_they_grow(until_s: float) -> Iterator[tuple[float, NearMap, NDArray[np.float64]]]:
    """The vehicle's time, the map as it is then, and where the vehicle is; in the air."""
    watching, shown_s = NearWatch(HOME, 1), 55.0
    for record in open_log(recording(NAME), system_id=1).records():
        frame, number = record.frame, number_of(record.frame)
        if number in shadow_near.MESSAGES:
            watching.on_frame(frame, sender_of(frame), number)
        now_s, here_ne_m = watching.here
        if now_s >= until_s:
            return
        if number == wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT and shown_s <= now_s:
            (sensor,) = watching.sensors.values()
            assert sensor.map is not None
            yield now_s, sensor.map, here_ne_m
            shown_s = now_s + 2.0


def cells_of(near: NearMap, points: NDArray[np.float64]) -> tuple[Any, Any]:
    low = np.array([near.lattice.north_min_m, near.lattice.east_min_m])
    cells = np.floor((points - low) / near.lattice.cell_m).astype(int)
    cells = cells[((cells >= 0) & (cells < near.lattice.shape)).all(axis=1)]
    return cells[:, 0], cells[:, 1]


@pytest.mark.parametrize("until_s", [110.0, pytest.param(220.0, marks=pytest.mark.nightly)])
def test_at_no_time_is_any_point_of_a_post_free_and_the_space_between_them_is(
    until_s: float,
) -> None:
    turn = np.linspace(0.0, math.tau, 100)  # 6 cm apart: a cell has 25
    around = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    surfaces = (POSTS[:, None] + around).reshape(-1, 2)
    share = []
    for now_s, near, here in maps_as_they_grow(until_s):
        assert not near.free()[cells_of(near, surfaces)].any(), now_s
        assert not near.free()[cells_of(near, POSTS)].any(), now_s
        disc = here + 4.0 * np.random.default_rng(1).uniform(-1.0, 1.0, (500, 2))
        apart = np.hypot(*(disc[:, None] - POSTS[None]).transpose(2, 0, 1)).min(axis=1) - 1.0
        inside = np.hypot(*(disc - here).T) < 4.0
        share.append(near.free()[cells_of(near, disc[inside & (apart > 0.75)])].mean())
    assert len(share) > 0.45 * (until_s - 55.0)
    assert np.mean(share) > 0.85


@pytest.mark.parametrize("sender", [(1, 195), (2, 196)])
def test_what_we_send_and_what_others_see_is_none_of_our_eyes(sender: tuple[int, int]) -> None:
    watching = NearWatch(HOME, 1)
    ours = wire.MAVLink(None, srcSystem=1, srcComponent=1)
    position = wire.MAVLink_global_position_int_message(
        1000, 518752066, 146487830, 100_000, 0, 0, 0, 0, 0
    )
    other = wire.MAVLink(None, srcSystem=sender[0], srcComponent=sender[1])
    distances = wire.MAVLink_obstacle_distance_message(0, 0, [500] * 72, 5, 20, 4000)
    for codec, message in ((ours, position), (other, distances)):
        frame = bytes(message.pack(codec))
        watching.on_frame(frame, sender_of(frame), number_of(frame))
    assert not watching.sensors


@pytest.mark.parametrize(
    ("component", "east_m", "range_m"), [(1, 5.0, 12.0), (2, 0.0, 40.0), (None, 0.0, 40.0)]
)
def test_the_sensor_of_the_mission_is_mounted_as_the_mission_says(
    component: int | None, east_m: float, range_m: float
) -> None:
    """5 m ahead of the sensor is something; by the mission it looks to the right."""
    right = NearSensor(
        kind="distance_sensor", component_id=component or 1, range_m=12.0, yaw_rad=math.pi / 2.0
    )
    watching = NearWatch(HOME, 1, None if component is None else right)
    codec = wire.MAVLink(None, srcSystem=1, srcComponent=1)
    for k in range(8):
        at_ms = 1000 + 50 * k
        said = (
            wire.MAVLink_global_position_int_message(
                at_ms, 518752066, 146487830, 100_000, 0, 0, 0, 0, 0
            ),
            wire.MAVLink_distance_sensor_message(at_ms, 20, 4000, 500, 0, 10, 0, 0),
            wire.MAVLink_attitude_message(at_ms, 0, 0, 0, 0, 0, 0),
        )
        for message in said:
            frame = bytes(message.pack(codec))
            watching.on_frame(frame, sender_of(frame), number_of(frame))
    (sensor,) = watching.sensors.values()
    assert sensor.map is not None
    ahead = np.array([[5.0 if east_m == 0.0 else 0.0, east_m]])
    assert sensor.map.occupied()[cells_of(sensor.map, ahead)].all()
    assert not sensor.map.occupied()[cells_of(sensor.map, ahead[:, ::-1])].any()
    assert sensor.found.range_m == range_m
