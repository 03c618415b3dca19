import pytest
from renewed import replace

from companion.config import load_mission
from companion.mavlink.link import VehicleClock
from companion.mission.events import Position
from companion.mission.state import Reason, Vehicle
from companion.session import Session
from companion.telemetry.flight_summary import FlightSummary

MISSION = load_mission("environment-1")


def flown(north_m: float, east_m: float) -> FlightSummary:
    session = Session(MISSION, seed=1, lockstep=True)
    event = Position(
        time_s=1.0, position_nea_m=(north_m, east_m, 4000.0), velocity_nea_m_s=(0.0, 0.0, 0.0)
    )
    vehicle = replace(Vehicle(), position_nea_m=event.position_nea_m)
    session.state = replace(session.state, vehicle=vehicle)
    return FlightSummary(session=session)


def test_the_distance_to_go_is_horizontal_and_to_the_target_in_turn() -> None:
    assert flown(100_000.0 - 300.0, 100_000.0 - 400.0).to_go_m == pytest.approx(500.0)


def test_there_is_no_distance_without_a_position() -> None:
    assert FlightSummary(session=Session(MISSION, seed=1, lockstep=True)).to_go_m is None


@pytest.mark.parametrize("start_s", [0.0, 290.0])
def test_the_factor_of_real_time_counts_what_passed_while_the_vehicle_was_heard(
    start_s: float,
) -> None:
    """Neither what its clock had shown before, nor what a flight had taken that was resumed."""
    it = flown(0.0, 0.0)
    clock = it.session.clock = VehicleClock(start_s)
    assert it.times_real_time == 0.0
    for time_s in (312.0, 312.0, 313.0, 314.0):
        clock.read(time_s)
    it.elapsed_s = 0.08
    assert it.times_real_time == 25.0


def test_a_reboot_takes_nothing_from_what_has_passed() -> None:
    clock = VehicleClock(0.0)
    for time_s in (300.0, 302.0, 1.0, 1.5, 3.0):
        clock.read(time_s)
    assert clock.passed_s == 3.5


LEFT_OVER = (Reason.NO_VEHICLE, Reason.NOT_READY, Reason.LINK_LOST, Reason.PLANNER_DIED)


@pytest.mark.parametrize("reason", Reason)
@pytest.mark.parametrize("airborne", [False, True])
def test_only_a_flight_that_nobody_has_decided_to_end_in_the_air_may_go_on(
    reason: Reason, airborne: bool
) -> None:
    it = flown(0.0, 0.0)
    it.session.state = replace(it.session.state, reason=reason, airborne=airborne)
    assert it.may_go_on is (airborne and reason in LEFT_OVER)
    it.died = True
    assert it.may_go_on is airborne


def test_what_was_only_watched_does_not_go_on() -> None:
    it = FlightSummary(session=Session(MISSION, seed=1, lockstep=False, shadow=True), died=True)
    it.session.state = replace(it.session.state, airborne=True)
    assert not it.may_go_on


def test_a_plane_is_told_what_it_passed_its_last_target_at_not_where_it_circles() -> None:
    """The nearest of all positions on the way to that target, and of no other."""
    it = flown(0.0, 0.0)
    state = replace(it.session.state, targets_ne_m=((0.0, 0.0), (1_000.0, 0.0)))
    for target, north_m, east_m in [(0, 3.0, 0.0), (1, 990.2, 30.0), (1, 1_000.0, 9.8)]:
        here = replace(state.vehicle, position_nea_m=(north_m, east_m, 4_000.0))
        flight = replace(state.flight, target=target)
        it.session.state = replace(state, vehicle=here, flight=flight)
        it.note_passing()
    assert it.passed_m == pytest.approx(9.8)
    here = replace(state.vehicle, position_nea_m=(1_000.0, 32.6, 4_000.0))
    it.session.state = replace(it.session.state, vehicle=here)
    it.note_passing()
    assert it.passed_m == pytest.approx(9.8)
