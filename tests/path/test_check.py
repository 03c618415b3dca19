import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from companion.path.check import CheckReport, check, clearance_m
from companion.path.limits import Limits
from companion.path.subpath import Subpath
from companion.world.clearance import safe_surface
from companion.world.known_map import KnownMap
from companion.world.threats import CircleKeepOut, KeepOut, PolygonKeepOut, Radar

FloatArray = NDArray[np.float64]

LIMITS = Limits(
    speed_m_s=15.0,
    acceleration_m_s2=3.0,
    climb_rate_m_s=4.0,
    turn_radius_m=200.0,
    climb_angle_rad=0.2,
    dive_angle_rad=0.25,
    floor_amsl_m=300.0,
    ceiling_amsl_m=800.0,
    north_m=(0.0, 4_000.0),
    east_m=(0.0, 4_000.0),
)
D_S_M = 60.0

GOOD = CheckReport(
    clearance_m=70.0,
    farthest_m=800.0,
    above_safe_m=0.0,
    keep_out_m=D_S_M,
    turn_radius_m=LIMITS.turn_radius_m,
    climb_angle_rad=LIMITS.climb_angle_rad,
    dive_angle_rad=LIMITS.dive_angle_rad,
    lowest_amsl_m=LIMITS.floor_amsl_m + LIMITS.tracking_error_m,
    highest_amsl_m=LIMITS.ceiling_amsl_m - LIMITS.tracking_error_m,
    off_map_m=0.0,
    radar_m=1e6,
)
BOUNDS = [
    ("above_safe_m", -1, "terrain clearance"),
    ("keep_out_m", -1, "keep-out zone"),
    ("turn_radius_m", -1, "turn radius"),
    ("climb_angle_rad", 1, "climb angle"),
    ("dive_angle_rad", 1, "dive angle"),
    ("lowest_amsl_m", -1, "floor of the band"),
    ("highest_amsl_m", 1, "ceiling of the band"),
    ("off_map_m", 1, "edge of the map"),
]


def a_map(upper: FloatArray | float = 0.0, cell_m: float = 100.0) -> KnownMap:
    cells = np.broadcast_to(np.asarray(upper, dtype=float), (40, 40)).copy()
    return KnownMap(
        cell_m=cell_m,
        north_min_m=0.0,
        east_min_m=0.0,
        upper_m=cells,
        seen=np.isfinite(cells),
    )


def checked(
    *corners: tuple[float, float, float],
    known: KnownMap | None = None,
    radars: tuple[Radar, ...] = (),
    keep_outs: tuple[KeepOut, ...] = (),
) -> CheckReport:
    known = known or a_map()
    safe = safe_surface(
        known,
        centre_ne_m=(2_000.0, 2_000.0),
        reach_m=2_000.0,
        clearance_m=D_S_M,
        unknown_m=LIMITS.ceiling_amsl_m,
    )
    return check(
        Subpath(control_nea_m=np.array(corners, dtype=float)),
        safe=safe,
        known=known,
        limits=LIMITS,
        radars=radars,
        keep_outs=keep_outs,
        safety_distance_m=D_S_M,
    )


def level(altitude_m: float = 400.0, east_m: float = 2_000.0) -> list[tuple[float, float, float]]:
    """A straight subpath due north at constant speed."""
    return [(500.0 + 1_000.0 * k, east_m, altitude_m) for k in range(4)]


def arc(radius_m: float) -> list[tuple[float, float, float]]:
    """A quarter circle, to 0.03 % (the usual Bezier approximation)."""
    k = 4.0 / 3.0 * math.tan(math.pi / 8.0) * radius_m
    r = radius_m
    flat = [(0.0, 0.0), (k, 0.0), (r, r - k), (r, r)]
    return [(1_500.0 + n, 1_500.0 + e, 400.0) for n, e in flat]


def test_a_report_just_at_every_limit_is_safe_to_fly() -> None:
    assert GOOD.violations(LIMITS, D_S_M) == ()


