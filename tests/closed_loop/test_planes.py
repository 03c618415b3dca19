"""Planes, flown by both programs in one process, in exact steps of vehicle time."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from flights import ENVIRONMENTS, NIGHTLY, warm_up
from pair import Pair

from companion.config import load_mission
from companion.mission.mission import EndAction
from companion.runtime.compiler import load_kernel
from vehicle_sim.world import read_world

pytestmark = pytest.mark.closed_loop
ARDUPLANE, PX4 = "sitl-arduplane", "sitl-px4-plane"


def pair(name: str, **changes: Any) -> Pair:
    """The bundled mission, changed so, and its world."""
    warm_up()
    world = read_world(ENVIRONMENTS / name / "world.toml")
    scene: Any = SimpleNamespace(
        mission=replace(load_mission(name), **changes), world=world, fence=()
    )
    return Pair(scene, seed=1, kernel=load_kernel())


@pytest.mark.parametrize(
    ("name", "away_s"),
    [
        pytest.param(ARDUPLANE, 21.0, marks=NIGHTLY),
        (ARDUPLANE, 60.0),
        pytest.param(PX4, 60.0, marks=NIGHTLY),
    ],
    ids=str,
)
def test_however_late_it_is_resumed_it_flies_on_along_its_leg(name: str, away_s: float) -> None:
    """ArduPlane has come to a circle by then, about the last point that it was sent to."""
    flight = pair(name)
    flight.at(62.0, lambda flight: flight.kill(away_s))
    flown = flight.fly(limit_s=235.0)
    kinds = [entry["kind"] for entry in flown.journal]
    after = flown.journal[kinds.index("resumed") :]
    asked = [k for k, entry in enumerate(after) if entry["kind"] == "plan asked"]
    reached = [k for k, entry in enumerate(after) if "target reached" in str(entry.get("text"))]
    assert not flown.reason, flown.reason
    assert reached
    if name == ARDUPLANE:  # PX4 has left guided mode, and is planned for again
        assert not asked or asked[0] > reached[0]


@pytest.mark.parametrize("name", [pytest.param(ARDUPLANE, marks=NIGHTLY), PX4])
def test_a_plane_passes_its_target_and_ends_where_it_said_before_its_take_off(name: str) -> None:
    """Told to land, ArduPlane circles the target; PX4's comes down on a circle about it."""
    target = (1_000.0, 250.0)
    flight = pair(name, targets_ne_m=(target,), end_action=EndAction.LAND)
    limits = flight.scene.mission.task.limits
    flown = flight.fly(limit_s=400.0)
    away_m = [math.dist((row["north_m"], row["east_m"]), target) for row in flown.truth]
    assert min(away_m) <= limits.tracking_error_m
    assert flown.outcome == "arrived"
    assert away_m[-1] <= 1.5 * limits.loiter_radius_m
    said = [str(entry["text"]) for entry in flown.journal if entry["kind"] == "say"]
    words = "lands on a circle: up to" if name == PX4 else "is not told to land: it circles"
    assert words in said[1]  # after the mission's name
    refused = [e for e in flown.journal if e["kind"] == "acknowledged" and e["command"] == 192]
    assert not refused  # DO_REPOSITION: one that is taken is not in the journal
