"""What the journal says of each leg of a flight, against scipy's splines and the true world."""

import functools
import itertools
import math
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import true_track
from flights import EACH_SCENE, flown_as, folder_of, journal_of
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.optimize import brentq

FloatArray = NDArray[np.float64]

pytestmark = pytest.mark.closed_loop

EXACT = 1e-6
LEGS = {"hills": 3, "upper-valley": 4}
"""How many there are at least, where they are not eight."""
_TO_THE_WIRE_M = 0.01


class Leg(NamedTuple):
    """A subpath as the journal has it."""

    asked: dict[str, Any]
    ready: dict[str, Any]

    @property
    def curve(self) -> BSpline:
        """Clamped and cubic, by u from 0 to 1, with evenly spaced inner knots."""
        control = np.array(self.ready["control_nea_m"])
        inner = np.linspace(0.0, 1.0, len(control) - 2)
        return BSpline(np.concatenate([[0.0] * 3, inner, [1.0] * 3]), control, 3)


class Frame(NamedTuple):
    """Where a curve is, which way it goes, and how it bends: the tangent by the length flown."""

    position_nea_m: FloatArray
    tangent_nea: FloatArray
    curvature_nea_1_m: FloatArray


def frame(curve: BSpline, u: float) -> Frame:
    first, second = curve(u, nu=1), curve(u, nu=2)
    speed = np.linalg.norm(first)
    tangent = first / speed
    return Frame(curve(u), tangent, (second - (second @ tangent) * tangent) / speed**2)


def foot(curve: BSpline, point_nea_m: FloatArray) -> float:
    """Where a curve is nearest to a point that lies on it, u."""

    def along(u: float) -> float:
        return float((curve(u) - point_nea_m) @ curve(u, nu=1))

    u = np.linspace(0.0, 1.0, 2001)
    nearest = int(np.argmin(np.linalg.norm(curve(u) - point_nea_m, axis=-1)))
    low, high = max(nearest - 1, 0), min(nearest + 1, len(u) - 1)
    return float(brentq(along, u[low], u[high], xtol=1e-15, rtol=1e-14))


@functools.cache
def legs_of(folder: Path) -> tuple[Leg, ...]:
    """All legs of a flight, in their order."""
    asked: dict[int, dict[str, Any]] = {}
    legs = []
    for entry in journal_of(folder):
        if entry.get("kind") == "plan asked":
            asked[entry["plan_id"]] = entry
        elif entry.get("kind") == "plan ready":
            legs.append(Leg(asked[entry["plan_id"]], entry))
    return tuple(legs)


@functools.cache
def mission_of(name: str) -> dict[str, Any]:
    return tomllib.loads((folder_of(name) / "mission.toml").read_text(encoding="utf-8"))


@EACH_SCENE
def test_no_leg_is_flown_without_a_proven_certificate(flown: Any, name: str) -> None:
    """And each is the work of the compiled kernel: so the same seed is the same flight."""
    flight = flown(*flown_as(name))
    legs = legs_of(flight.folder)
    assert len(legs) == flight.kinds.count("leg") >= LEGS.get(name, 8)
    mission = mission_of(name)
    vehicle, band = mission["vehicle"], mission["altitude"]
    required_m = mission["planner"]["safety_distance_m"] + vehicle["tracking_error_m"]
    for leg in legs:
        certificate = leg.ready["certificate"]
        assert certificate["broken"] == []
        assert leg.ready["kernel"].startswith("numba ")
        assert certificate["clearance_m"] >= required_m
        turn_radius_m = certificate["turn_radius_m"]
        assert turn_radius_m is None or turn_radius_m >= (1.0 - EXACT) * vehicle["turn_radius_m"]
        assert math.degrees(certificate["climb_angle_rad"]) <= vehicle["climb_angle_deg"]
        assert math.degrees(certificate["dive_angle_rad"]) <= vehicle["dive_angle_deg"]
        assert certificate["lowest_amsl_m"] >= band["floor_amsl_m"]
        assert certificate["highest_amsl_m"] <= band["ceiling_amsl_m"]
        assert certificate["off_map_m"] <= EXACT


@EACH_SCENE
def test_position_tangent_and_curvature_go_on_from_leg_to_leg(flown: Any, name: str) -> None:
    legs = legs_of(flown(*flown_as(name)).folder)
    turn_radius_m = mission_of(name)["vehicle"]["turn_radius_m"]
    joins = [pair for pair in itertools.pairwise(legs) if not pair[1].asked["from_rest"]]
    assert len(joins) >= LEGS.get(name, 8) - 1
    bends = []
    for before, after in joins:
        ours = frame(after.curve, 0.0)
        theirs = frame(before.curve, foot(before.curve, ours.position_nea_m))
        np.testing.assert_allclose(ours.position_nea_m, theirs.position_nea_m, rtol=0, atol=EXACT)
        np.testing.assert_allclose(ours.tangent_nea, theirs.tangent_nea, rtol=0, atol=EXACT)
        jump = np.linalg.norm(ours.curvature_nea_1_m - theirs.curvature_nea_1_m)
        assert jump <= EXACT / turn_radius_m
        bends.append(np.linalg.norm(theirs.curvature_nea_1_m))
    assert max(bends) > 1e-3 / turn_radius_m  # not all of them on straight lines


@EACH_SCENE
def test_no_certificate_promises_more_than_the_true_world_keeps(flown: Any, name: str) -> None:
    world = tomllib.loads((folder_of(name) / "world.toml").read_text(encoding="utf-8"))
    surface = true_track.surface_of(world, folder_of(name))
    mission = mission_of(name)
    for leg in legs_of(flown(*flown_as(name)).folder):
        curve, certificate = leg.curve, leg.ready["certificate"]
        u = np.linspace(0.0, 1.0, 2001)
        points, first, second = curve(u), curve(u, nu=1), curve(u, nu=2)
        clearance_m = true_track.clearances_m(points[::5], surface).min()
        assert certificate["clearance_m"] <= clearance_m + _TO_THE_WIRE_M
        for zone in mission.get("keep_outs", []):
            away_m = true_track.keep_out_distances_m(points, zone).min()
            assert certificate["keep_out_m"] <= away_m + EXACT
        ground = np.hypot(first[:, 0], first[:, 1])
        bend = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / ground**3
        proven_1_m = 1.0 / (certificate["turn_radius_m"] or math.inf)
        assert bend.max() <= proven_1_m + EXACT / mission["vehicle"]["turn_radius_m"]
        slope = np.arctan2(first[:, 2], ground)
        assert -certificate["dive_angle_rad"] - EXACT <= slope.min()
        assert slope.max() <= certificate["climb_angle_rad"] + EXACT
        assert certificate["lowest_amsl_m"] <= points[:, 2].min() + EXACT
        assert certificate["highest_amsl_m"] >= points[:, 2].max() - EXACT
        inside = np.zeros(len(u), dtype=bool)
        for radar in world.get("radars", []):
            centre = [radar["north_m"], radar["east_m"], radar["altitude_amsl_m"]]
            inside |= np.linalg.norm(points - centre, axis=-1) < radar["range_m"]
        steps_m = np.linalg.norm(np.diff(points, axis=0), axis=-1)
        assert certificate["radar_m"] >= steps_m[inside[1:] & inside[:-1]].sum() - EXACT
