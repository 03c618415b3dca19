"""Fences as zones: what a zone lets through, the simulated autopilots' own fences let through."""

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from held import HOME_DEG, HOME_M
from hypothesis import given
from hypothesis import strategies as st

from companion.config import load_mission
from companion.geodesy import LocalFrame, deg_e7
from companion.mavlink.autopilots import ARDUCOPTER, PX4_MULTICOPTER
from companion.mavlink.fence import Fence, conflicts, drawn, in_force
from companion.mavlink.mission_items import targets_of
from companion.mavlink.plan_client import PlanItem
from companion.mission.mission import EndAction
from vehicle_sim.autopilot.earth import FlatEarth, Projection
from vehicle_sim.autopilot.guards import Fence as ArduPilotFence
from vehicle_sim.autopilot.guards import Zones
from vehicle_sim.autopilot.values import Place
from vehicle_sim.plans import PlanKind, Plans

FRAME = LocalFrame(latitude_deg=HOME_DEG[0], longitude_deg=HOME_DEG[1])
TASK = load_mission("valley").task
ON = {"FENCE_ENABLE": 1.0, "FENCE_TYPE": 4.0, "FENCE_MARGIN": 0.0, "FENCE_OPTIONS": 1.0}
IN, OUT, CIRCLE_IN, CIRCLE_OUT = range(5001, 5005)
SQUARE = ((-100.0, -100.0), (-100.0, 100.0), (100.0, 100.0), (100.0, -100.0))
BOW = ((-100.0, -100.0), (100.0, 100.0), (100.0, -100.0), (-100.0, 100.0))
places = st.tuples(st.floats(-900.0, 900.0), st.floats(-900.0, 900.0))


def zones_of(
    items: Sequence[PlanItem], parameters: dict[str, float], frame: LocalFrame = FRAME, **where: Any
) -> Fence:
    """A fence drawn to its end, and what parameters make of it: ArduPilot's, or PX4's."""
    is_px4 = not any(name.startswith("FENCE_") for name in parameters)
    settings = (PX4_MULTICOPTER if is_px4 else ARDUCOPTER).firmware.fence(parameters)
    *_, whole = drawn(items, frame, settings.margin_m)
    return in_force(whole, settings, **where)


def in_degrees(place_deg: Any, parameter: float, command: int = OUT) -> PlanItem:
    x, y = deg_e7(place_deg[0]), deg_e7((place_deg[1] + 180.0) % 360.0 - 180.0)
    return PlanItem(frame=0, command=command, parameters=(parameter, 0.0, 0.0, 0.0), x=x, y=y)


def item(command: int, north_m: float, east_m: float, parameter: float, **changes: Any) -> PlanItem:
    made = in_degrees(FRAME.to_geodetic_deg(north_m, east_m), parameter, command)
    return made._replace(**changes)


def ring(command: int, *corners: tuple[float, float]) -> list[PlanItem]:
    return [item(command, *corner, float(len(corners))) for corner in corners]


@st.composite
def shapes(draw: st.DrawFn) -> list[PlanItem]:
    """One circle or polygon; the polygon may cross itself, or be a star with deep inlets."""
    command = draw(st.sampled_from([CIRCLE_IN, CIRCLE_OUT, IN, OUT]))
    if command in (CIRCLE_IN, CIRCLE_OUT):
        return [item(command, *draw(places), draw(st.floats(30.0, 900.0)))]
    if draw(st.booleans()):
        reach_m = draw(st.lists(st.floats(5.0, 900.0), min_size=3, max_size=10))
        turn = draw(st.sampled_from([1.0, -1.0])) * math.tau / len(reach_m)
        star = [(r * math.cos(turn * k), r * math.sin(turn * k)) for k, r in enumerate(reach_m)]
        return ring(command, *star)
    return ring(command, *draw(st.lists(places, min_size=3, max_size=7, unique=True)))


