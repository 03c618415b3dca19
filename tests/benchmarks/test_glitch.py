"""A glitch that the estimator gives in to, on each autopilot and kind of vehicle.

Both firmwares throw a receiver's position away that is 50 m off, and believe it after 7 to 10 s
(ardupilot.md 5; px4.md 8): all vouches for a wrong position then, until it jumps back.
"""

import math
from itertools import pairwise

import numpy as np
import pair_worlds
import pytest
from pair import Flown, Pair

from companion.mission.state import Phase, Reason
from companion.planner.kernels import NUMPY

GLITCH_S, WRONG_M = 30.0, 12.0
GIVES_IN_S = 11.0
"""It has given in by then, and gives in to the end of the glitch as late again."""
CLEARS_S = 10.0
"""So long after that ArduPilot says `Glitch cleared`."""


def flown(autopilot: pair_worlds.Firmware, kind: pair_worlds.Kind) -> tuple[Flown, float]:
    """The flight until some seconds after the glitch, and when that began."""
    pair = Pair(pair_worlds.scene(autopilot, kind, 2), seed=1, kernel=NUMPY)
    began_s: list[float] = []

    def glitch(pair: Pair) -> None:
        began_s.append(pair.now_s)
        pair.simulation.add_fault(f"for {GLITCH_S:g} s: gps_glitch 50 m north")

    def enough(pair: Pair) -> None:
        assert pair.brain is not None
        pair.brain.over = True

    pair.at(5.0, glitch)
    pair.at(5.0 + GLITCH_S + GIVES_IN_S + CLEARS_S + 5.0, enough)
    return pair.fly(), began_s[0]


@pytest.mark.sample(4)
@pytest.mark.parametrize("kind", ["copter", "plane"])
@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_nothing_is_flown_by_a_position_that_the_estimator_has_given_in_to(
    autopilot: pair_worlds.Firmware, kind: pair_worlds.Kind
) -> None:
    flight, began_s = flown(autopilot, kind)
    assert not flight.died
    times_s, track = flight.track()
    wrong_s = []
    for sample in flight.samples:
        if sample.believed_nea_m is None or sample.t_s < began_s:
            continue
        truly = track[min(np.searchsorted(times_s, sample.t_s), len(track) - 1)]
        if math.dist(sample.believed_nea_m[:2], truly[:2]) > WRONG_M:
            wrong_s.append(sample.t_s)
            assert sample.phase == Phase.HOLDING.value
    assert wrong_s[0] < began_s + GIVES_IN_S  # the scene is the one that is meant
    assert wrong_s[-1] > began_s + GLITCH_S
    assert not [at_s for at_s in wrong_s if at_s > began_s + GLITCH_S + GIVES_IN_S]
    assert not [each for each in flight.sent if wrong_s[0] <= each.t_s <= wrong_s[-1]]
    told = [entry["text"] for entry in flight.journal if entry["kind"] == "say"]
    [why] = [text for text in told if Reason.POSITION_ELSEWHERE.text in text]
    off_m = float(why.split()[-3])
    assert off_m == pytest.approx(50.0, abs=3.0)
    phases = [sample.phase for sample in flight.samples if sample.t_s > wrong_s[-1]]
    assert (Phase.HOLDING.value, Phase.FLYING.value) in pairwise(phases)  # it goes on