@pytest.mark.parametrize(("field", "sign", "words"), BOUNDS)
@pytest.mark.parametrize("steps", [1, 2, 5])
def test_a_bound_is_broken_from_the_next_number_beyond_its_limit_on(
    field: str, sign: int, words: str, steps: int
) -> None:
    limit = getattr(GOOD, field)
    beyond, within = limit, limit
    for _ in range(steps):
        beyond = math.nextafter(beyond, sign * math.inf)
        within = math.nextafter(within, -sign * math.inf)
    assert replace(GOOD, **{field: beyond}).violations(LIMITS, D_S_M) == (words,)
    assert replace(GOOD, **{field: within}).violations(LIMITS, D_S_M) == ()


@pytest.mark.parametrize(("field", "words"), [(field, words) for field, _, words in BOUNDS])
def test_what_is_not_a_number_is_never_safe(field: str, words: str) -> None:
    assert replace(GOOD, **{field: math.nan}).violations(LIMITS, D_S_M) == (words,)


@pytest.mark.parametrize("off", [-5, -1, 1, 5])
def test_the_floor_and_the_ceiling_are_seen_to_a_hundredth_of_a_metre(off: int) -> None:
    floor = LIMITS.floor_amsl_m + LIMITS.tracking_error_m
    ceiling = LIMITS.ceiling_amsl_m - LIMITS.tracking_error_m
    low = checked(*level(floor + 0.01 * off))
    high = checked(*level(ceiling + 0.01 * off))
    assert ("floor of the band" in low.violations(LIMITS, D_S_M)) == (off < 0)
    assert ("ceiling of the band" in high.violations(LIMITS, D_S_M)) == (off > 0)
    assert low.lowest_amsl_m == pytest.approx(floor + 0.01 * off)
    assert high.highest_amsl_m == pytest.approx(ceiling + 0.01 * off)


@pytest.mark.parametrize("off", [-5, -1, 1, 5])
def test_terrain_clearance_is_seen_to_a_hundredth_of_a_metre(off: int) -> None:
    known = a_map(400.0 - D_S_M)
    report = checked(*level(400.0 + 0.01 * off), known=known)
    assert ("terrain clearance" in report.violations(LIMITS, D_S_M)) == (off < 0)
    assert report.above_safe_m == pytest.approx(0.01 * off)
    assert report.clearance_m == pytest.approx(D_S_M + 0.01 * off)


@pytest.mark.parametrize("share", [0.95, 0.99, 1.01, 1.05])
def test_an_arc_is_too_tight_just_below_the_turn_radius(share: float) -> None:
    report = checked(*arc(share * LIMITS.turn_radius_m))
    assert report.turn_radius_m == pytest.approx(share * LIMITS.turn_radius_m, rel=0.008)
    assert ("turn radius" in report.violations(LIMITS, D_S_M)) == (share < 1.0)


@pytest.mark.parametrize("off", [-0.01, -1e-6, 1e-6, 0.01])
def test_climb_and_dive_are_too_steep_just_beyond_their_angles(off: float) -> None:
    for angle, sign, words in (
        (LIMITS.climb_angle_rad, 1.0, "climb angle"),
        (LIMITS.dive_angle_rad, -1.0, "dive angle"),
    ):
        rise = sign * math.tan(angle + off) * 200.0
        report = checked(*[(500.0 + 200.0 * k, 2_000.0, 550.0 + k * rise) for k in range(4)])
        measured = report.climb_angle_rad if sign > 0.0 else report.dive_angle_rad
        assert measured == pytest.approx(angle + off)
        assert (words in report.violations(LIMITS, D_S_M)) == (off > 0.0)


@pytest.mark.parametrize("off", [-0.05, -0.01, 0.01, 0.05])
def test_a_keep_out_is_too_near_just_within_the_safety_distance(off: float) -> None:
    aside = 2_000.0 + 300.0 + D_S_M + off
    circle = CircleKeepOut(name="c", north_m=2_005.0, east_m=aside, radius_m=300.0)
    corners = ((1_900.0, aside), (1_900.0, aside - 300.0), (2_100.0, aside - 300.0))
    triangle = PolygonKeepOut(name="t", vertices_ne_m=corners)
    far = CircleKeepOut(name="f", north_m=0.0, east_m=9_000.0, radius_m=10.0)
    for zone, slack in ((circle, 0.05), (triangle, 1e-6)):
        report = checked(*level(), keep_outs=(far, zone))
        assert report.keep_out_m == pytest.approx(D_S_M + off, abs=slack)
        if abs(off) > slack / 2:
            assert ("keep-out zone" in report.violations(LIMITS, D_S_M)) == (off < 0)


