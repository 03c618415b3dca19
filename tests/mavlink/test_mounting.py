"""How a lidar is mounted, from a turn on the spot among posts: rays met in closed form."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as wire
from test_near_scanner import HERE_NEA_M, distances, mission

import companion
from companion.geodesy import FloatArray
from companion.mavlink.mounting import MountingCheck, Turning
from companion.mavlink.near_scanner import NearScanner
from companion.mavlink.preflight import CheckStatus, checks_of
from companion.session import Session
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import read_world

SEEDS = pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in (1, 2))]
)
PERIOD_S, RANGE_M = 0.1, 16.0
BODY, NORTH = wire.MAV_FRAME_BODY_FRD, wire.MAV_FRAME_GLOBAL
WIDTH_RAD = math.radians(5.0)
Posts = list[tuple[float, float, float]]
"""Distance, true bearing and radius of each."""


def some_posts(seed: int) -> Posts:
    rng = np.random.default_rng(seed)
    return [
        (rng.uniform(2.5, 14.0), rng.uniform(0.0, math.tau), rng.uniform(0.2, 0.8))
        for _ in range(rng.integers(5, 12))
    ]


def ranges_m(posts: Posts, bearings_rad: FloatArray) -> FloatArray:
    """Where rays from the sensor first meet a post; inf: nowhere in reach."""
    away_m, at_rad, radius_m = np.array(posts).reshape(-1, 3).T[:, :, None]  # (P, 1) each
    along_m = away_m * np.cos(at_rad - bearings_rad)
    aside_m = away_m * np.sin(at_rad - bearings_rad)
    meets = (along_m > 0.0) & (np.abs(aside_m) < radius_m)
    half_m = np.sqrt(np.where(meets, radius_m**2 - aside_m**2, 0.0))
    met_m = np.where(meets & (along_m - half_m < RANGE_M), along_m - half_m, np.inf)
    return np.min(met_m, axis=0, initial=np.inf)


class Turned:
    """A vehicle that is turned among posts; its sensor tells `sense` x bearing + `share` x yaw."""

    def __init__(
        self,
        posts: Posts,
        *,
        sense: float = 1.0,
        share: float = -1.0,
        frame: int = BODY,
        part: tuple[float, int] | None = None,
        by_deg: float = 120.0,
    ) -> None:
        of = mission()
        assert of.near is not None
        self.scanner, self.check = NearScanner(of), MountingCheck(of.near)
        self.scanner.mounting = self.check
        now_s, self.yaw_rad = 100.0, math.radians(200.0)
        for step_deg in np.linspace(0.0, by_deg, 30):
            self.yaw_rad = math.radians(200.0 + step_deg)
            middles_rad = sense * (np.arange(72) * WIDTH_RAD - share * self.yaw_rad)
            rays_rad = middles_rad[:, None] + WIDTH_RAD * np.array([-0.4, 0.0, 0.4])
            away_m = ranges_m(posts, rays_rad.ravel()).reshape(rays_rad.shape).min(axis=1)
            told = [1601 if math.isinf(each) else round(100.0 * each) for each in away_m.tolist()]
            if part is not None:
                told[part[1]] = round(100.0 * part[0])
            self.tell(distances(now_s, distances=told, frame=frame), now_s)
            now_s += PERIOD_S
        self.tell(None, now_s)

    def tell(self, message: Any, now_s: float) -> None:
        """A pose, and the message that is stamped with its time."""
        yaw_rad = math.remainder(self.yaw_rad, math.tau)
        attitude = wire.MAVLink_attitude_message(round(now_s * 1e3), 0, 0, yaw_rad, 0, 0, 0)
        self.scanner.on_message(attitude, now_s)
        self.scanner.on_position(now_s, HERE_NEA_M)
        if message is not None:
            self.scanner.on_message(message, now_s)
        self.scanner.seen(now_s)


@SEEDS
@pytest.mark.parametrize(
    ("wrong", "turning"),
    [
        ({}, Turning.STAYS),
        ({"frame": NORTH, "share": 0.0}, Turning.STAYS),
        ({"sense": -1.0, "share": 1.0}, Turning.MIRRORED),
        ({"share": 0.0}, Turning.NORTH_UP),
        ({"frame": NORTH}, Turning.NOSE_UP),
    ],
)
def test_a_turn_shows_how_the_sensor_counts(
    wrong: dict[str, Any], turning: Turning, seed: int
) -> None:
    assert Turned(some_posts(seed), **wrong).check.turning() is turning
    if wrong:
        assert Turned(some_posts(seed), by_deg=-120.0, **wrong).check.turning() is turning


def test_without_a_turn_or_anything_in_reach_nothing_is_told() -> None:
    still = Turned(some_posts(1), sense=-1.0, share=1.0, by_deg=60.0).check
    assert still.turning() is Turning.NOT_TURNED
    assert still.part is None
    alone = Turned([], sense=-1.0, share=1.0).check
    assert alone.turning() is Turning.UNDECIDED
    assert alone.nearest is None


@SEEDS
def test_a_part_of_the_vehicle_turns_with_it_and_nothing_else_does(seed: int) -> None:
    assert Turned(some_posts(seed)).check.part is None
    found = Turned(some_posts(seed), part=(0.6, 60)).check.part
    assert found is not None
    assert found.distance_m == pytest.approx(0.6, abs=0.01)
    assert found.off_nose_rad == pytest.approx(math.radians(-60.0), abs=math.radians(7.5))


@SEEDS
def test_the_nearest_thing_is_where_it_is_from_the_nose(seed: int) -> None:
    posts = some_posts(seed)
    it = Turned(posts)
    seen = it.check.nearest
    assert seen is not None
    away_m, at_rad, radius_m = min(posts, key=lambda post: post[0] - post[2])
    assert seen.distance_m == pytest.approx(away_m - radius_m, abs=0.1)
    off_rad = math.remainder(seen.off_nose_rad - (at_rad - it.yaw_rad), math.tau)
    assert abs(off_rad) < WIDTH_RAD + math.asin(radius_m / away_m)
    assert it.check.rate_hz == pytest.approx(1.0 / PERIOD_S, rel=0.01)
    assert it.check.age_s == pytest.approx(mission().near.latency_s, abs=PERIOD_S)  # type: ignore[union-attr]


def test_a_copter_that_is_turned_in_the_air_by_a_ground_station_is_told_that_all_is_well() -> None:
    of = mission()
    world = read_world(Path(companion.__file__).parent / "environments/forest/world.toml")
    vehicle = Simulation(world, seed=1, links=2)
    session = Session(of, seed=1, lockstep=False, shadow=True)
    assert of.near is not None
    assert session.near is not None
    session.near.mounting = MountingCheck(of.near)
    station = wire.MAVLink(None, srcSystem=255, srcComponent=190)

    def run(seconds: float) -> None:
        end_us = vehicle.now_us + round(seconds * 1e6)
        while vehicle.now_us < end_us:
            vehicle.step()
            for link, frame in vehicle.take_frames():
                if link == 0:
                    session.receive(frame, vehicle.now_us * 1e-6)
            for frame in session.run().frames:
                vehicle.receive(0, frame)

    def command(number: int, *values: float) -> None:
        filled = (*values, *[0.0] * (7 - len(values)))
        vehicle.receive(1, station.command_long_encode(1, 1, number, 0, *filled).pack(station))
        run(1.0)

    run(45.0)
    assert "sensor turn" in {check.name for check in checks_of(session)}
    command(wire.MAV_CMD_DO_SET_MODE, 1, 4)
    command(wire.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    command(wire.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 3.0)
    run(8.0)
    command(wire.MAV_CMD_CONDITION_YAW, 170.0, 20.0, 1, 1)
    run(10.0)
    checks = [check for check in checks_of(session) if check.name.startswith("sensor")]
    assert all(check.status is not CheckStatus.REFUSED for check in checks)
    assert [check.what for check in checks if check.name == "sensor turn"] == [Turning.STAYS.value]
