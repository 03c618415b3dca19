"""A glitch that the estimator gives in to, on each autopilot and kind of vehicle.

Both firmwares throw a receiver's position away that is 50 m off, and believe it after 7 to 10 s
(ardupilot.md 5; px4.md 8): all vouches for a wrong position then, until it jumps back.
"""

import math
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from companion.campaign import drawn_world, families
from companion.campaign.in_process import FlightFiles, Flying
from companion.mavlink.frames import number_of
from companion.mavlink.link import Output
from companion.mission.mission import AutopilotName
from companion.mission.state import Phase, Reason

BEGINS_S, GLITCH_S, WRONG_M = 75.0, 30.0, 12.0
GIVES_IN_S = 11.0
"""It has given in by then, and gives in to the end of the glitch as late again."""
CLEARS_S = 10.0
"""So long after that ArduPilot says `Glitch cleared`."""
SETPOINT = 86


class Seen(NamedTuple):
    """What the companion thought and did in a tenth of a second."""

    t_s: float
    phase: Phase
    believed_nea_m: tuple[float, float, float]
    setpoints: int


class Setpoints:
    """Counts them on their way to what records them."""

    def __init__(self, record: Callable[[Output], None]) -> None:
        self.record, self.sent = record, 0

    def count(self, out: Output) -> None:
        self.sent += sum(number_of(frame) == SETPOINT for _, frame in out.record)
        self.record(out)


def flown(
    autopilot: AutopilotName, kind: str, folder: Path
) -> tuple[list[Seen], list[dict[str, Any]], list[dict[str, Any]]]:
    """The flight until some seconds after the glitch: what was seen, the truth, the journal."""
    drawn = families.world(f"short-{kind}", 1, 2)
    world, mission = drawn_world.write(drawn, folder, autopilot)
    glitch = f"at {BEGINS_S:g} s for {GLITCH_S:g} s: gps_glitch 50 m north\n"
    files = FlightFiles(world=world, mission=mission, faults=glitch, folder=folder / "run")
    until_s = BEGINS_S + GLITCH_S + GIVES_IN_S + CLEARS_S + 5.0
    flying = Flying(files, seed=1, limit_s=until_s)
    counted = Setpoints(flying.loop.record)
    flying.loop.record = counted.count
    seen = []
    while flying.flies and flying.now_s < until_s:
        flying.fly_on(1e6 * (flying.now_s + 0.1))
        state, sent = flying.loop.session.state, counted.sent
        counted.sent = 0
        if state.vehicle.position_nea_m is not None:
            seen.append(Seen(flying.now_s, state.phase, state.vehicle.position_nea_m, sent))
    flying.close()
    flight = flying.flight()
    return seen, flight.truth, flight.journal


@pytest.mark.sample(4)
@pytest.mark.parametrize("kind", ["copter", "plane"])
@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_nothing_is_flown_by_a_position_that_the_estimator_has_given_in_to(
    autopilot: AutopilotName, kind: str, tmp_path: Path
) -> None:
    seen, truth, journal = flown(autopilot, kind, tmp_path)
    times_s = np.array([row["t_s"] for row in truth])
    track = np.array([(row["north_m"], row["east_m"]) for row in truth])
    wrong_s = []
    for each in seen:
        truly = track[min(np.searchsorted(times_s, each.t_s), len(track) - 1)]
        if each.t_s >= BEGINS_S and math.dist(each.believed_nea_m[:2], truly) > WRONG_M:
            wrong_s.append(each.t_s)
            assert each.phase is Phase.HOLDING
    assert wrong_s[0] < BEGINS_S + GIVES_IN_S  # the scene is the one that is meant
    assert wrong_s[-1] > BEGINS_S + GLITCH_S
    assert not [at_s for at_s in wrong_s if at_s > BEGINS_S + GLITCH_S + GIVES_IN_S]
    assert not [each for each in seen if wrong_s[0] < each.t_s <= wrong_s[-1] and each.setpoints]
    told = [entry["text"] for entry in journal if entry["kind"] == "say"]
    [why] = [text for text in told if Reason.POSITION_ELSEWHERE.text in text]
    off_m = float(why.split(" m off")[0].split()[-1])
    assert off_m == pytest.approx(50.0, abs=3.0)
    phases = [each.phase for each in seen if each.t_s > wrong_s[-1]]
    assert (Phase.HOLDING, Phase.FLYING) in pairwise(phases)  # it goes on
