import math
from dataclasses import replace

import numpy as np
import pytest
from brute_force import FloatArray, broken_by, fastest_m_s, random_case, truth
from planning import ARDUCOPTER, limits

from companion.path.certificate import Certificate, Margins, certify, pack_surroundings
from companion.path.envelope import envelope_of, flown_on_m
from companion.path.limits import Limits
from companion.path.subpath import Subpath
from companion.world.known_map import KnownMap
from companion.world.radars import Radar
from companion.world.zones import CircleZone, PolygonZone, Zone

LIMITS = limits(
    turn_radius_m=200.0,
    dive_angle_rad=0.25,
    ceiling_amsl_m=800.0,
    north_m=(0.0, 4_000.0),
    east_m=(0.0, 4_000.0),
)
MARGINS = Margins(
    clearance_m=60.0, contact_m=12.0, band_inset_m=10.0, motion=envelope_of(LIMITS, ARDUCOPTER)
)
CASES, NIGHTLY_CASES = 20, 80


def a_map(upper: FloatArray | float = 0.0, cell_m: float = 100.0) -> KnownMap:
    cells = np.broadcast_to(np.asarray(upper, dtype=float), (40, 40)).copy()
    return KnownMap(
        cell_m=cell_m, north_min_m=0.0, east_min_m=0.0, upper_m=cells, seen=np.isfinite(cells)
    )


def certified(
    *corners: tuple[float, float, float],
    known: KnownMap | None = None,
    radars: tuple[Radar, ...] = (),
    zones: tuple[Zone, ...] = (),
    from_rest: bool = False,
    limits: Limits = LIMITS,
    margins: Margins = MARGINS,
    reach_m: float = 3_000.0,
    stops: bool = True,
) -> Certificate:
    surroundings = pack_surroundings(
        known or a_map(),
        limits,
        radars,
        zones,
        replace(margins, motion=envelope_of(limits, ARDUCOPTER)),
        centre_ne_m=(2_000.0, 2_000.0),
        reach_m=reach_m,
        stops=stops,
    )
    subpath = Subpath(control_nea_m=np.array(corners, dtype=float))
    return certify(subpath, surroundings, from_rest=from_rest)


def level(altitude_m: float = 400.0, east_m: float = 2_000.0) -> list[tuple[float, float, float]]:
    """A straight subpath due north at constant speed, 3 km."""
    return [(500.0 + 1_000.0 * k, east_m, altitude_m) for k in range(4)]


def arc(radius_m: float) -> list[tuple[float, float, float]]:
    """A quarter circle, to 0.03 % (the usual Bezier approximation)."""
    k = 4.0 / 3.0 * math.tan(math.pi / 8.0) * radius_m
    r = radius_m
    flat = [(0.0, 0.0), (k, 0.0), (r, r - k), (r, r)]
    return [(1_500.0 + n, 1_500.0 + e, 400.0) for n, e in flat]


def test_level_flight_over_a_plain_is_proven_with_its_exact_numbers() -> None:
    told = certified(*level(400.0), known=a_map(330.0))
    assert told.proven
    assert told.broken == ()
    assert told.clearance_m == pytest.approx(70.0, abs=0.1)
    assert told.keep_out_m == math.inf
    assert told.turn_radius_m == math.inf
    assert told.climb_angle_rad == told.dive_angle_rad == told.off_map_m == told.radar_m == 0.0
    assert told.lowest_amsl_m == told.highest_amsl_m == pytest.approx(400.0)
    assert told.pieces > 0


@pytest.mark.parametrize("off", [-5, -1, 1, 5])
def test_the_floor_and_the_ceiling_are_proven_to_a_hundredth_of_a_metre(off: int) -> None:
    floor = LIMITS.floor_amsl_m + MARGINS.band_inset_m
    ceiling = LIMITS.ceiling_amsl_m - MARGINS.band_inset_m
    low = certified(*level(floor + 0.01 * off))
    high = certified(*level(ceiling + 0.01 * off))
    assert low.broken == (("floor of the band",) if off < 0 else ())
    assert high.broken == (("ceiling of the band",) if off > 0 else ())


