"""A companion that goes while its vehicle takes off: nothing climbs on alone.

Both programs in one process: the companion is told to stop, or a part of it dies; then the vehicle
flies on by itself for half a minute, and its truth is looked at.
"""

from collections.abc import Callable

import pytest
from flights import ENVIRONMENTS, NIGHTLY

from companion.config import load_mission
from companion.mission.events import Outcome
from companion.mission.state import Phase, State
from companion.planner.request import PlanOutcome
from companion.runtime.in_process import fly_in_process, loop_in_process
from companion.session import Session
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import read_world

pytestmark = pytest.mark.closed_loop
PX4, *OTHERS = PLACES = ["sitl-px4", "sitl-arducopter", "sitl-arduplane", "sitl-px4-plane"]
HOLDS = {"BRAKE", "LOITER", "AUTO.LOITER", "HOLD"}
ALONE_S, STOPS_WITHIN_M = 20.0, 12.0


def arming(state: State) -> bool:
    """It was asked to arm, and has not said yet that it is."""
    return state.phase is Phase.ARMING and state.armed_by_us


def on_the_ground(state: State) -> bool:
    """Armed, in its take-off, and not in the air yet."""
    return state.phase is Phase.TAKING_OFF


def in_the_climb(state: State) -> bool:
    """Ten metres up."""
    here, home = state.vehicle.position_nea_m, state.vehicle.home_nea_m
    climbs = state.phase is Phase.TAKING_OFF and here is not None and home is not None
    return climbs and here[2] > home[2] + 10.0


@pytest.mark.parametrize("when", [arming, on_the_ground, in_the_climb])
@pytest.mark.parametrize("name", PLACES)
def test_stopped_in_its_take_off_it_is_left_holding_or_disarmed(
    name: str, when: Callable[[State], bool]
) -> None:
    session, vehicle = both(name)
    flown = fly_in_process(
        session, vehicle, planner=no_planner, stop_asked=lambda: when(session.state)
    )
    assert flown.end is not None
    assert flown.end.outcome is Outcome.STOPPED
    is_left_well(vehicle)


@pytest.mark.parametrize("name", [PX4, *(pytest.param(each, marks=NIGHTLY) for each in OTHERS)])
@pytest.mark.parametrize("when", [on_the_ground, pytest.param(in_the_climb, marks=NIGHTLY)])
def test_so_it_is_when_a_part_dies(name: str, when: Callable[[State], bool]) -> None:
    """The watchdog's last frames are all that it is told."""
    session, vehicle = both(name)
    loop = loop_in_process(session, vehicle, planner=no_planner)
    for _ in loop.turns():
        if when(session.state):
            break
    vehicle.receive(0, b"".join(session.hold_frames()))
    is_left_well(vehicle)


def both(name: str) -> tuple[Session, Simulation]:
    """A companion, and its vehicle."""
    session = Session(load_mission(name), seed=1, lockstep=True)
    return session, Simulation(read_world(ENVIRONMENTS / name / "world.toml"), seed=1)


def is_left_well(vehicle: Simulation) -> None:
    """It goes on alone: no higher than it needs to stop, and held; or down, and disarmed."""
    began_us, before_m = vehicle.now_us, vehicle.vehicle.altitude_amsl_m
    while vehicle.now_us < began_us + ALONE_S * 1e6:
        vehicle.step()
    assert vehicle.vehicle.altitude_amsl_m < before_m + STOPS_WITHIN_M
    assert vehicle.mode_name.upper() in HOLDS
    assert vehicle.landed != vehicle.armed


def no_planner(*_: object) -> PlanOutcome:
    """It has not come so far."""
    raise AssertionError
