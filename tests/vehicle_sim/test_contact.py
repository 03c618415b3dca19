"""Who has landed and who has crashed: one law for all vehicles and autopilots."""

import math
from typing import Any

import pytest
from harness import COPTER_HOME, KINDS, Rig, item, placed, setpoint

from vehicle_sim.dynamics.contact import Contact, Crash, is_crash
from vehicle_sim.dynamics.plane import Plane
from vehicle_sim.geodesy import LocalFrame
from vehicle_sim.plans import PlanKind
from vehicle_sim.scene import Scene
from vehicle_sim.terrain import PeakTerrain

GROUND_M = 500.0
PEAK = {"north_m": 900.0, "east_m": 0.0, "height_amsl_m": GROUND_M + 700.0}
PEAK |= {"spread_north_m": 150.0, "spread_east_m": 1e5}
"""Above the plain as a wall of 45 degrees and more from 749 m to the north on."""
SLOWLY = {
    ("plane", "ardupilot"): {"AIRSPEED_CRUISE": 12.0, "AIRSPEED_MIN": 10.0, "SIM_WIND_SPD": 3.0},
    ("plane", "px4"): {"FW_AIRSPD_TRIM": 11.0, "SIM_WIND_SPD": 2.0},
}
"""9 m/s over the ground in a wind from the north."""


def under_way(height_m: float, north_m_s: float, *kind: Any, **told: Any) -> Rig:
    """Northwards over the plain; a plane flies so by itself."""
    flown = Rig(*kind, COPTER_HOME, **told).climb(height_m)
    if flown.kind == "copter":
        flown.streamed = setpoint(None, (north_m_s, 0.0, 0.0))
    return flown


@pytest.mark.parametrize(
    ("velocity", "slope", "rolls", "lands", "crashes"),
    [
        ((0.0, 0.0, -2.9), 0.0, False, True, False),
        ((0.0, 0.0, -3.1), 0.0, False, True, True),
        ((2.0, -2.0, -1.5), 0.0, False, True, True),  # sideways counts
        ((9.0, 0.0, 3.0), 1.0, False, True, True),
        ((20.0, 0.0, -1.0), 0.0, True, True, False),  # a runway
        ((20.0, 0.0, -3.1), 0.0, True, True, True),
        ((20.0, 0.0, -1.0), 0.05, True, True, False),
        ((20.0, 0.0, 0.0), 0.2, True, True, True),
        ((20.0, 0.0, 4.0), 0.2, True, True, True),  # along a hillside is no runway
        ((0.0, 9.0, 0.0), 0.12j, True, True, True),
        ((9.0, 0.0, 0.0), 0.12, True, False, False),  # it rolls up a ramp
        ((9.0, 0.0, 0.0), 1.0, True, False, True),  # and into a wall
        ((9.0, 0.0, -9.0), -1.0, True, False, False),  # along the slope that it is on
    ],
)
def test_a_contact_is_judged_by_the_speed_in_all_axes(
    velocity: tuple[float, float, float], slope: complex, rolls: bool, lands: bool, crashes: bool
) -> None:
    assert is_crash(velocity, slope, rolls=rolls, lands=lands) is crashes


class Step(PeakTerrain):  # type: ignore[misc]
    """Level ground with a step up of 5 m at 10 m north."""

    def height_at_amsl_m(self, north_m: float, east_m: float) -> float:
        return 5.0 if north_m > 10.0 else 0.0 * east_m


@pytest.mark.parametrize(("from_m", "crashes"), [(9.0, True), (12.0, False)])
def test_a_step_up_is_hit_though_it_is_level_before_and_behind_it(
    from_m: float, crashes: bool
) -> None:
    frame, hits = LocalFrame(latitude_deg=47.0, longitude_deg=8.0), list[Crash]()
    terrain = Step([], combine="maximum", ground_amsl_m=0.0)
    height_m = terrain.height_at_amsl_m(from_m, 0.0)
    plane = Plane(**placed((*frame.to_geographic(from_m, 0.0), height_m)))
    contact = Contact(plane, Scene(terrain, ()), frame, rolls=True, on_crash=hits.append)
    plane.velocity_m_s = 9.0 + 0j
    plane.latitude_deg, _ = frame.to_geographic(from_m + 2.0, 0.0)
    contact.prepare(200_000)
    contact.look(200_000)
    contact.settle(200_000, 0.2)
    assert [hit.into for hit in hits] == ["the ground"] * crashes