@pytest.mark.parametrize("off", [-5, -1, 1, 5])
@pytest.mark.parametrize("registration_m", [0.0, 30.0])
def test_clearance_above_is_proven_to_a_hundredth_of_a_metre(
    off: int, registration_m: float
) -> None:
    known = replace(a_map(400.0 - MARGINS.clearance_m), registration_m=registration_m)
    told = certified(*level(400.0 + 0.01 * off), known=known)
    assert told.broken == (("terrain clearance",) if off < 0 else ())
    assert told.clearance_m == pytest.approx(MARGINS.clearance_m + 0.01 * off, abs=1e-5)


@pytest.mark.parametrize("off", [-1.0, -0.01, 0.01, 1.0])
@pytest.mark.parametrize("registration_m", [0.0, 30.0])
def test_clearance_beside_a_pillar_is_proven_to_a_hundredth_of_a_metre(
    off: float, registration_m: float
) -> None:
    known = replace(a_map(), registration_m=registration_m)
    known.upper_m[20, 20] = 700.0
    east = 2_000.0 - registration_m - MARGINS.clearance_m - off
    assert certified(*level(400.0, east), known=known).broken == (
        ("terrain clearance",) if off < 0 else ()
    )


def test_over_the_edge_of_a_column_the_distance_is_that_in_three_dimensions() -> None:
    known = a_map()
    known.upper_m[:, 20:] = 364.0  # a step 30 m to the east and 36 m below the track
    told = certified(*level(400.0, 1_952.0), known=known)
    assert told.clearance_m == pytest.approx(60.0, abs=0.1)
    assert told.broken == ()


@pytest.mark.parametrize("what", [math.inf, math.nan])
def test_unknown_ground_has_no_top(what: float) -> None:
    known = a_map()
    known.upper_m[20, 20] = what
    told = certified(*level(780.0), known=known)
    assert "terrain clearance" in told.broken
    assert told.clearance_m == 0.0


def test_beyond_the_reach_that_was_packed_nothing_is_proven() -> None:
    assert certified(*level()).proven
    assert "terrain clearance" in certified(*level(), reach_m=500.0).broken


@pytest.mark.parametrize("share", [0.95, 0.99, 1.01, 1.05])
def test_an_arc_is_too_tight_just_below_the_turn_radius(share: float) -> None:
    told = certified(*arc(share * LIMITS.turn_radius_m))
    assert told.turn_radius_m == pytest.approx(share * LIMITS.turn_radius_m, rel=0.01)
    assert ("turn radius" in told.broken) == (share < 1.0)


@pytest.mark.parametrize("off", [-0.01, -1e-6, 1e-6, 0.01])
def test_climb_and_dive_are_too_steep_just_beyond_their_angles(off: float) -> None:
    for angle, sign, words in (
        (LIMITS.climb_angle_rad, 1.0, "climb angle"),
        (LIMITS.dive_angle_rad, -1.0, "dive angle"),
    ):
        rise = sign * math.tan(angle + off) * 200.0
        told = certified(*[(500.0 + 200.0 * k, 2_000.0, 550.0 + k * rise) for k in range(4)])
        measured = told.climb_angle_rad if sign > 0.0 else told.dive_angle_rad
        assert measured == pytest.approx(angle + off)
        assert told.broken == ((words,) if off > 0.0 else ())


@pytest.mark.parametrize("off", [-0.05, -0.01, 0.01, 0.05])
def test_a_keep_out_is_too_near_just_within_the_clearance(off: float) -> None:
    aside = 2_000.0 + 300.0 + MARGINS.clearance_m + off
    circle = CircleZone(name="c", north_m=2_005.0, east_m=aside, radius_m=300.0)
    corners = ((1_900.0, aside), (1_900.0, aside - 300.0), (2_100.0, aside - 300.0))
    triangle = PolygonZone(name="t", vertices_ne_m=corners)
    far = CircleZone(name="f", north_m=0.0, east_m=9_000.0, radius_m=10.0)
    for zone in (circle, triangle):
        told = certified(*level(), zones=(far, zone))
        assert told.keep_out_m == pytest.approx(MARGINS.clearance_m + off, abs=1e-6)
        assert told.broken == (("keep-out zone",) if off < 0 else ())


@pytest.mark.parametrize("off", [-0.01, 0.3])
def test_an_arc_at_a_constant_distance_from_a_zone_is_proven_to_half_a_percent(off: float) -> None:
    radius = 300.0 - MARGINS.clearance_m - off
    zone = CircleZone(name="c", north_m=1_500.0, east_m=1_800.0, radius_m=radius)
    told = certified(*arc(300.0), zones=(zone,))
    assert told.broken == (("keep-out zone",) if off < 0 else ())


