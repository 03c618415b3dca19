"""The whole companion with a lidar as its eyes, as bytes in and bytes out."""

import pytest
import scripted_vehicle
from lidars import obstacle_distance
from pymavlink.dialects.v20 import all as wire
from scripted_vehicle import Pair, Vehicle

from companion.config import load_mission
from companion.mission.state import Phase, Reason
from companion.session import Session

NOTHING_CM = 1601


class Seeing(Vehicle):
    """A vehicle with a lidar, and something as far away all round it, or nothing."""

    def __init__(self) -> None:
        super().__init__()
        self.driver = wire.MAVLink(None, srcSystem=1, srcComponent=196)
        self.parameters["GUID_TIMEOUT"] = 0.5
        self.reach_cm, self.thing_cm = 1600, NOTHING_CM

    def tick(self) -> bytes:
        said, told = super().tick(), [self.thing_cm] * 72
        sweep = obstacle_distance(self.time_ms * 1e-3, told, reach_cm=self.reach_cm)
        return self.pack(sweep, self.driver) + said


@pytest.fixture
def it(monkeypatch: pytest.MonkeyPatch) -> Pair:
    """On its way."""
    monkeypatch.setattr(scripted_vehicle, "HOME_AMSL_M", 400.0)
    return Pair(Session(load_mission("forest"), seed=1, lockstep=True), Seeing()).fly_out()


def test_something_that_steps_into_its_way_stops_it_within_a_fifth_of_a_second(it: Pair) -> None:
    def is_stopping(it: Pair) -> bool:
        stop = it.session.state.path.stop
        return stop is not None and stop.reason is Reason.NEW_THREAT

    it.run_until(lambda it: it.session.state.reference.speed_m_s > 2.0)
    it.vehicle.thing_cm, since_s = 600, it.session.now_s
    it.run_until(is_stopping, limit_s=1.0)
    assert it.session.now_s - since_s <= 0.2 + 1e-6
    assert it.fly_to(Phase.HOLDING, 10.0).session.state.reason is Reason.NEW_THREAT


def test_a_sensor_that_comes_to_see_less_in_flight_is_told_of_once(it: Pair) -> None:
    for reach_cm in (1000, 1600, 1000):
        it.vehicle.reach_cm = reach_cm
        it.run_for(0.5)
    said = "".join(each.text for each in it.sent("STATUSTEXT"))
    assert said.count("sensor sees 10 m of R = 16 m") == 1
