import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from brute_force import broken_by, fastest_m_s, random_case, truth
from planning import ARDUCOPTER, limits

from companion.geodesy import FloatArray
from companion.path.certificate import Certificate, certify
from companion.path.envelope import envelope_of, flown_on_m
from companion.path.limits import Limits
from companion.path.subpath import Subpath
from companion.planner.settings import PlannerSettings, Task
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
MOTION = envelope_of(LIMITS, ARDUCOPTER)
CLEAR_M, CONTACT_M = 60.0, MOTION.contact_m
SETTINGS = PlannerSettings(scan_range_m=3_000.0, safety_distance_m=CLEAR_M, planning_time_s=1.0)
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
    clearance_m: float = CLEAR_M,
    reach_m: float = 3_000.0,
    stops: bool = True,
) -> Certificate:
    task = Task(limits=limits, settings=SETTINGS, handling=ARDUCOPTER, radars=radars, zones=zones)
    place, known = (2_000.0, 2_000.0), known or a_map()
    around = task.surroundings(known, place, reach_m, clearance_m=clearance_m)
    subpath = Subpath(control_nea_m=np.array(corners, dtype=float))
    return certify(subpath, around._replace(stops=stops), from_rest=from_rest)


def level(altitude_m: float = 400.0, east_m: float = 2_000.0) -> list[tuple[float, float, float]]:
    """A straight subpath due north at constant speed, 3 km."""
    return [(500.0 + 1_000.0 * k, east_m, altitude_m) for k in range(4)]


def arc(radius_m: float) -> list[tuple[float, float, float]]:
    """A quarter circle, to 0.03 % (the usual Bezier approximation)."""
    k = 4.0 / 3.0 * math.tan(math.pi / 8.0) * radius_m
    r = radius_m
    flat = [(0.0, 0.0), (k, 0.0), (r, r - k), (r, r)]
    return [(1_500.0 + n, 1_500.0 + e, 400.0) for n, e in flat]


PLANE = replace(LIMITS, loiter_radius_m=90.0)
FLOOR_M = LIMITS.floor_amsl_m + MOTION.error_m
CEILING_M = LIMITS.ceiling_amsl_m - MOTION.error_m
SLOWING = replace(LIMITS, overrun_m=15.0)
LOW = replace(LIMITS, floor_amsl_m=0.0)
SHORT = [(2_000.0 + 40.0 * k / 3, 2_000.0, 400.0) for k in range(4)]


def beyond_m(length_m: float, *, from_rest: bool = False) -> float:
    """How far beyond the end of a straight path of this length its farthest stretch ends."""
    at = np.linspace(0.0, length_m, 40_001)
    speed = fastest_m_s(MOTION, length_m - at, at if from_rest else None)
    return float((at + speed * 3.5 + speed**2 / 2 / LIMITS.acceleration_m_s2).max()) - length_m


def disc(north_m: float, east_m: float, radius_m: float, **kind: bool) -> CircleZone:
    return CircleZone(name="c", north_m=north_m, east_m=east_m, radius_m=radius_m, **kind)


def polygon(*corners: tuple[float, float], **kind: bool) -> PolygonZone:
    return PolygonZone(name="p", vertices_ne_m=corners, **kind)


def slope(angle_rad: float) -> Certificate:
    rise = math.tan(angle_rad) * 200.0
    return certified(*[(500.0 + 200.0 * k, 2_000.0, 550.0 + k * rise) for k in range(4)])


def past(*zones: Zone, **told: Any) -> Certificate:
    return certified(*level(), zones=zones, **told)


def past_a_pillar(away_m: float, off_m: float = 0.0, **told: Any) -> Certificate:
    """Level flight so far west of a pillar, which may stand `off_m` elsewhere."""
    known = replace(a_map(), registration_m=off_m)
    known.upper_m[20, 20] = 700.0  # from 2,000 m north and 2,000 m east on
    return certified(*level(400.0, 2_000.0 - away_m), known=known, **told)


def to_a_wall(end_m: float, *corners: tuple[float, float, float], **told: Any) -> Certificate:
    """Of a path towards a round wall that begins at `end_m`."""
    zones = (disc(end_m + 50.0, 2_000.0, 50.0),)
    return certified(*(corners or level()), zones=zones, clearance_m=20.0, **told)


def to_a_ridge(end_m: float) -> Certificate:
    known = a_map()
    known.upper_m[36] = 600.0  # from 3,600 m north on
    corners = [(3_600.0 - end_m + north, 2_000.0, 400.0) for north, _, _ in level()]
    return certified(*corners, known=known, clearance_m=30.0)


def triangle(aside_m: float) -> PolygonZone:
    east = 2_000.0 + aside_m
    return polygon((1_900.0, east + 300.0), (1_900.0, east), (2_100.0, east))


def box(half_m: float) -> PolygonZone:
    west, east = 2_000.0 - half_m, 2_000.0 + half_m
    return polygon((0.0, west), (0.0, east), (3_900.0, east), (3_900.0, west), keep_in=True)