@pytest.mark.parametrize("order", [1, -1], ids=["closed polygon first", "closed polygon last"])
def test_a_path_through_a_polygon_that_repeats_its_first_corner_is_not_safe(order: int) -> None:
    corners = ((1_900.0, 1_900.0), (1_900.0, 2_100.0), (2_100.0, 2_000.0), (1_900.0, 1_900.0))
    zones = (
        PolygonZone(name="t", vertices_ne_m=corners),
        CircleZone(name="f", north_m=0.0, east_m=9_000.0, radius_m=10.0),
    )
    told = certified(*level(), zones=zones[::order])
    assert "keep-out zone" in told.broken
    assert told.keep_out_m < 0.0


@pytest.mark.parametrize("off", [-5.0, -0.01, 0.01, 5.0])
def test_a_keep_in_is_left_just_where_its_edge_is_nearer_than_the_clearance(off: float) -> None:
    half = MARGINS.clearance_m + off
    box = tuple((n, e) for n, e in ((0.0, -half), (0.0, half), (3_900.0, half), (3_900.0, -half)))
    zone = PolygonZone(
        name="b", vertices_ne_m=tuple((n, 2_000.0 + e) for n, e in box), keep_in=True
    )
    told = certified(*level(), zones=(zone,))
    assert told.keep_out_m == pytest.approx(MARGINS.clearance_m + off, abs=1e-6)
    assert told.broken == (("keep-out zone",) if off < 0 else ())
    radius = 1_500.0 + MARGINS.clearance_m + off  # the path's ends are the farthest
    circle = CircleZone(name="c", north_m=2_000.0, east_m=2_000.0, radius_m=radius, keep_in=True)
    told = certified(*level(), zones=(circle,), limits=replace(LIMITS, dead_man_s=0.0))
    assert told.keep_out_m == pytest.approx(MARGINS.clearance_m + off, abs=1e-6)
    assert told.broken == (("keep-out zone",) if off < 0 else ())


@pytest.mark.parametrize("keep_in", [False, True])
def test_a_fence_of_three_hundred_corners_is_as_near_as_the_circle_through_them(
    keep_in: bool,
) -> None:
    turn = np.linspace(0.0, 2.0 * math.pi, 300, endpoint=False)
    radius, aside = (1_900.0, 2_000.0) if keep_in else (700.0, 1_200.0)
    corners = zip(2_000.0 + radius * np.cos(turn), aside + radius * np.sin(turn), strict=True)
    fence = PolygonZone(
        name="f", vertices_ne_m=tuple((float(n), float(e)) for n, e in corners), keep_in=keep_in
    )
    circle = CircleZone(name="c", north_m=2_000.0, east_m=aside, radius_m=radius, keep_in=keep_in)
    margins = replace(MARGINS, clearance_m=300.0)
    one, other = (certified(*level(), zones=(zone,), margins=margins) for zone in (fence, circle))
    assert one.keep_out_m == pytest.approx(other.keep_out_m, abs=radius * (turn[1] ** 2) / 8.0)


def test_a_path_outside_of_a_keep_in_is_not_safe_however_far() -> None:
    square = ((0.0, 0.0), (0.0, 500.0), (500.0, 500.0), (500.0, 0.0))
    told = certified(*level(), zones=(PolygonZone(name="s", vertices_ne_m=square, keep_in=True),))
    assert {"keep-out zone", "dead-man reach"} <= set(told.broken)
    circle = CircleZone(name="c", north_m=0.0, east_m=0.0, radius_m=500.0, keep_in=True)
    assert certified(*level(), zones=(circle,)).keep_out_m == pytest.approx(
        500.0 - math.hypot(3_500.0, 2_000.0)
    )


PLANE = replace(LIMITS, loiter_radius_m=90.0)


@pytest.mark.parametrize("off", [-1.0, -0.01, 0.01, 1.0])
def test_the_whole_circle_of_a_plane_has_to_be_clear(off: float) -> None:
    away = MARGINS.clearance_m + PLANE.loiter_radius_m + off
    known = a_map()
    known.upper_m[20, 20] = 700.0  # a pillar from 2,000 m east on
    told = certified(*level(400.0, 2_000.0 - away), known=known, limits=PLANE)
    assert told.broken == (("terrain clearance",) if off < 0 else ())
    assert told.clearance_m == pytest.approx(MARGINS.clearance_m + off, abs=0.1)
    zone = CircleZone(name="c", north_m=2_000.0, east_m=2_000.0 + away + 300.0, radius_m=300.0)
    told = certified(*level(), zones=(zone,), limits=PLANE)
    assert told.broken == (("keep-out zone",) if off < 0 else ())
    assert told.keep_out_m == pytest.approx(MARGINS.clearance_m + off, abs=1e-6)


