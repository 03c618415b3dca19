"""Fences as zones: what a zone lets through, the simulated autopilots' own fences let through."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from held import HOME_DEG, HOME_M
from hypothesis import given
from hypothesis import strategies as st
from planning import limits

from companion.geodesy import LocalFrame, deg_e7
from companion.mavlink.autopilots import ARDUCOPTER, PX4_MULTICOPTER
from companion.mavlink.fence import Fence, conflicts, drawn, in_force
from companion.mavlink.mission_items import targets_of
from companion.mavlink.plan_client import PlanItem
from companion.mission.mission import EndAction
from companion.planner.settings import PlannerSettings, Task
from companion.world.zones import CircleZone
from vehicle_sim.autopilot.earth import FlatEarth, Projection
from vehicle_sim.autopilot.guards import Fence as ArduPilotFence
from vehicle_sim.autopilot.guards import Zones
from vehicle_sim.autopilot.values import Place
from vehicle_sim.plans import PlanItem as Stored
from vehicle_sim.plans import PlanKind, Plans

FRAME = LocalFrame(latitude_deg=HOME_DEG[0], longitude_deg=HOME_DEG[1])
HOME = (0.0, 0.0, HOME_M)
ON = {"FENCE_ENABLE": 1.0, "FENCE_TYPE": 4.0, "FENCE_MARGIN": 0.0, "FENCE_OPTIONS": 1.0}
CIRCLE_IN, CIRCLE_OUT, IN, OUT = 5003, 5004, 5001, 5002
SLANTED = ((0.0, 0.0), (0.1, 1.0), (-0.9, 0.4))
SQUARE = ((-100.0, -100.0), (-100.0, 100.0), (100.0, 100.0), (100.0, -100.0))
metres = st.floats(-900.0, 900.0)
places = st.tuples(metres, metres)


def zones_of(
    items: Sequence[PlanItem], parameters: dict[str, float], frame: LocalFrame = FRAME, **where: Any
) -> Fence:
    """A fence drawn to its end, and what parameters make of it."""
    is_px4 = not any(name.startswith("FENCE_") for name in parameters)
    settings = (PX4_MULTICOPTER if is_px4 else ARDUCOPTER).firmware.fence(parameters)
    *_, whole = drawn(items, frame, settings.margin_m)
    return in_force(whole, settings, **where)


def item(command: int, north_m: float, east_m: float, parameter: float) -> PlanItem:
    return in_degrees(command, FRAME.to_geodetic_deg(north_m, east_m), parameter)


def in_degrees(command: int, place_deg: tuple[float, float], parameter: float) -> PlanItem:
    latitude_e7, longitude_e7 = map(deg_e7, place_deg)
    parameters = (parameter, 0.0, 0.0, 0.0)
    return PlanItem(frame=0, command=command, parameters=parameters, x=latitude_e7, y=longitude_e7)


def ring(command: int, *corners: tuple[float, float]) -> list[PlanItem]:
    return [item(command, *corner, float(len(corners))) for corner in corners]


def slanting(frame: LocalFrame, *corners: tuple[float, float]) -> Any:
    """The zone of an exclusion whose corners are given in degrees."""
    items = [in_degrees(OUT, corner, float(len(corners))) for corner in corners]
    [zone] = zones_of(items, ON, frame).zones
    return zone


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


def stored(items: list[PlanItem]) -> Plans:
    plans = Plans()
    plans[PlanKind.FENCE] = tuple(
        Stored(frame=0, command=each.command, parameters=each.parameters, x=each.x, y=each.y)
        for each in items
    )
    return plans


def allowed_by_ardupilot(items: list[PlanItem], parameters: dict[str, float], at: Any) -> bool:
    fence = ArduPilotFence({"FENCE_RADIUS": 150.0, **parameters}, stored(items))
    home, place = Place(*HOME_DEG, HOME_M), Place(*FRAME.to_geodetic_deg(*at), HOME_M)
    return fence.outside(place, home, FlatEarth(home)) == 0


def allowed_by_px4(items: list[PlanItem], at: tuple[float, float]) -> bool:
    home, there = Place(*HOME_DEG, HOME_M), Place(*FRAME.to_geodetic_deg(*at), HOME_M)
    return not Zones(stored(items)).forbid(Projection(home), there, union=True)


def room_m(fence: Any, at: tuple[float, float]) -> float:
    """How far inside of what its zones allow."""
    north, east = np.asarray(at[0]), np.asarray(at[1])
    return min((float(zone.distance_m(north, east)) for zone in fence.zones), default=math.inf)


_ROUND_M = 3.0  # ArduPilot's flat earth is 0.1 % off, within 2 km


def within(fence: Fence, points: Any) -> list[Any]:
    return [at for at in points if not fence.refusal and room_m(fence, at) > _ROUND_M]


@given(drawn=st.lists(shapes(), min_size=1, max_size=4), points=st.lists(places, min_size=20))
def test_what_zones_allow_both_autopilots_allow(drawn: Any, points: Any) -> None:
    items = list(itertools.chain(*drawn))
    for union in (False, True):
        parameters = {**ON, "FENCE_OPTIONS": 3.0 if union else 1.0}
        fence = zones_of(items, parameters, here_ne_m=points[0])
        for at in within(fence, points):
            assert allowed_by_ardupilot(items, parameters, at)
    fence = zones_of(items, {"GF_ACTION": 2.0}, here_ne_m=points[0])
    for at in within(fence, points):
        assert allowed_by_px4(items, at)


@given(shape=shapes(), points=st.lists(places, min_size=20), margin_m=st.floats(1.0, 30.0))
def test_a_margin_is_kept_from_every_edge(shape: Any, points: Any, margin_m: float) -> None:
    bare = zones_of(shape, ON)
    fence = zones_of(shape, {**ON, "FENCE_MARGIN": margin_m})
    if fence.refusal or any("without" in said for said in fence.notes):
        return
    for at in points:
        if room_m(fence, at) > 0.0:
            assert room_m(bare, at) > margin_m - 1e-3


@pytest.mark.parametrize("latitude_deg", [0.0, -33.0, 60.0, 77.0])
@pytest.mark.parametrize("size_deg", [0.03, 0.3, 2.0])
def test_a_side_is_nowhere_off_by_half_a_metre(latitude_deg: float, size_deg: float) -> None:
    """Between its corners it is straight in degrees, wherever and however long it is."""
    frame = LocalFrame(latitude_deg=latitude_deg, longitude_deg=8.0)
    ring_deg = [(latitude_deg + size_deg * a, 8.0 + 3.0 * size_deg * b) for a, b in SLANTED]
    zone = slanting(frame, *ring_deg)
    for one, other in zip(ring_deg, (*ring_deg[1:], ring_deg[0]), strict=True):
        latitude, longitude = np.linspace(one, other, 500).T
        off_m = np.abs(zone.distance_m(*frame.to_local_m(latitude, longitude)))
        assert off_m.max() < 0.5 + 0.02  # and what a place in 1e-7 degrees is rounded by


@pytest.mark.parametrize("latitude_deg", [0.0, 47.0, -33.0])
@pytest.mark.parametrize("longitude_deg", [8.0, 179.99])
def test_a_fence_of_a_continent_is_in_place(latitude_deg: float, longitude_deg: float) -> None:
    """Its corners lie thousands of kilometres away; a slanting side goes past the vehicle."""
    frame = LocalFrame(latitude_deg=latitude_deg, longitude_deg=longitude_deg)
    off_deg = ((-30.0, -29.9), (30.0, 30.1), (30.0, 70.0), (-30.0, 70.0))
    corners = [(latitude_deg + a, (longitude_deg + b + 180.0) % 360.0 - 180.0) for a, b in off_deg]
    zone = slanting(frame, *corners)
    part_deg = np.linspace(-0.3, 0.3, 61)  # along that side
    along = frame.to_local_m(latitude_deg + part_deg, longitude_deg + 0.1 + part_deg)
    assert np.abs(zone.distance_m(*along)).max() < 1.0
    east_deg = longitude_deg + np.array([0.2, 0.0, 3.0, -3.0])
    beside = frame.to_local_m(np.full(4, latitude_deg), east_deg)
    assert list(zone.distance_m(*beside) < 0.0) == [True, False, True, False]


def test_out_of_a_polygon_that_crosses_itself_means_out_of_its_hull() -> None:
    bow = ((-100.0, -100.0), (100.0, 100.0), (100.0, -100.0), (-100.0, 100.0))
    fold = ((0.0, 0.0), (0.0, 100.0), (0.0, 50.0), (50.0, 50.0))
    for corners in (fold, bow):
        fence = zones_of(ring(OUT, *corners), ON)
        assert "crosses itself" in fence.notes[0]
    assert allowed_by_ardupilot(ring(OUT, *bow), ON, (0.0, 90.0))  # a hole by the even-odd rule
    assert room_m(fence, (0.0, 90.0)) < -5.0
    inside = zones_of(ring(IN, *bow), ON)
    assert room_m(inside, (90.0, 0.0)) > 0.0
    assert room_m(inside, (0.0, 90.0)) < 0.0
    assert allowed_by_ardupilot(ring(IN, *bow), ON, (90.0, 0.0))


def test_inclusions_of_which_one_is_enough_are_those_that_the_vehicle_is_in() -> None:
    items = [item(CIRCLE_IN, 0.0, 0.0, 100.0), item(CIRCLE_IN, 500.0, 0.0, 100.0)]
    for parameters in ({}, {**ON, "FENCE_OPTIONS": 2.0}):
        fence = zones_of(items, parameters, here_ne_m=(10.0, 0.0))
        assert [zone.name for zone in fence.zones] == ["fence inclusion 1"]
    both = zones_of(items, ON, here_ne_m=(10.0, 0.0))
    assert len(both.zones) == 2
    assert "inside of all of" in both.notes[0]
    assert len(zones_of(items, {}).zones) == 2


@pytest.mark.parametrize(
    ("items", "words"),
    [
        (ring(IN, *SQUARE)[:3], "incomplete"),
        (ring(IN, *SQUARE[:2]), "three corners"),
        # a long side gets corners between, and is no straight line here
        *((ring(side, (0.0, 0.0), (1e5, 2e5), (0.0, 0.0)), "three corners") for side in (IN, OUT)),
        (ring(OUT, *[SQUARE[0]] * 5), "three corners"),
        ([*ring(OUT, *SQUARE), item(OUT, 0.0, 0.0, 4.0)], "three corners"),
        ([item(CIRCLE_IN, 0.0, 0.0, 1.0)], "FENCE_MARGIN"),
        *(
            ([item(CIRCLE_OUT, 50, 0, r)], "needs a radius")
            for r in (math.inf, math.nan, 0.0, 3e38)
        ),
        ([item(OUT, 0.0, 0.0, 3.0)._replace(x=2_000_000_000)] * 3, "nowhere"),
        ([item(OUT, *corner, 3.5) for corner in SQUARE], "incomplete"),
        ([item(CIRCLE_OUT, 50.0, 0.0, 9.0)._replace(frame=200)], "frame 200"),
        ([item(16, 50.0, 0.0, 0.0)], "no fence (NAV_WAYPOINT)"),
        ([item(4999, 50.0, 0.0, 0.0)], "no fence (4999)"),
        ([PlanItem(frame=0, command=CIRCLE_OUT, parameters=(9.0, 0, 0, 0))], "nowhere"),
    ],
)
def test_a_fence_that_cannot_be_kept_is_refused(items: list[PlanItem], words: str) -> None:
    fence = zones_of(items, {**ON, "FENCE_MARGIN": 2.0})
    assert words in fence.refusal
    assert conflicts(fence, task(), ()) == (fence.refusal,)


SPOILT: list[dict[str, Any]] = [
    *({"parameters": (v, 0.0, 0.0, 0.0)} for v in (math.nan, math.inf, -1.0, 0.0, 1.0, 2.5, 1e9)),
    *({"frame": frame} for frame in (1, 2, 7, 255)),
    *({"command": 16}, {"x": 2_000_000_000}),
]


@given(st.lists(shapes(), min_size=1, max_size=3), st.sampled_from(SPOILT), st.integers(0))
def test_a_spoilt_item_is_never_left_out(drawn: Any, changes: dict[str, Any], which: int) -> None:
    items = list(itertools.chain(*drawn))
    which %= len(items)
    spoilt, whole = items[which]._replace(**changes), zones_of(items, ON)
    fence = zones_of([*items[:which], spoilt, *items[which + 1 :]], ON)
    is_circle = spoilt.command in (CIRCLE_IN, CIRCLE_OUT) and "parameters" in changes
    if is_circle and 0.0 < spoilt.parameters[0] < 2e7:
        assert len(fence.zones) == len(whole.zones)  # another circle
    else:
        assert fence.refusal
        assert conflicts(fence, task(), ())[0] == fence.refusal
        assert "\n" not in fence.refusal


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


@pytest.mark.parametrize("bits", range(16))
@pytest.mark.parametrize("by_itself", [False, True])
def test_ardupilots_cylinder_is_what_its_bits_say(bits: int, by_itself: bool) -> None:
    switch = {"FENCE_ENABLE": float(not by_itself), "FENCE_AUTOENABLE": 3.0 * by_itself}
    parameters = {**CYLINDER, **switch, "FENCE_TYPE": float(bits), "FENCE_MARGIN": 2.0}
    fence = zones_of((), parameters, home_nea_m=(10.0, 20.0, HOME_M))
    assert fence.ceiling_amsl_m == (HOME_M + 98.0 if bits & 1 else None)
    assert fence.floor_amsl_m == (HOME_M + 12.0 if bits & 8 else None)
    circle = CircleZone(
        name="fence about home", north_m=10.0, east_m=20.0, radius_m=148.0, keep_in=True
    )
    assert [replace(zone, name=circle.name) for zone in fence.zones] == [circle] * bool(bits & 2)
    assert ARDUCOPTER.firmware.fence(parameters).is_about_home == bool(bits & 11)
    disabled = {**parameters, "FENCE_ENABLE": 0.0, "FENCE_AUTOENABLE": 0.0}
    assert not ARDUCOPTER.firmware.fence(disabled).is_about_home


def test_px4s_cylinder() -> None:
    for parameters, room, ceiling_m in (
        ({"GF_MAX_HOR_DIST": 300.0, "GF_MAX_VER_DIST": 0.0}, 300.0, None),
        ({"GF_MAX_VER_DIST": 120.0}, math.inf, HOME_M + 120.0),
    ):
        fence = zones_of((), parameters, home_nea_m=HOME)
        told = (room_m(fence, (0.0, 0.0)), fence.floor_amsl_m, fence.ceiling_amsl_m)
        assert told == (room, None, ceiling_m)


def task() -> Task:
    wide_m = (-5000.0, 5000.0)
    band = limits(floor_amsl_m=500.0, ceiling_amsl_m=660.0, north_m=wide_m, east_m=wide_m)
    settings = PlannerSettings(scan_range_m=1500.0, safety_distance_m=40.0, planning_time_s=3.0)
    return Task(limits=band, settings=settings)


def test_a_mission_that_leaves_the_fence_is_refused_with_words() -> None:
    parameters = {**CYLINDER, "FENCE_ENABLE": 1.0, "FENCE_TYPE": 3.0, "FENCE_MARGIN": 2.0}
    fence = zones_of((), parameters, home_nea_m=HOME)
    assert conflicts(fence, task(), [(0.0, 90.0)]) == ()
    (line,) = conflicts(fence, task(), [(0.0, 90.0), (0.0, 488.0)])
    assert line == (
        "target 2: 390 m too far from being inside of the vehicle's fence about home "
        "(radius 150 m) by the clearance of 50 m. Move the target, or change the fence"
    )
    (thin,) = conflicts(zones_of((), parameters, home_nea_m=(0, 0, 410.0)), task(), ())
    assert "leaves 500 to 508 m AMSL" in thin


def test_targets_are_the_places_between_take_off_and_the_end() -> None:
    items = [
        item(16, 0.0, 0.0, 0.0),  # home
        item(22, 0.0, 0.0, 0.0),
        item(178, 0.0, 0.0, 0.0),
        item(16, 100.0, 0.0, 15.0),
        item(82, 200.0, 0.0, 0.0),
        item(19, 300.0, 0.0, 10.0),
        PlanItem(frame=3, command=18),
        item(20, 0.0, 0.0, 0.0),
        item(16, 900.0, 0.0, 0.0),
    ]
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


def begins_of_px4(items: Sequence[PlanItem]) -> list[int]:
    """Where PX4's `Geofence::_updateFence` takes a shape to begin."""
    begins, sequence, is_circle_area = [], 0, False
    while sequence < len(items):
        is_circle_area = is_circle_area or items[sequence].command in (CIRCLE_IN, CIRCLE_OUT)
        begins.append(sequence)
        sequence += 1 if is_circle_area else int(items[sequence].parameters[0])
    return begins


@given(st.lists(shapes(), max_size=6))
def test_px4_misreads_what_is_named_and_nothing_else(drawn: list[list[PlanItem]]) -> None:
    items, begins = [], []
    for shape in drawn:
        begins.append(len(items))
        items += shape
    said = PX4_MULTICOPTER.firmware.misread(items, "PX4")
    assert bool(said) == (begins_of_px4(items) != begins)
    assert not said or said.endswith("Upload polygons before circles")
    in_order = sorted(drawn, key=lambda shape: shape[0].command in (CIRCLE_IN, CIRCLE_OUT))
    assert PX4_MULTICOPTER.firmware.misread([e for shape in in_order for e in shape], "PX4") == ""