@pytest.mark.parametrize(("autopilot", "kind"), KINDS)
def test_nobody_stands_on_a_slope_that_it_hits_at_9_m_s(kind: str, autopilot: str) -> None:
    slowly = SLOWLY.get((kind, autopilot), {}) | {"SIM_WIND_DIR": 0.0}
    north_m = 690.0 if kind == "copter" else 0.0
    flown = under_way(15.0, 9.0, autopilot, kind, peaks=[PEAK], north_m=north_m, **slowly)
    simulation = flown.simulation
    assert simulation.crash is None
    flown.until(lambda: simulation.crash is not None, 150.0)
    crash: Any = simulation.crash
    assert (crash.into, 7.5 < crash.speed_m_s < 12.0) == ("the ground", True)
    away_m = (crash.north_m - PEAK["north_m"]) / PEAK["spread_north_m"]
    assert crash.altitude_amsl_m == pytest.approx(1200.0 * math.exp(-(away_m**2)), abs=1.5)
    last = flown.run(3.0).truth()[-1]
    assert (last["landed"], last["armed"]) == (True, False)
    assert last["crash"]["speed_m_s"] == pytest.approx(crash.speed_m_s, abs=1e-3)
    assert last["north_m"] == pytest.approx(crash.north_m, abs=0.1)  # it stays where it fell
    assert any("hits the ground at" in notice for notice in simulation.take_notices())
    assert "it hit the ground at" in simulation.outcome()


HOUSE = {"corners_ne_m": [[500, -99], [500, 99], [600, 99], [600, -99]], "height_m": 150.0}
TREE = {"north_m": 12.0, "east_m": 0.0, "radius_m": 0.05, "height_m": 50.0}
WALL = {"points_ne_m": [[12.0, -9.0], [12.0, 9.0]], "thickness_m": 0.1, "height_m": 50.0}


@pytest.mark.parametrize(
    ("kind", "autopilot", "things", "at_north_m"),
    [
        ("plane", "px4", {"buildings": [HOUSE]}, 500.0),
        ("copter", "ardupilot", {"trees": [TREE]}, 12.0),
        ("copter", "px4", {"walls": [WALL]}, 12.0),
    ],
)
def test_who_hits_a_thing_however_thin_falls_and_does_not_fly_through(
    kind: str, autopilot: str, things: Any, at_north_m: float
) -> None:
    flown = under_way(15.0 if kind == "plane" else 5.0, 4.0, autopilot, kind, **things)
    simulation = flown.simulation
    flown.until(lambda: simulation.crash is not None, 100.0)
    crash: Any = simulation.crash
    assert crash.into == "a tree, wall, building or wire"
    assert crash.north_m == pytest.approx(at_north_m, abs=0.3)
    flown.until(lambda: simulation.landed, 10.0)
    assert simulation.crash is crash  # the first counts
    assert not simulation.armed
    truth = flown.truth()
    assert truth[-1]["north_m"] == pytest.approx(at_north_m, abs=0.3)
    assert min(row["near_m"] for row in truth) == simulation.contact.nearest_m == 0.0


def test_a_plane_that_rolls_out_on_its_runway_has_not_crashed() -> None:
    flown = Rig("ardupilot", "plane").armable()
    legs = ((16,), (22, 0.0, 0.0, 20.0), (16, 250.0, 0.0, 20.0), (21, 500.0))
    flown.plan(PlanKind.MISSION, *(item(flown.home, *leg) for leg in legs))
    assert [flown.set_mode("AUTO"), flown.arm()] == [0, 0]
    flown.until(lambda: flown.height_m > 10.0, 40.0)
    flown.until(lambda: flown.height_m <= 0.0, 90.0)
    assert flown.vehicle.velocity_m_s.real > 5.0
    flown.until(lambda: not flown.armed, 40.0)
    assert flown.simulation.crash is None


def test_who_passes_a_tree_has_the_least_distance_in_the_truth() -> None:
    tree = TREE | {"east_m": 3.0, "radius_m": 0.5}
    flown = under_way(5.0, 4.0, "ardupilot", "copter", trees=[tree]).run(9.0)
    truth = flown.truth()
    east_m = [row["east_m"] for row in truth if abs(row["north_m"] - 12.0) < 0.5]
    least_m = min(row["near_m"] for row in truth)
    assert least_m == pytest.approx(3.0 - 0.5 - sum(east_m) / len(east_m), abs=0.02)
    assert least_m == pytest.approx(flown.simulation.contact.nearest_m, abs=1e-3)