def test_under_the_circle_of_a_plane_the_terrain_is_as_far_as_it_is_below() -> None:
    known = a_map()
    known.upper_m[20, 20] = 330.0
    told = certified(*level(400.0, 1_920.0), known=known, limits=PLANE)
    assert told.clearance_m == pytest.approx(70.0, abs=0.1)
    assert certified(*level(400.0, 1_920.0), known=known).clearance_m == pytest.approx(
        math.hypot(80.0, 70.0), abs=0.1
    )


def test_a_plane_has_no_stretch_ahead_only_its_circle() -> None:
    margins = replace(MARGINS, clearance_m=14.0)
    ahead = 10.0 + margins.clearance_m + 1.0
    zone = CircleZone(name="w", north_m=3_500.0 + ahead + 50.0, east_m=2_000.0, radius_m=50.0)
    fast = replace(PLANE, speed_m_s=200.0, loiter_radius_m=10.0)
    told = certified(*level(), zones=(zone,), limits=fast, margins=margins)
    assert told.proven
    assert told.dead_man_m >= MARGINS.contact_m
    hovers = replace(fast, loiter_radius_m=0.0)
    told = certified(*level(), zones=(zone,), limits=hovers, margins=margins)
    assert "dead-man reach" in told.broken


@pytest.mark.parametrize("off", [-1.0, 1.0])
def test_a_path_that_does_not_end_in_a_stop_is_left_at_full_speed(off: float) -> None:
    reach = flown_on_m(MARGINS.motion, LIMITS.speed_m_s)
    margins = replace(MARGINS, clearance_m=20.0)
    wall = 3_500.0 + reach + MARGINS.contact_m + off
    zone = CircleZone(name="w", north_m=wall + 50.0, east_m=2_000.0, radius_m=50.0)
    told = certified(*level(), zones=(zone,), margins=margins, stops=False)
    assert told.broken == (("dead-man reach",) if off < 0 else ())
    assert certified(*level(), zones=(zone,), margins=margins).proven


@pytest.mark.parametrize("off", [-1.0, 1.0])
def test_a_vehicle_that_slows_down_for_its_end_needs_no_more_beyond_it_than_its_overrun(
    off: float,
) -> None:
    slowing, margins = replace(LIMITS, overrun_m=15.0), replace(MARGINS, clearance_m=20.0)
    wall = 3_500.0 + slowing.overrun_m + MARGINS.contact_m + off
    zone = CircleZone(name="w", north_m=wall + 50.0, east_m=2_000.0, radius_m=50.0)
    told = certified(*level(), zones=(zone,), margins=margins, limits=slowing)
    assert told.broken == (("dead-man reach",) if off < 0 else ())
    told = certified(*level(), zones=(zone,), margins=margins)
    assert told.broken == ("dead-man reach",)


def test_a_path_wholly_inside_a_polygon_is_not_safe() -> None:
    square = ((0.0, 0.0), (0.0, 4e3), (4e3, 4e3), (4e3, 0.0))
    told = certified(*level(), zones=(PolygonZone(name="s", vertices_ne_m=square),))
    assert {"keep-out zone", "dead-man reach"} <= set(told.broken)
    assert -2_100.0 <= told.keep_out_m <= -2_000.0


@pytest.mark.parametrize("off", [-5.0, -0.01, 0.01, 5.0])
def test_the_map_ends_at_its_edge(off: float) -> None:
    for turn in range(4):
        near = [(a, 4_000.0 + off) if turn < 2 else (a, -off) for a in (1e3, 1.5e3, 2e3, 2.5e3)]
        corners = [(a, b, 400.0) if turn % 2 else (b, a, 400.0) for a, b in near]
        told = certified(*corners)
        assert told.off_map_m == pytest.approx(max(off, 0.0))
        assert ("edge of the map" in told.broken) == (off > 0.0)
        assert "terrain clearance" in told.broken  # off the map nothing is known