def test_without_keep_outs_the_nearest_is_infinitely_far() -> None:
    assert checked(*level()).keep_out_m == math.inf


@pytest.mark.parametrize("order", [1, -1], ids=["closed polygon first", "closed polygon last"])
def test_a_path_through_a_polygon_that_repeats_its_first_corner_is_not_safe(order: int) -> None:
    corners = ((1_900.0, 1_900.0), (1_900.0, 2_100.0), (2_100.0, 2_000.0), (1_900.0, 1_900.0))
    zones = (
        PolygonKeepOut(name="t", vertices_ne_m=corners),
        CircleKeepOut(name="f", north_m=0.0, east_m=9_000.0, radius_m=10.0),
    )
    with np.errstate(all="ignore"):
        report = checked(*level(), keep_outs=zones[::order])
    assert "keep-out zone" in report.violations(LIMITS, D_S_M)


@pytest.mark.parametrize("off", [-5.0, -0.01, 0.01, 5.0])
def test_the_map_ends_at_its_edge(off: float) -> None:
    for turn in range(4):
        near = [(a, 4_000.0 + off) if turn < 2 else (a, -off) for a in (1e3, 1.5e3, 2e3, 2.5e3)]
        corners = [(a, b, 400.0) if turn % 2 else (b, a, 400.0) for a, b in near]
        report = checked(*corners)
        assert report.off_map_m == pytest.approx(max(off, 0.0))
        assert ("edge of the map" in report.violations(LIMITS, D_S_M)) == (off > 0.0)


@pytest.mark.parametrize("miss_m", [0.0, 300.0, 799.0, 801.0])
def test_the_length_under_a_radar_is_that_of_the_chord(miss_m: float) -> None:
    radar = Radar(name="r", centre_nea_m=(2_000.0, 2_000.0 + miss_m, 400.0), range_m=800.0)
    chord = 2.0 * math.sqrt(max(800.0**2 - miss_m**2, 0.0))
    report = checked(*level(), radars=(radar,))
    assert report.radar_m == pytest.approx(chord, abs=5.0)


def test_a_stretch_under_two_radars_counts_once() -> None:
    one, two = (
        Radar(name="r", centre_nea_m=(north, 2_000.0, 400.0), range_m=500.0)
        for north in (1_800.0, 2_200.0)
    )
    assert checked(*level(), radars=(one, two)).radar_m == pytest.approx(1_400.0, abs=5.0)


def test_a_dip_between_the_papers_ten_samples_is_seen() -> None:
    known = a_map()
    known.upper_m[20, 20] = 700.0  # one pillar on the way, a cell wide
    report = checked(*level(), known=known)
    assert "terrain clearance" in report.violations(LIMITS, D_S_M)
    assert report.clearance_m == 0.0


def test_clearances_are_measured_up_to_the_distance_that_is_reported() -> None:
    report = checked(*level(790.0), known=a_map(-5_000.0))
    assert report.clearance_m == report.farthest_m == 800.0


@settings(max_examples=40)
@given(seed=st.integers(0, 10**6))
def test_clearance_is_the_distance_to_the_nearest_column_up_to_eight_cells(seed: int) -> None:
    rng = np.random.default_rng(seed)
    upper = rng.uniform(0, 900, (40, 40)) * (rng.random((40, 40)) < 0.02)
    upper[upper == 0.0] = -5_000.0
    upper[rng.random((40, 40)) < 0.2] = np.inf
    known = a_map(upper)
    points = rng.uniform((0, 0, 0), (4_000, 4_000, 900), (50, 3))
    low = np.arange(40) * 100.0
    n = np.maximum(np.maximum(low - points[:, :1], points[:, :1] - low - 100.0), 0.0)
    e = np.maximum(np.maximum(low - points[:, 1:2], points[:, 1:2] - low - 100.0), 0.0)
    down = np.maximum(points[:, 2, None, None] - upper, 0.0)
    squared = n[:, :, None] ** 2 + e[:, None, :] ** 2 + down**2
    brute = np.sqrt(np.where(np.isfinite(upper), squared, np.inf).min(axis=(1, 2)))
    assert clearance_m(known, points) == pytest.approx(np.minimum(brute, 800.0))