def allows(items: Any, at_ne_m: Any, parameters: dict[str, float] | None) -> bool:
    """Whether the autopilot itself does: ArduPilot with these parameters, or PX4."""
    plans, home = Plans(), Place(*HOME_DEG, HOME_M)
    plans[PlanKind.FENCE] = tuple(items)  # theirs have the same fields
    place = Place(*FRAME.to_geodetic_deg(*at_ne_m), HOME_M)
    if parameters is None:
        return not Zones(plans).forbid(Projection(home), place, union=True)
    fence = ArduPilotFence({"FENCE_RADIUS": 150.0, **parameters}, plans)
    return fence.outside(place, home, FlatEarth(home)) == 0


def room_m(fence: Any, at_ne_m: tuple[float, float]) -> float:
    """How far inside of what its zones allow."""
    north, east = np.asarray(at_ne_m[0]), np.asarray(at_ne_m[1])
    return min((float(zone.distance_m(north, east)) for zone in fence.zones), default=math.inf)


@given(st.lists(shapes(), min_size=1, max_size=4), st.lists(places, min_size=20), st.data())
def test_what_zones_allow_both_autopilots_allow_and_their_margin_about_it(
    drawn: Any, points: Any, data: st.DataObject
) -> None:
    items, margin_m = list(itertools.chain(*drawn)), data.draw(st.floats(0.0, 30.0))
    for theirs in ({**ON, "FENCE_OPTIONS": 3.0}, ON, None):
        parameters = {"GF_ACTION": 2.0} if theirs is None else {**theirs, "FENCE_MARGIN": margin_m}
        fence = zones_of(items, parameters, here_ne_m=points[0])
        without = theirs is None or any("without" in said for said in fence.notes)
        reach_m = 0.0 if without else margin_m
        for north, east in () if fence.refusal else points:
            if room_m(fence, (north, east)) > 3.0:  # ArduPilot's flat earth is 0.1 % off
                for a, b in ((0, 0), (1, 0), (0, 1), (-1, 0), (0, -1)):
                    assert allows(items, (north + a * reach_m, east + b * reach_m), theirs)


SLANTED = ((0.0, 0.0), (1.0, 3.0), (-0.9, 1.2))
CONTINENT = ((-30.0, -29.9), (30.0, 30.1), (30.0, 70.0), (-30.0, 70.0))


@pytest.mark.parametrize(("corners_deg", "near_deg"), [(SLANTED, 9.0), (CONTINENT, 0.3)])
@pytest.mark.parametrize("size", [0.03, 0.3, 1.0])
@pytest.mark.parametrize("where_deg", [(0.0, 8.0), (47.0, 8.0), (-33.0, 179.99)])
def test_a_side_is_straight_in_degrees_and_nowhere_off_by_half_a_metre(
    where_deg: tuple[float, float], size: float, corners_deg: Any, near_deg: float
) -> None:
    """Wherever and however long it is; of a continent's fence, the part that is near."""
    frame = LocalFrame(latitude_deg=where_deg[0], longitude_deg=where_deg[1])
    corners = np.array(where_deg) + size * np.array(corners_deg)
    zone = zones_of([in_degrees(each, len(corners)) for each in corners], ON, frame).zones[0]
    for one, other in itertools.pairwise((*corners, corners[0])):
        along_deg = np.linspace(one, other, 9000)
        near = np.hypot(*(along_deg - where_deg).T) < near_deg
        off_m = zone.distance_m(*frame.to_local_m(*along_deg[near].T))
        assert (np.abs(off_m) < 0.52).all()  # a place in 1e-7 degrees is rounded


def test_out_of_a_polygon_that_crosses_itself_means_out_of_its_hull() -> None:
    fold = ((0.0, 0.0), (0.0, 100.0), (0.0, 50.0), (50.0, 50.0))
    for corners in (fold, BOW):
        fence = zones_of(ring(OUT, *corners), ON)
        assert "crosses itself" in fence.notes[0]
    assert allows(ring(OUT, *BOW), (0.0, 90.0), ON)  # a hole by the even-odd rule
    assert room_m(fence, (0.0, 90.0)) < -5.0
    inside = zones_of(ring(IN, *BOW), ON)
    assert room_m(inside, (90.0, 0.0)) > 0.0 > room_m(inside, (0.0, 90.0))
    assert allows(ring(IN, *BOW), (90.0, 0.0), ON)