@pytest.mark.parametrize("miss_m", [0.0, 300.0, 799.0, 801.0])
def test_the_length_under_a_radar_is_that_of_the_chord(miss_m: float) -> None:
    radar = Radar(name="r", centre_nea_m=(2_000.0, 2_000.0 + miss_m, 400.0), range_m=800.0)
    chord = 2.0 * math.sqrt(max(800.0**2 - miss_m**2, 0.0))
    told = certified(*level(), radars=(radar,))
    assert chord <= told.radar_m <= chord + 12.0
    nearest = 1.0 / (1.0 + (miss_m / 800.0) ** 4)
    assert told.detection == pytest.approx(nearest if chord else 0.0)
    assert told.proven


def test_a_stretch_under_two_radars_counts_once() -> None:
    one, two = (
        Radar(name="r", centre_nea_m=(north, 2_000.0, 400.0), range_m=500.0)
        for north in (1_800.0, 2_200.0)
    )
    assert certified(*level(), radars=(one, two)).radar_m == pytest.approx(1_403.0, abs=3.0)


def farthest_m(length_m: float, *, from_rest: bool = False) -> float:
    """Where the farthest stretch of a straight path of this length ends, from its start."""
    at = np.linspace(0.0, length_m, 40_001)
    speed = fastest_m_s(MARGINS.motion, length_m - at, at if from_rest else None)
    return float((at + speed * 3.5 + speed**2 / 2 / LIMITS.acceleration_m_s2).max())


# A straight subpath of 3 km ends at 3,500 m north.
BEYOND_M = farthest_m(3_000.0) - 3_000.0


@pytest.mark.parametrize("off", [-1.0, -0.01, 0.01, 1.0])
def test_a_wall_ahead_is_too_near_just_within_the_dead_man_reach(off: float) -> None:
    wall = 3_500.0 + BEYOND_M + MARGINS.contact_m + off
    margins = replace(MARGINS, clearance_m=20.0)
    zone = CircleZone(name="w", north_m=wall + 50.0, east_m=2_000.0, radius_m=50.0)
    told = certified(*level(), zones=(zone,), margins=margins)
    assert told.broken == (("dead-man reach",) if off < 0 else ())
    assert told.dead_man_m == pytest.approx(MARGINS.contact_m + off, abs=0.5)


def test_terrain_ahead_is_too_near_within_the_dead_man_reach() -> None:
    known = a_map()
    known.upper_m[36] = 600.0  # from 3,600 m north on
    margins = replace(MARGINS, clearance_m=30.0)
    wall = 3_600.0
    for off in (-0.5, 0.5):
        start = wall - BEYOND_M - MARGINS.contact_m - off - 3_000.0
        corners = [(start + 1_000.0 * k, 2_000.0, 400.0) for k in range(4)]
        told = certified(*corners, known=known, margins=margins)
        assert told.broken == (("dead-man reach",) if off < 0 else ())


def test_a_vehicle_that_starts_from_rest_is_slower_and_reaches_less_far() -> None:
    corners = [(2_000.0 + 40.0 * k / 3, 2_000.0, 400.0) for k in range(4)]
    flying, resting = (farthest_m(40.0, from_rest=each) for each in (False, True))
    assert resting < flying - 5.0
    margins = replace(MARGINS, clearance_m=20.0)
    for from_rest, farthest in ((False, flying), (True, resting)):
        for off in (-2.0, 2.0):
            wall = 2_000.0 + farthest + MARGINS.contact_m + off
            zone = CircleZone(name="w", north_m=wall + 50.0, east_m=2_000.0, radius_m=50.0)
            told = certified(*corners, zones=(zone,), margins=margins, from_rest=from_rest)
            assert told.broken == (("dead-man reach",) if off < 0 else ())


