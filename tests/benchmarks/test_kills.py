"""The companion dies in flight: the law of design 6, by a sample (more: `scripts/bench kills`)."""

import math

import kills
import numpy as np
import pytest

from companion.config import load_mission
from companion.path.envelope import beyond_m
from companion.path.subpath import Subpath
from companion.planner.procedure import Leg


@pytest.mark.parametrize("aside_m", [0.0, 0.3, 2.0])
def test_what_a_straight_leg_promises_is_a_tube_that_ends_so_far_beyond_it(aside_m: float) -> None:
    task = load_mission("forest").task
    subpath = Subpath(control_nea_m=np.outer([0.0, 0.3, 0.6, 1.0], [12.0, 0.0, 0.0]))
    leg = Leg(number=1, plan_id=1, subpath=subpath, reaches_target=False, rules=task)
    told = kills.proven(leg, from_rest=False)
    tube_m = task.envelope.contact_m
    places = np.array([[6.0, aside_m, 0.0], [15.0, 0.0, aside_m], [-1.0, 0.0, 0.0]])
    end_m = 12.0 + beyond_m(task.envelope)
    expected = aside_m - tube_m, math.hypot(15.0 - end_m, aside_m) - tube_m, 1.0 - tube_m
    assert told.outside_m(places) == pytest.approx(expected, abs=0.02)


KILLS, EVERY_S = 4, 6.14
PLANES = ("short-plane ardupilot", "short-plane px4")


@pytest.mark.parametrize("flight", ["forest ardupilot", "street px4", "ridge ardupilot", *PLANES])
def test_a_vehicle_whose_companion_dies_stays_within_what_was_proven(flight: str) -> None:
    """Over the first 25 s of a flight: take-off, the first legs, and from one to the next."""
    found = kills.sample(*flight.split(), first=2, count=KILLS, every_s=EVERY_S)
    assert len({kill["at_s"] for kill in found}) == KILLS
    assert max(kill["outside_m"] for kill in found) <= 0.0
    assert all(kill["stands"] for kill in found)
    assert max(kill["speed_m_s"] for kill in found) > 1.0