def test_inclusions_of_which_one_is_enough_are_those_that_the_vehicle_is_in() -> None:
    items = [item(CIRCLE_IN, 0.0, 0.0, 100.0), item(CIRCLE_IN, 500.0, 0.0, 100.0)]
    for parameters in ({}, {**ON, "FENCE_OPTIONS": 2.0}):
        fence = zones_of(items, parameters, here_ne_m=(10.0, 0.0))
        assert [zone.name for zone in fence.zones] == ["fence inclusion 1"]
    both = zones_of(items, ON, here_ne_m=(10.0, 0.0))
    assert len(both.zones) == len(zones_of(items, {}).zones) == 2
    assert "inside of all of" in both.notes[0]


@pytest.mark.parametrize(
    ("items", "words"),
    [
        (ring(IN, *SQUARE)[:3], "incomplete"),
        ([item(OUT, *corner, 3.5) for corner in SQUARE], "incomplete"),
        *(([item(OUT, 0.0, 0.0, value)], "three corners") for value in (math.nan, -1.0, 1.0, 1e9)),
        # a long side gets corners between, and is no straight line here
        *((ring(side, (0.0, 0.0), (1e5, 2e5), (0.0, 0.0)), "three corners") for side in (IN, OUT)),
        ([*ring(OUT, *SQUARE), item(OUT, 0.0, 0.0, 4.0)], "three corners"),
        ([item(CIRCLE_IN, 0.0, 0.0, 1.0)], "FENCE_MARGIN"),
        *(([item(CIRCLE_OUT, 50, 0, r)], "needs a radius") for r in (math.nan, 0.0, 3e38)),
        ([item(OUT, 0.0, 0.0, 3.0, x=2_000_000_000)] * 3, "nowhere"),
        ([item(CIRCLE_OUT, 0.0, 0.0, 9.0, x=0, y=0)], "nowhere"),
        *(([item(CIRCLE_OUT, 50, 0, 9.0, frame=f)], f"frame {f}") for f in (1, 2, 7, 200)),
        ([item(16, 50.0, 0.0, 0.0)], "no fence (NAV_WAYPOINT)"),
        ([item(4999, 50.0, 0.0, 0.0)], "no fence (4999)"),
    ],
)
def test_what_cannot_be_kept_is_refused_alone(items: list[PlanItem], words: str) -> None:
    around = item(CIRCLE_OUT, 500.0, 0.0, 50.0)
    fence = zones_of([around, *items, around], {**ON, "FENCE_MARGIN": 2.0})
    assert words in fence.refusal
    assert "\n" not in fence.refusal
    assert conflicts(fence, TASK, ()) == (fence.refusal,)
    assert len([zone for zone in fence.zones if room_m(fence, (500.0, 0.0)) < -50.0]) >= 2


def test_an_exclusion_that_lacks_corners_is_its_hull_and_a_corner_counts_once() -> None:
    items = [*ring(OUT, *SQUARE)[:3], item(5000, 0.0, 0.0, 0.0), item(CIRCLE_OUT, 0, 0, 0.0)]
    fence = zones_of(items, {})
    rings = ring(OUT, SQUARE[0], *SQUARE, SQUARE[3], SQUARE[0])
    twice = zones_of(rings, {**ON, "FENCE_ENABLE": 0.0})  # and is kept, and that is said
    assert "FENCE_ENABLE = 0" in twice.notes[0]
    assert [said.split(":")[0] for said in fence.notes] == ["fence exclusion 2"]
    assert fence.refusal.startswith("fence exclusion 1 is incomplete")
    assert [len(drawn.zones[0].vertices_ne_m) for drawn in (fence, twice)] == [3, 4]


CYLINDER = {"FENCE_RADIUS": 150.0, "FENCE_ALT_MAX": 100.0, "FENCE_ALT_MIN": 10.0}


def cylinder(parameters: dict[str, float]) -> tuple[Any, ...]:
    """Floor, ceiling and room of a fence about a home at 10 m, 20 m, at its middle."""
    fence = zones_of((), parameters, home_nea_m=(10.0, 20.0, HOME_M))
    return fence.floor_amsl_m, fence.ceiling_amsl_m, room_m(fence, (10.0, 20.0))