FAR, RING = disc(0.0, 9_000.0, 10.0), {"keep_in": True}
AT_ONCE, NEAR_RAD = replace(LIMITS, dead_man_s=0.0), (1e-6, 0.01)
REACH_M = flown_on_m(MOTION, LIMITS.speed_m_s)
# How near it must be told, and a certificate with so much room to spare, by the bound.
EDGES: dict[str, list[tuple[float, Callable[[float], Certificate]]]] = {
    "floor of the band": [(0.01, lambda off: certified(*level(FLOOR_M + off)))],
    "ceiling of the band": [(0.01, lambda off: certified(*level(CEILING_M - off)))],
    "terrain clearance": [
        (0.01, lambda off: certified(*level(CLEAR_M + off), known=a_map(0.0), limits=LOW)),
        (0.01, lambda off: past_a_pillar(CLEAR_M + off)),
        (0.01, lambda off: past_a_pillar(CLEAR_M + 30.0 + off, off_m=30.0)),
        (0.01, lambda off: past_a_pillar(CLEAR_M + 90.0 + off, limits=PLANE)),
    ],
    "keep-out zone": [
        (0.01, lambda off: past(disc(2_005.0, 2_300.0 + CLEAR_M + off, 300.0))),
        (0.01, lambda off: past(FAR, disc(2_005.0, 2_300.0 + CLEAR_M + off, 300.0))),
        (0.01, lambda off: past(disc(2_005.0, 2_390.0 + CLEAR_M + off, 300.0), limits=PLANE)),
        (0.01, lambda off: past(FAR, triangle(CLEAR_M + off))),
        (0.01, lambda off: past(box(CLEAR_M + off))),
        (0.01, lambda off: past(disc(2e3, 2e3, 1_500.0 + CLEAR_M + off, **RING), limits=AT_ONCE)),
    ],
    "dead-man reach": [
        (0.01, lambda off: to_a_wall(3_500.0 + beyond_m(3_000.0) + CONTACT_M + off)),
        (1.0, lambda off: to_a_wall(3_500.0 + REACH_M + CONTACT_M + off, stops=False)),
        (1.0, lambda off: to_a_wall(3_500.0 + 15.0 + CONTACT_M + off, limits=SLOWING)),
        (2.0, lambda off: to_a_wall(2_040.0 + beyond_m(40.0) + CONTACT_M + off, *SHORT)),
        (2.0, lambda off: to_a_wall(
            2_040.0 + beyond_m(40.0, from_rest=True) + CONTACT_M + off, *SHORT, from_rest=True)),
        (0.5, lambda off: to_a_ridge(3_500.0 + beyond_m(3_000.0) + CONTACT_M + off)),
    ],
    "turn radius": [
        (near_m, lambda off: certified(*arc(LIMITS.turn_radius_m + off))) for near_m in (2.0, 10.0)
    ],
    "climb angle": [(near, lambda off: slope(LIMITS.climb_angle_rad - off)) for near in NEAR_RAD],
    "dive angle": [(near, lambda off: slope(off - LIMITS.dive_angle_rad)) for near in NEAR_RAD],
}  # fmt: skip
TOLD = {
    "terrain clearance": ("clearance_m", CLEAR_M, 2e-3),
    "keep-out zone": ("keep_out_m", CLEAR_M, 2e-3),
    "turn radius": ("turn_radius_m", LIMITS.turn_radius_m, 0.01),
    "climb angle": ("climb_angle_rad", LIMITS.climb_angle_rad, 1e-6),
    "dive angle": ("dive_angle_rad", LIMITS.dive_angle_rad, 1e-6),
}
"""What is told of it, what that has to be, and how well it is told."""


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("bound", EDGES)
def test_a_bound_is_broken_just_beyond_it_and_kept_just_within(bound: str, sign: float) -> None:
    for near, certificate in EDGES[bound]:
        told = certificate(sign * near)
        assert told.broken == ((bound,) if sign < 0.0 else ())
        if bound in TOLD:
            name, value, rel = TOLD[bound]
            value += sign * near * (-1.0 if name.endswith("_angle_rad") else 1.0)
            assert getattr(told, name) == pytest.approx(value, rel=rel)


@pytest.mark.parametrize("what", [math.inf, math.nan])
def test_unknown_ground_has_no_top_and_beyond_the_reach_nothing_is_proven(what: float) -> None:
    known = a_map()
    known.upper_m[20, 20] = what
    told = certified(*level(780.0), known=known)
    assert "terrain clearance" in told.broken
    assert told.clearance_m == 0.0
    assert certified(*level()).proven
    assert "terrain clearance" in certified(*level(), reach_m=500.0).broken


def test_a_plane_has_no_stretch_ahead_only_its_circle() -> None:
    zone = disc(3_575.0, 2_000.0, 50.0)  # 25 m beyond its end
    plane = replace(LIMITS, speed_m_s=200.0, loiter_radius_m=10.0)
    assert past(zone, limits=plane, clearance_m=14.0).proven
    hovers = replace(plane, loiter_radius_m=0.0)
    assert "dead-man reach" in past(zone, limits=hovers, clearance_m=14.0).broken


