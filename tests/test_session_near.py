"""The whole companion with a lidar as its eyes, as bytes in and bytes out."""

import math

import pytest
import scripted_vehicle
from lidars import obstacle_distance
from pymavlink.dialects.v20 import all as wire
from scripted_vehicle import Pair, Vehicle

from companion.config import load_mission
from companion.mission.state import Phase, Reason
from companion.session import Session

HOME_AMSL_M = 400.0
EMPTY, REACH_CM = 1601, 1600


class Seeing(Vehicle):
    """A vehicle with a lidar that sees one post of 0.6 m, or nothing."""

    def __init__(self) -> None:
        super().__init__()
        self.driver = wire.MAVLink(None, srcSystem=1, srcComponent=196)
        self.parameters["GUID_TIMEOUT"] = 0.5
        self.is_dead = False
        self.reach_cm = REACH_CM
        self.post_ne_m: tuple[float, float] | None = None

    def tick(self) -> bytes:
        said = super().tick()
        if self.is_dead:
            return said
        told = [EMPTY] * 72
        if self.post_ne_m is not None:
            north, east = self.post_ne_m[0] - self.north_m, self.post_ne_m[1] - self.east_m
            away_m, bearing = math.hypot(north, east) - 0.3, math.atan2(east, north)
            half = math.asin(0.3 / (away_m + 0.3))
            for k in range(72):
                off = math.remainder(math.radians(5.0 * k) - bearing, math.tau)
                if abs(off) < half + math.radians(2.5) and away_m < 16.0:
                    told[k] = round(100.0 * away_m)
        sweep = obstacle_distance(self.time_ms * 1e-3, told, reach_cm=self.reach_cm)
        return self.pack(sweep, self.driver) + said


@pytest.fixture(autouse=True)
def _low(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scripted_vehicle, "HOME_AMSL_M", HOME_AMSL_M)


def with_eyes() -> Pair:
    return Pair(Session(load_mission("forest"), seed=1, lockstep=True), Seeing())


def is_stopping(it: Pair, reason: Reason) -> bool:
    stop = it.session.state.path.stop
    return stop is not None and stop.reason is reason


def place(it: Pair, by_m: float) -> tuple[float, float]:
    path = it.session.state.path
    assert path is not None
    north, east, _ = path.leg.subpath.pose(path.reference.length_m + by_m).point_nea_m
    return north, east


def test_something_that_steps_into_its_way_stops_it_within_a_fifth_of_a_second() -> None:
    it = with_eyes().run_until(lambda it: it.session.state.reference.speed_m_s > 2.0)
    vehicle = it.vehicle
    assert it.phase is Phase.FLYING
    vehicle.post_ne_m, since_s = place(it, 6.0), it.session.now_s
    it.run_until(lambda it: is_stopping(it, Reason.NEW_THREAT), limit_s=1.0)
    assert it.session.now_s - since_s <= 0.2 + 1e-6
    assert it.fly_to(Phase.HOLDING, 10.0).session.state.reason is Reason.NEW_THREAT
    north, east = vehicle.post_ne_m
    assert math.hypot(north - vehicle.north_m, east - vehicle.east_m) - 0.3 > 1.0


def test_a_sensor_that_comes_to_see_less_in_flight_is_told_of_once() -> None:
    it = with_eyes().fly_out()
    for reach_cm in (1000, 1600, 1000):
        it.vehicle.reach_cm = reach_cm
        it.run_for(0.5)
    said = "".join(each.text for each in it.sent("STATUSTEXT"))
    assert said.count("sensor sees 10 m of R = 16 m") == 1