@pytest.mark.parametrize("bits", range(16))
def test_a_cylinder_about_home_is_what_parameters_say(bits: int) -> None:
    floor_m = HOME_M + 12.0 if bits & 8 else None
    ceiling_m = HOME_M + 98.0 if bits & 1 else None
    fence = {**CYLINDER, "FENCE_TYPE": float(bits), "FENCE_MARGIN": 2.0}
    for switch in ("FENCE_ENABLE", "FENCE_AUTOENABLE"):
        on = {**fence, "FENCE_ENABLE": 0.0, switch: 1.0}
        assert cylinder(on) == (floor_m, ceiling_m, 148.0 if bits & 2 else math.inf)
        assert ARDUCOPTER.firmware.fence(on).is_about_home == bool(bits & 11)
    assert cylinder({**fence, "FENCE_ENABLE": 0.0}) == (None, None, math.inf)
    assert cylinder({"GF_MAX_HOR_DIST": 300.0, "GF_MAX_VER_DIST": 0.0}) == (None, None, 300.0)
    assert cylinder({"GF_MAX_VER_DIST": 120.0}) == (None, HOME_M + 120.0, math.inf)


def test_a_mission_that_leaves_the_fence_is_refused_with_words() -> None:
    parameters = {**CYLINDER, "FENCE_ENABLE": 1.0, "FENCE_TYPE": 3.0, "FENCE_MARGIN": 2.0}
    fence = zones_of((), parameters, home_nea_m=(0.0, 0.0, HOME_M))
    assert conflicts(fence, TASK, [(0.0, 90.0)]) == ()
    (line,) = conflicts(fence, TASK, [(0.0, 90.0), (0.0, 488.0)])
    assert line == (
        "target 2: 390 m too far from being inside of the vehicle's fence about home "
        "(radius 150 m) by the clearance of 50 m. Move the target, or change the fence"
    )
    (thin,) = conflicts(zones_of((), parameters, home_nea_m=(0, 0, 410.0)), TASK, ())
    assert "leaves 500 to 508 m AMSL" in thin


def test_targets_are_the_places_between_take_off_and_the_end() -> None:
    items = [item(command, 0.0, 0.0, 0.0) for command in (16, 22, 178)]  # the first is home
    items += [item(16, 100.0, 0.0, 15.0), item(82, 200.0, 0.0, 0.0), item(19, 300.0, 0.0, 10.0)]
    items += [PlanItem(frame=3, command=18), item(20, 0.0, 0.0, 0.0), item(16, 900.0, 0.0, 0.0)]
    found = targets_of(items, FRAME, home_first=True)
    assert [round(north) for north, _ in found.targets_ne_m] == [100, 200, 300]
    assert found.end_action is EndAction.RETURN
    assert found.notes == (
        "item 2 (DO_CHANGE_SPEED) is not flown: left out",
        "item 6 (NAV_LOITER_TURNS) names no place: left out",
        "items 8 to 8 come after the end: left out",
        "left out: 1 x waiting at a waypoint, 1 x spline at a waypoint, 1 x loiter at a waypoint",
    )
    ends = {17: (EndAction.HOLD, 2), 21: (EndAction.LAND, 2), 20: (EndAction.RETURN, 1)}
    for last, end in (ends | {16: (None, 2)}).items():
        found = targets_of([item(16, 50, 0, 0), item(last, 90, 0, 0)], FRAME, home_first=False)
        assert (found.end_action, len(found.targets_ne_m)) == end


@given(st.lists(shapes(), max_size=6))
def test_px4_misreads_a_polygon_after_a_circle_and_nothing_else(
    drawn: list[list[PlanItem]],
) -> None:
    """From there on its `Geofence::_updateFence` takes each item for the beginning of a shape."""
    is_circle = [shape[0].command in (CIRCLE_IN, CIRCLE_OUT) for shape in drawn]
    said = PX4_MULTICOPTER.firmware.misread(list(itertools.chain(*drawn)), "PX4")
    assert bool(said) == (is_circle != sorted(is_circle))
    assert not said or said.endswith("Upload polygons before circles")
