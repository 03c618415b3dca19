"""Planes, flown by both programs in one process, in exact steps of vehicle time."""

import math
from pathlib import Path

import pytest
from flights import ENVIRONMENTS, NIGHTLY, flown_here

from companion.config import load_mission

pytestmark = pytest.mark.closed_loop
ARDUPLANE, PX4 = "sitl-arduplane", "sitl-px4-plane"


@pytest.mark.parametrize(
    ("name", "away_s"),
    [
        pytest.param(ARDUPLANE, 21.0, marks=NIGHTLY),
        (ARDUPLANE, 60.0),
        pytest.param(PX4, 60.0, marks=NIGHTLY),
    ],
    ids=str,
)
def test_however_late_it_is_resumed_it_flies_on_along_its_leg(
    name: str, away_s: float, tmp_path: Path
) -> None:
    """ArduPlane has come to a circle by then, about the last point that it was sent to."""
    files, killed = ENVIRONMENTS / name, f"at 65 s for {away_s} s: companion_off"
    flight = flown_here(
        *(tmp_path / "run", files / "world.toml", files / "mission.toml"),
        faults=killed,
        limit_s=235.0,
    )
    after = [entry for entry in flight.journal if "kind" in entry][flight.kinds.index("resumed") :]
    asked = [k for k, entry in enumerate(after) if entry["kind"] == "plan asked"]
    reached = [k for k, entry in enumerate(after) if "target reached" in str(entry.get("text"))]
    assert flight.outcome == "stopped", flight.end  # by us
    assert reached
    if name == ARDUPLANE:  # PX4 has left guided mode, and is planned for again
        assert not asked or asked[0] > reached[0]


@pytest.mark.parametrize("name", [pytest.param(ARDUPLANE, marks=NIGHTLY), PX4])
def test_a_plane_passes_its_target_and_ends_where_it_said_before_its_take_off(
    name: str, tmp_path: Path
) -> None:
    """Told to land, ArduPlane circles the target; PX4's comes down on a circle about it."""
    target = (1_000.0, 250.0)
    text = (ENVIRONMENTS / name / "mission.toml").read_text(encoding="utf-8")
    text = text.replace('autopilot = "ardupilot"\n', "")  # a file that names it is refused
    head, *_, last = text.replace('action = "hold"', 'action = "land"').split("[[targets]]")
    place = "[[targets]]\nnorth_m = {}\neast_m = {}\n\n".format(*target)
    mission = tmp_path / "mission.toml"
    mission.write_text(f"{head}{place}{last[last.index('[') :]}", encoding="utf-8")
    limits = load_mission(str(mission)).task.limits
    flight = flown_here(tmp_path / "run", ENVIRONMENTS / name / "world.toml", mission)
    away_m = [math.dist((row["north_m"], row["east_m"]), target) for row in flight.truth]
    assert min(away_m) <= limits.tracking_error_m
    assert flight.outcome == "arrived"
    assert away_m[-1] <= 1.5 * limits.loiter_radius_m
    words = "lands on a circle: up to" if name == PX4 else "is not told to land: it circles"
    assert words in flight.says[1]  # after the mission's name
    refused = [e for e in flight.journal if e.get("kind") == "acknowledged" and e["command"] == 192]
    assert not refused  # DO_REPOSITION: one that is taken is not in the journal
