"""A glitch that the estimator gives in to, on each autopilot and kind of vehicle.

Both firmwares throw a receiver's position away that is 50 m off, and believe it after 7 to 10 s
(ardupilot.md 5; px4.md 8): all vouches for a wrong position then, until it jumps back.
"""

import math
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from tlog import frames_of

from companion.campaign import drawn_world, families
from companion.campaign.in_process import Flight, FlightFiles, Flying
from companion.mavlink.dialect import wire
from companion.mission.mission import AutopilotName
from companion.mission.state import Phase, Reason
from companion.telemetry.run_folder import resume_head

BEGINS_S, GLITCH_S, WRONG_M = 75.0, 30.0, 12.0
GIVES_IN_S = 11.0
"""It has given in by then, and gives in to the end of the glitch as late again."""
CLEARS_S = 10.0
"""So long after that ArduPilot says `Glitch cleared`."""


class Seen(NamedTuple):
    """What the companion thought at the end of a tenth of a second."""

    t_s: float
    phase: Phase
    believed_nea_m: tuple[float, float, float]


def flown(autopilot: AutopilotName, kind: str, folder: Path) -> tuple[list[Seen], Flight]:
    """The flight until some seconds after the glitch."""
    drawn = families.world(f"short-{kind}", 1, 2)
    world, mission = drawn_world.write(drawn, folder, autopilot)
    glitch = f"at {BEGINS_S:g} s for {GLITCH_S:g} s: gps_glitch 50 m north\n"
    files = FlightFiles(world=world, mission=mission, faults=glitch, folder=folder / "run")
    until_s = BEGINS_S + GLITCH_S + GIVES_IN_S + CLEARS_S + 5.0
    flying, seen = Flying(files, seed=1, limit_s=until_s), list[Seen]()
    while flying.flies and flying.now_s < until_s:
        flying.fly_on(1e6 * (flying.now_s + 0.1))
        state = flying.loop.session.state
        if state.vehicle.position_nea_m is not None:
            seen.append(Seen(flying.now_s, state.phase, state.vehicle.position_nea_m))
    flying.close()
    return seen, flying.flight()


def is_setpoint(message: Any) -> bool:
    """ArduPlane is led by commands to be somewhere, all others by positions and velocities."""
    if message.get_type() == "COMMAND_INT":
        return bool(message.command == wire.MAV_CMD_DO_REPOSITION)
    return message.get_type() == "SET_POSITION_TARGET_GLOBAL_INT"


def setpoints_s(folder: Path) -> list[float]:
    """The vehicle times at which any was sent."""
    epoch_us = resume_head(folder).epoch_us
    log = frames_of((folder / "flight.tlog").read_bytes())
    return [(at_us - epoch_us) * 1e-6 for at_us, message in log if is_setpoint(message)]


@pytest.mark.sample(4)
@pytest.mark.parametrize("kind", ["copter", "plane"])
@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_nothing_is_flown_by_a_position_that_the_estimator_has_given_in_to(
    autopilot: AutopilotName, kind: str, tmp_path: Path
) -> None:
    seen, flight = flown(autopilot, kind, tmp_path)
    times_s = np.array([row["t_s"] for row in flight.truth])
    track = np.array([(row["north_m"], row["east_m"]) for row in flight.truth])
    wrong_s = []
    for each in seen:
        truly = track[min(np.searchsorted(times_s, each.t_s), len(track) - 1)]
        if each.t_s >= BEGINS_S and math.dist(each.believed_nea_m[:2], truly) > WRONG_M:
            wrong_s.append(each.t_s)
            assert each.phase is Phase.HOLDING
    assert wrong_s[0] < BEGINS_S + GIVES_IN_S  # the scene is the one that is meant
    assert wrong_s[-1] > BEGINS_S + GLITCH_S
    assert not [at_s for at_s in wrong_s if at_s > BEGINS_S + GLITCH_S + GIVES_IN_S]
    sent_s = setpoints_s(flight.folder)
    assert min(sent_s) < wrong_s[0] < wrong_s[-1] < max(sent_s)
    assert not [at_s for at_s in sent_s if wrong_s[0] < at_s <= wrong_s[-1]]
    told = [entry["text"] for entry in flight.journal if entry["kind"] == "say"]
    [why] = [text for text in told if Reason.POSITION_ELSEWHERE.text in text]
    off_m = float(why.split(" m off")[0].split()[-1])
    assert off_m == pytest.approx(50.0, abs=3.0)
    phases = [each.phase for each in seen if each.t_s > wrong_s[-1]]
    assert (Phase.HOLDING, Phase.FLYING) in pairwise(phases)  # it goes on
