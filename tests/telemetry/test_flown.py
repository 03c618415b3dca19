from dataclasses import replace

import pytest

from companion.config import load_mission
from companion.mission.events import Position
from companion.mission.state import Vehicle
from companion.session import Session
from companion.telemetry.flown import Flown

MISSION = load_mission("environment-1")


def flown(north_m: float, east_m: float) -> Flown:
    session = Session(MISSION, seed=1, lockstep=True)
    event = Position(
        time_s=1.0, position_nea_m=(north_m, east_m, 4000.0), velocity_nea_m_s=(0.0, 0.0, 0.0)
    )
    vehicle = replace(Vehicle(), position_nea_m=event.position_nea_m)
    session.state = replace(session.state, vehicle=vehicle)
    return Flown(session=session)


def test_the_distance_to_go_is_horizontal_and_to_the_target_in_turn() -> None:
    assert flown(100_000.0 - 300.0, 100_000.0 - 400.0).to_go_m == pytest.approx(500.0)


def test_there_is_no_distance_without_a_position() -> None:
    assert Flown(session=Session(MISSION, seed=1, lockstep=True)).to_go_m is None


def test_the_factor_of_real_time_is_vehicle_time_over_wall_time_and_never_a_division_by_0() -> None:
    it = flown(0.0, 0.0)
    it.session._clock.now_s = 100.0
    assert it.times_real_time > 0.0
    it.elapsed_s = 4.0
    assert it.times_real_time == 25.0
