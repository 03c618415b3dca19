"""What a lidar behind a real autopilot saw among posts of known place (recordings/README.md)."""

import math
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from held import recorded
from numpy.typing import NDArray

from companion.geodesy import LocalFrame
from companion.mavlink.autopilots.messages import position
from companion.mavlink.dialect import wire
from companion.mavlink.near_scanner import ATTITUDE, OF_AUTOPILOT
from companion.mavlink.near_sensing import NearSensing, Sight
from companion.mavlink.poses import Poses
from companion.world.known_map import Lattice
from companion.world.near_map import NearMap, NearSensor

HOME = LocalFrame(latitude_deg=51.8752066, longitude_deg=14.6487830)
LIDAR = NearSensor(kind="distance_sensor", component_id=1, range_m=16.0, blind_m=0.2)
POSTS = np.array([(3 + 10 * i, 2 + 10 * j) for i in range(-10, 10) for j in range(-10, 10)])
LATTICE = Lattice(cell_m=0.25, north_min_m=-150.0, east_min_m=-150.0, shape=(1200, 1200))


def seen(until_s: float) -> Iterator[tuple[float, NDArray[np.float64], NearSensing]]:
    """Vehicle time, place and what the lidar says, at each position."""
    read = {wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, ATTITUDE, *OF_AUTOPILOT}
    poses, now_s = Poses(HOME), 0.0
    sensing = NearSensing(LIDAR, poses)
    for _, message in recorded("arducopter-lidar.tlog", frozenset(wire.mavlink_map) - read):
        if (message.get_srcSystem(), message.get_srcComponent()) != (1, 1):
            continue
        if message.get_msgId() == ATTITUDE:
            poses.on_attitude(message)
        elif message.get_msgId() in OF_AUTOPILOT:
            sensing.on_message(message, now_s)
        elif (told := position(message, 0.0, HOME)) is not None:
            now_s = told.time_s
            if now_s >= until_s:
                return
            poses.on_position(now_s, told.position_nea_m)
            yield now_s, np.array(told.position_nea_m[:2]), sensing


def test_times_of_silence_are_told_apart() -> None:
    """219.7 to 244.2 s no sector had an echo, which counts after half a second; it was well."""
    seconds, before_s = Counter[Sight](), 210.0
    for now_s, _, sensing in seen(250.0):
        if now_s > before_s:
            seconds[sensing.sight(now_s)] += now_s - before_s
            before_s = now_s
    assert seconds[Sight.NOTHING_THERE] == pytest.approx(24.0, abs=0.5)
    assert seconds[Sight.SEES] == pytest.approx(16.0, abs=0.5)


def cells_of(points: NDArray[np.float64]) -> tuple[Any, Any]:
    low = np.array([LATTICE.north_min_m, LATTICE.east_min_m])
    cells = np.floor((points - low) / LATTICE.cell_m).astype(int)
    return cells[:, 0], cells[:, 1]


@pytest.mark.parametrize("until_s", [110.0, pytest.param(220.0, marks=pytest.mark.nightly)])
def test_at_no_time_is_a_post_free_and_the_space_between_is(until_s: float) -> None:
    turn = np.linspace(0.0, math.tau, 100)  # 6 cm apart: a cell has 25
    around = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    surfaces = (POSTS[:, None] + around).reshape(-1, 2)
    near, share, looked_s = NearMap(LATTICE), [], 55.0
    for now_s, here, sensing in seen(until_s):
        for sweep in sensing.sweeps():
            near.add(sweep)
        if now_s < looked_s:
            continue
        looked_s = now_s + 2.0
        assert not near.free()[cells_of(surfaces)].any(), now_s
        assert not near.free()[cells_of(POSTS)].any(), now_s
        disc = here + 4.0 * np.random.default_rng(1).uniform(-1.0, 1.0, (500, 2))
        apart = np.hypot(*(disc[:, None] - POSTS[None]).transpose(2, 0, 1)).min(axis=1) - 1.0
        inside = np.hypot(*(disc - here).T) < 4.0
        share.append(near.free()[cells_of(disc[inside & (apart > 0.75)])].mean())
    assert len(share) > 0.45 * (until_s - 55.0)
    assert np.mean(share) > 0.85
