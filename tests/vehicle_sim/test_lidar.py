"""The lidar, its driver and faults, and ArduPilot's rangefinder.

ArduPilot's eight sectors are seen by the rows of arducopter-lidar.tlog (conformance/lidar.py).
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from harness import Rig

NOT_THERE, NOT_KNOWN, PROXIMITY = 1601, 65535, 0x4000000
DRIVER = (1, 196)
POST = {"north_m": 10.0, "east_m": 0.0, "radius_m": 1.0, "height_m": 50.0}
AT_ONCE = {"kind": "sectors"}
"""Takes a tenth of the time of beam after beam."""
approx = pytest.approx


class Bench(Rig):
    """A vehicle that is held where the test wants it, and what it says."""

    def __init__(
        self,
        seconds: float,
        *,
        lidar: Any = (),
        asks: Any = (),
        hold_m: float = 5.0,
        turn_rad: tuple[float, float, float] = (0.0, 0.0, 0.0),
        **fields: Any,
    ) -> None:
        super().__init__(lidar={"range_m": 16.0} | dict(lidar), **fields)
        self.turn_rad, flies = turn_rad, self.autopilot.step

        def held(*arguments: Any) -> Any:
            replies, vehicle = flies(*arguments), self.vehicle
            vehicle.altitude_amsl_m = self.home[2] + hold_m
            vehicle.roll_rad, vehicle.pitch_rad, vehicle.heading_rad = self.turn_rad
            return replies

        self.autopilot.step = held
        self.run(0.1 if asks else 0.0)
        for number in asks:
            self.command(511, number, 100_000)
        self.run(seconds)

    def maps(self, since_s: float = 0.0) -> list[Any]:
        return self.said("OBSTACLE_DISTANCE", DRIVER, since_s)


@pytest.mark.parametrize("bearing_deg", [0.0, 200.0, 357.0])
def test_a_post_is_in_the_sector_where_mavlink_puts_it_and_is_told_on_every_link(
    bearing_deg: float,
) -> None:
    bearing = math.radians(bearing_deg)
    place = {"north_m": 10 * math.cos(bearing), "east_m": 10 * math.sin(bearing), "radius_m": 0.2}
    lidar = {"step_deg": 0.5, "latency_s": 0.06}
    bench = Bench(2.0, lidar=lidar, trees=[POST | place], links=2)
    maps = bench.all("OBSTACLE_DISTANCE")
    assert len(bench.all("OBSTACLE_DISTANCE", link=1)) == len(maps) == approx(20, abs=2)
    told = maps[-1].message
    assert 0.059 <= maps[-1].at_s - told.time_usec * 1e-6 <= 0.08
    assert (told.frame, told.increment, told.min_distance, told.max_distance) == (12, 5, 20, 1600)
    met = [k for k, cm in enumerate(told.distances) if cm < NOT_THERE]
    off_deg = [abs(math.remainder(told.angle_offset + 5.0 * k - bearing_deg, 360.0)) for k in met]
    assert min(off_deg) <= 2.5
    assert max(off_deg) <= 5.0
    assert min(told.distances) == approx(980, abs=1)
    assert {(m.type, m.autopilot) for m in bench.said("HEARTBEAT", DRIVER)} == {(18, 8)}


def test_nearer_than_the_least_distance_nothing_is_known() -> None:
    near = POST | {"north_m": 1.3}
    told, known = (
        Bench(1.0, trees=[near], lidar={"min_m": least_m}).maps()[-1].distances
        for least_m in (0.5, 0.1)
    )
    unknown = {k for k, cm in enumerate(told) if cm == NOT_KNOWN}
    assert set() < unknown <= {*range(14), *range(58, 72)}  # the post's sectors
    assert min(known) == 30


def test_noise_and_lost_echoes_have_the_size_that_the_world_says_and_are_the_seeds() -> None:
    lidar = AT_ONCE | {"noise_m": 0.1, "lost_share": 0.2, "step_deg": 5.0}

    def ahead(seed: int, seconds: float) -> Any:
        bench = Bench(seconds, trees=[POST | {"radius_m": 3.0}], lidar=lidar, seed=seed)
        return np.array([m.distances[0] for m in bench.maps()])

    told = ahead(3, 60.0)[5:]
    assert np.mean(told == NOT_THERE) == approx(0.2, abs=0.06)
    met = told[told != NOT_THERE] * 0.01
    assert met.mean() == approx(7.0, abs=0.02)
    assert met.std() == approx(0.1, abs=0.02)
    assert not np.array_equal(ahead(4, 4.0), ahead(3, 4.0))


SEES: dict[str, Callable[[Any, Any, int], Any]] = {  # maps, their distances, beats
    "lidar_dead": lambda maps, _, beats: not maps and beats == 3,
    "lidar_off": lambda maps, _, beats: not maps and beats == 0,
    "lidar_loss 100 %": lambda maps, _, beats: not maps and beats == 3,
    "lidar_blind": lambda _, cm, __: set(cm.flat) == {NOT_THERE},
    "lidar_turned 180 deg": lambda _, cm, __: set(cm.argmin(axis=1)) <= {35, 36, 37},
    "lidar_dust 10 %": lambda _, cm, __: 0.05 < np.mean(cm < 320) < 0.25 and cm[:, 36].min() < 320,
    "lidar_clock 5000 ms": lambda maps, _, __: abs(maps[0].time_usec - 6_200_000) < 100_000,
    "lidar_rate 100 Hz": lambda maps, _, __: abs(len(maps) - 285) <= 4,
}


@pytest.mark.parametrize("line", SEES)
def test_a_client_sees_the_fault(line: str) -> None:
    bench = Bench(4.0, trees=[POST], lidar=AT_ONCE, faults=f"at 1 s: {line}")
    maps, beats = bench.maps(1.15), bench.said("HEARTBEAT", DRIVER, 1.15)
    assert SEES[line](maps, np.array([m.distances for m in maps]), len(beats))


def test_a_stuck_lidar_repeats_itself_with_new_stamps() -> None:
    bench = Bench(1.2, trees=[POST], lidar=AT_ONCE, faults="at 1 s: lidar_stuck")
    bench.turn_rad = (0.0, 0.0, 2.0)
    maps = bench.run(2.0).maps(1.15)
    assert len({tuple(m.distances) for m in maps}) == 1
    assert len({m.time_usec for m in maps}) == len(maps)


def test_a_leaning_vehicles_lidar_and_rangefinder_measure_slant_ranges_to_the_ground() -> None:
    told = Bench(1.0, turn_rad=(0.0, math.radians(-30.0), 1.0)).maps()[-1].distances
    assert (told[0], told[36]) == (approx(1030, abs=3), NOT_THERE)  # 5.15 m / sin 30 deg
    how: dict[str, Any] = {"turn_rad": (math.radians(20.0), math.radians(-10.0), 1.0)}
    how |= {"asks": (132, 173), "hold_m": 16.0, "RNGFND1_TYPE": 100.0, "RNGFND1_MAX": 12.0}
    bench = Bench(2.0, faults="at 3 s: rangefinder_off", **how)
    slant_m = 16.0 / (math.cos(math.radians(20.0)) * math.cos(math.radians(10.0)))
    m = bench.last("DISTANCE_SENSOR")
    assert m.current_distance == approx(slant_m * 100, abs=1)  # also beyond its maximum
    assert (m.id, m.orientation, m.type, m.min_distance, m.max_distance) == (0, 25, 4, 20, 1200)
    assert bench.last("RANGEFINDER").distance == approx(slant_m, abs=0.01)
    bench.run(2.0)
    assert bench.said("DISTANCE_SENSOR", since_s=3.05) == []
    assert {m.distance for m in bench.said("RANGEFINDER", since_s=3.05)} == {0.0}


@pytest.mark.parametrize("dead", [False, True])
def test_a_second_lidar_is_told_as_sectors_beside_the_drivers_own_and_its_death_by_a_bit(
    *, dead: bool
) -> None:
    second = {"second_lidar": {"range_m": 12.0, "output": "autopilot"}}
    fault = "at 1 s: lidar_dead" if dead else ""
    bench = Bench(3.0, trees=[POST], lidar={"range_m": 40.0}, asks=(132, 1), faults=fault, **second)
    sectors = bench.said("DISTANCE_SENSOR", since_s=1.5)
    assert dead or min(bench.maps()[-1].distances) == approx(900, abs=1)
    assert bool(sectors) is not dead
    assert dead or min(m.current_distance for m in sectors) == approx(900, abs=5)
    assert {(m.type, m.max_distance, m.id - m.orientation) for m in sectors} <= {(0, 1200, 10)}
    status = bench.last("SYS_STATUS")
    assert status.onboard_control_sensors_present & PROXIMITY
    assert bool(status.onboard_control_sensors_health & PROXIMITY) is not dead