def test_a_turn_away_from_a_wall_is_refused_if_going_straight_on_would_hit_it() -> None:
    # From a circle of radius 200 m the tangents of 90 m (15 m/s) come 19 m out of it.
    out = (200.0 + 25.0 + 40.0) / math.sqrt(2.0)
    zone = CircleZone(name="w", north_m=1_500.0 + out, east_m=1_700.0 - out, radius_m=40.0)
    limits, margins = replace(LIMITS, turn_radius_m=150.0), replace(MARGINS, clearance_m=14.0)
    fast = certified(*arc(200.0), zones=(zone,), limits=limits, margins=margins)
    assert fast.broken == ("dead-man reach",)
    assert fast.dead_man_m == pytest.approx(25.0 - 19.3, abs=2.0)
    slow = replace(limits, speed_m_s=5.0)
    assert certified(*arc(200.0), zones=(zone,), limits=slow, margins=margins).proven


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e12])
@pytest.mark.parametrize("where", [(0, 0), (1, 1), (3, 2)])
def test_a_curve_that_is_not_finite_is_never_proven_and_no_error(
    value: float, where: tuple[int, int]
) -> None:
    control = np.array(level())
    told_before = certified(*level())
    control[where] = value
    with np.errstate(all="ignore"):
        subpath = Subpath(control_nea_m=control)
    surroundings = pack_surroundings(
        a_map(), LIMITS, (), (), MARGINS, centre_ne_m=(2_000.0, 2_000.0), reach_m=3_000.0
    )
    told = certify(subpath, surroundings, from_rest=False)
    assert told_before.proven
    assert not told.proven
    assert len(told.broken) == 9


def test_a_curve_that_turns_back_on_itself_is_too_tight() -> None:
    there_and_back = [(n, 0.7 * n, 400.0) for n in (1_000.0, 2_000.0, 2_000.0, 1_000.0)]
    assert "turn radius" in certified(*there_and_back).broken
    cusp = [(1_000.0, 1_000.0, 400.0), (2_000.0, 2_000.0, 400.0),
            (1_000.0, 2_000.0, 400.0), (2_000.0, 1_000.0, 400.0)]  # fmt: skip
    assert "turn radius" in certified(*cusp).broken


def test_a_straight_curve_may_start_and_stop_where_control_points_coincide() -> None:
    ends = [(500.0, 1_000.0), (500.0, 1_000.0), (1_300.0, 1_600.0), (2_100.0, 2_200.0)]
    for corners in (ends, [*ends, ends[-1]]):
        assert certified(*[(n, e, 400.0 + 0.1 * n) for n, e in corners]).proven


def test_a_curved_start_out_of_coinciding_control_points_is_infinitely_tight() -> None:
    corners = [(500.0, 1_000.0), (500.0, 1_000.0), (1_300.0, 1_600.0), (2_100.0, 1_600.0)]
    told = certified(*[(n, e, 400.0) for n, e in corners])
    assert told.broken == ("turn radius",)
    assert told.turn_radius_m < 0.01


def test_a_vertical_curve_is_too_steep() -> None:
    told = certified(*[(2_000.0, 2_000.0, 400.0 + 50.0 * k) for k in range(4)])
    assert "climb angle" in told.broken
    assert told.climb_angle_rad == pytest.approx(math.pi / 2)


def test_a_curve_of_no_length_hovers() -> None:
    assert certified(*[(2_000.0, 2_000.0, 400.0)] * 4).proven
    assert "terrain clearance" in certified(*[(2_000.0, 2_000.0, 50.0)] * 4).broken


@pytest.fixture
def cases(request: pytest.FixtureRequest) -> int:
    """How many random curves are looked at."""
    return NIGHTLY_CASES if request.config.getoption("--all") else CASES


def test_random_curves_keep_at_least_what_their_certificates_promise(cases: int) -> None:
    for seed in range(cases):
        case = random_case(np.random.default_rng([9, seed]))
        told = certify(
            Subpath(control_nea_m=case.control_nea_m),
            case.surroundings(),
            from_rest=case.from_rest,
        )
        assert broken_by(told, truth(case, samples=100)) == [], seed


def test_random_curves_that_are_safe_by_two_percent_of_the_clearance_are_proven(
    cases: int,
) -> None:
    safe = 0
    for seed in range(cases):
        case = random_case(np.random.default_rng([10, seed]))
        spare = 0.02 * (case.margins.clearance_m - case.margins.contact_m)
        told = certify(
            Subpath(control_nea_m=case.control_nea_m),
            case.surroundings(),
            from_rest=case.from_rest,
        )
        if case.limits.loiter_radius_m:
            continue  # the truth about a circle is that of some of its points only
        hopeless = {"keep-out zone", "turn radius"} & set(told.broken)
        if hopeless or told.clearance_m < 0.5 * case.margins.clearance_m:
            continue  # spares the search for the truth; what is wrongly hopeless fails above
        real = truth(case, samples=100)
        if (
            real.clearance_m >= case.margins.clearance_m + spare
            and real.dead_man_m >= case.margins.contact_m + spare
        ):
            safe += 1
            assert not {"terrain clearance", "dead-man reach"} & set(told.broken), seed
    assert safe >= cases // 5
