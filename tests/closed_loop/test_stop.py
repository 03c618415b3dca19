"""A companion that goes while its vehicle takes off: nothing climbs on alone.

Both programs in one process: the companion is told to stop, or a part of it dies and the watchdog's
last frames are all that the vehicle is told; then it flies on by itself for a while.
"""

from collections.abc import Callable

import pytest
from flights import ENVIRONMENTS, NIGHTLY

from companion.config import load_mission
from companion.mission.state import Phase, State
from companion.runtime.in_process import loop_in_process
from companion.runtime.watchdog import _HOLD_AGAIN_S
from companion.session import Session
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import read_world

pytestmark = pytest.mark.closed_loop
OTHERS = ("sitl-arducopter", "sitl-arduplane", "sitl-px4-plane")
HOLDS = {"BRAKE", "LOITER", "AUTO.LOITER", "HOLD"}
ALONE_S, STOPS_WITHIN_M = 20.0, 12.0


WHEN: dict[str, Callable[[State], bool]] = {
    "arming": lambda state: state.phase is Phase.ARMING and state.armed_by_us,
    "on the ground": lambda state: state.phase is Phase.TAKING_OFF,
    "in the climb": lambda state: (  # ten metres up
        state.phase is Phase.TAKING_OFF
        and state.vehicle.position_nea_m[2] > state.vehicle.home_nea_m[2] + 10.0
    ),
}


def flies_on(vehicle: Simulation, seconds: float) -> None:
    until_us = vehicle.now_us + seconds * 1e6
    while vehicle.now_us < until_us:
        vehicle.step()


@pytest.mark.parametrize("name", ["sitl-px4", *(pytest.param(o, marks=NIGHTLY) for o in OTHERS)])
@pytest.mark.parametrize("when", WHEN)
@pytest.mark.parametrize("dies", [False, True], ids=["stopped", "a part dies"])
def test_gone_in_its_take_off_it_leaves_the_vehicle_holding_or_disarmed(
    name: str, when: str, dies: bool
) -> None:
    """No higher than it needs to stop, and held; or down, and disarmed."""
    session = Session(load_mission(name), seed=1, lockstep=True)
    vehicle = Simulation(read_world(ENVIRONMENTS / name / "world.toml"), seed=1)
    loop = loop_in_process(
        session, vehicle, planner=None, stop_asked=lambda: not dies and WHEN[when](session.state)
    )  # it does not come so far as to plan
    for _ in loop.turns():
        if dies and WHEN[when](session.state):
            break
    before_m, hold = vehicle.vehicle.altitude_amsl_m, b"".join(session.hold_frames())
    for wait_s in _HOLD_AGAIN_S if dies else ():
        flies_on(vehicle, wait_s)
        vehicle.receive(0, hold)
    flies_on(vehicle, ALONE_S)
    assert vehicle.vehicle.altitude_amsl_m < before_m + STOPS_WITHIN_M
    assert vehicle.mode_name.upper() in HOLDS
    assert vehicle.landed != vehicle.armed