def test_a_path_where_a_zone_forbids_to_be_is_not_safe_however_far_from_its_edge() -> None:
    inside = past(polygon((0.0, 0.0), (0.0, 4e3), (4e3, 4e3), (4e3, 0.0)))
    assert -2_100.0 <= inside.keep_out_m <= -2_000.0
    outside = past(disc(0.0, 0.0, 500.0, keep_in=True))
    assert outside.keep_out_m == pytest.approx(500.0 - math.hypot(3_500.0, 2_000.0))
    for told in (inside, outside):
        assert {"keep-out zone", "dead-man reach"} <= set(told.broken)


@pytest.mark.parametrize("off", [-5.0, -0.01, 0.01, 5.0])
def test_the_map_ends_at_its_edge(off: float) -> None:
    for turn in range(4):
        near = [(a, 4_000.0 + off) if turn < 2 else (a, -off) for a in (1e3, 1.5e3, 2e3, 2.5e3)]
        corners = [(a, b, 400.0) if turn % 2 else (b, a, 400.0) for a, b in near]
        told = certified(*corners)
        assert told.off_map_m == pytest.approx(max(off, 0.0))
        assert ("edge of the map" in told.broken) == (off > 0.0)
        assert "terrain clearance" in told.broken  # off the map nothing is known


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e12])
@pytest.mark.parametrize("where", [(0, 0), (1, 1), (3, 2)])
def test_a_curve_that_is_not_finite_is_never_proven_and_no_error(
    value: float, where: tuple[int, int]
) -> None:
    control = np.array(level())
    control[where] = value
    with np.errstate(all="ignore"):
        told = certified(*control)
    assert not told.proven
    assert len(told.broken) == 9


TWICE = ((500.0, 1_000.0), (500.0, 1_000.0))
AHEAD = ((1_300.0, 1_600.0), (2_100.0, 2_200.0))
ODD: dict[str, tuple[tuple[tuple[float, ...], ...], str]] = {
    "there and back": (((1e3, 7e2), (2e3, 14e2), (2e3, 14e2), (1e3, 7e2)), "turn radius"),
    "a cusp": (((1e3, 1e3), (2e3, 2e3), (1e3, 2e3), (2e3, 1e3)), "turn radius"),
    "straight from where points coincide": ((*TWICE, *AHEAD), ""),
    "and to where they do": ((*TWICE, *AHEAD, AHEAD[-1]), ""),
    "a bend from there": ((*TWICE, AHEAD[0], (2_100.0, 1_600.0)), "turn radius"),
    "straight up": (tuple((2e3, 2e3, 400.0 + 50.0 * k) for k in range(4)), "climb angle"),
    "no length": (((2e3, 2e3),) * 4, ""),
    "no length, too low": (((2e3, 2e3, 50.0),) * 4, "terrain clearance"),
}
"""Curves whose shape is a limit, and a bound that each breaks."""


@pytest.mark.parametrize("name", ODD)
def test_a_curve_whose_shape_is_a_limit_is_proven_if_it_can_be_flown(name: str) -> None:
    corners, bound = ODD[name]
    told = certified(*[(n, e, *(up or [400.0 + 0.1 * n])) for n, e, *up in corners])
    assert told.proven is (bound == "")
    assert {bound} - {""} <= set(told.broken)
    if name == "a bend from there":
        assert told.broken == (bound,)
        assert told.turn_radius_m < 0.01
    if name == "straight up":
        assert told.climb_angle_rad == pytest.approx(math.pi / 2)


@pytest.fixture
def cases(request: pytest.FixtureRequest) -> int:
    """How many random curves are looked at."""
    return NIGHTLY_CASES if request.config.getoption("--all") else CASES


def test_random_curves_keep_at_least_what_their_certificates_promise(cases: int) -> None:
    for seed in range(cases):
        case = random_case(np.random.default_rng([9, seed]))
        assert broken_by(case.certificate(), truth(case, samples=100)) == [], seed


def test_random_curves_that_are_safe_by_two_percent_of_the_clearance_are_proven(cases: int) -> None:
    safe = 0
    for seed in range(cases):
        case = random_case(np.random.default_rng([10, seed]))
        spare = 0.02 * (case.task.required_clearance_m - case.task.envelope.contact_m)
        told = case.certificate()
        if case.task.limits.loiter_radius_m:
            continue  # the truth about a circle is that of some of its points only
        hopeless = {"keep-out zone", "turn radius"} & set(told.broken)
        if hopeless or told.clearance_m < 0.5 * case.task.required_clearance_m:
            continue  # spares the search for the truth; what is wrongly hopeless fails above
        real = truth(case, samples=100)
        if (
            real.clearance_m >= case.task.required_clearance_m + spare
            and real.dead_man_m >= case.task.envelope.contact_m + spare
        ):
            safe += 1
            assert not {"terrain clearance", "dead-man reach"} & set(told.broken), seed
    assert safe >= cases // 5
