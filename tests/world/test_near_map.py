"""The map of near things, against scenes of which every point is known."""

import math

import numpy as np
import pytest

from companion.geodesy import FloatArray
from companion.world.known_map import Lattice
from companion.world.near_map import LOOKS, SIGHTINGS, NearMap, Sweep, cell_for_m

LATTICE = Lattice(cell_m=0.25, north_min_m=-25.0, east_min_m=-25.0, shape=(200, 200))
REACH_M, PERIOD_S = 16.0, 0.1
NOTHING: FloatArray = np.full((1, 2), 100.0)
"""No thing near by."""
FAR = np.full(72, np.inf)
"""What 72 sectors meet of nothing."""


def post(north_m: float, east_m: float, radius_m: float) -> FloatArray:
    """Points of its surface, (M, 2), no more than 2 cm apart."""
    turn = np.linspace(0.0, math.tau, math.ceil(math.tau * radius_m / 0.02) + 1)
    return np.stack([north_m + radius_m * np.cos(turn), east_m + radius_m * np.sin(turn)], axis=1)


def wall(a: tuple[float, float], b: tuple[float, float]) -> FloatArray:
    """Points of it, (M, 2), no more than 2 cm apart."""
    share = np.linspace(0.0, 1.0, math.ceil(math.dist(a, b) / 0.02) + 1)[:, None]
    return np.array(a) * (1.0 - share) + np.array(b) * share


def scene(random: np.random.Generator) -> FloatArray:
    """Posts and walls, none about the middle, where the sensor is."""
    things = [
        post(*random.uniform(-22.0, 22.0, 2), random.uniform(0.02, 1.5))
        for _ in range(random.integers(0, 25))
    ]
    for _ in range(random.integers(0, 4)):
        start = random.uniform(-20.0, 20.0, 2)
        things.append(wall(tuple(start), tuple(start + random.uniform(-15.0, 15.0, 2))))
    points = np.concatenate([*things, NOTHING])
    return points[np.hypot(*points.T) > 3.0]


def nearest_m(
    points: FloatArray, sectors: int = 72, width_rad: float | None = None,
    first_rad: float = 0.0, at_ne_m: FloatArray | float = 0.0,
) -> FloatArray:  # fmt: skip
    """Distance of the nearest point in each sector, all round; inf: none in reach.  (K,)."""
    apart = points - at_ne_m
    away, turn = np.hypot(*apart.T), np.arctan2(apart[:, 1], apart[:, 0]) - first_rad
    sector = np.floor(np.mod(turn, math.tau) / (width_rad or math.tau / sectors)).astype(int)
    result = np.full(sectors, np.inf)
    inside = (away <= REACH_M) & (sector < sectors)
    np.minimum.at(result, sector[inside], away[inside])
    return result


def sweep_of(distance_m: FloatArray, **what: object) -> Sweep:
    """What a sensor says that meets these."""
    met = np.isfinite(distance_m)
    values = {
        "time_s": 0.0, "sensor_ne_m": (0.0, 0.0), "first_rad": 0.0,
        "width_rad": math.tau / len(distance_m), "clear_m": np.where(met, distance_m, REACH_M),
        "echo_m": distance_m, "range_m": REACH_M, "blind_m": 0.2, "error_m": 0.1,
        "bearing_error_rad": 0.0,
    }  # fmt: skip
    return Sweep(**{**values, **what})  # type: ignore[arg-type]


def looked(near: NearMap, points: FloatArray | None, count: int, start_s: float = 0.0,
           error_m: float = 0.1) -> None:  # fmt: skip
    """So many sweeps of 72 sectors of a sensor that stands in the middle; None: it says nothing."""
    distance = FAR if points is None else nearest_m(points)
    says = {"clear_m": np.zeros(72)} if points is None else {}
    for k in range(count):
        near.add(sweep_of(distance, time_s=start_s + k * PERIOD_S, error_m=error_m, **says))


def wrongly_free(near: NearMap, points: FloatArray) -> int:
    """How many points of things lie in free cells."""
    low = np.array([LATTICE.north_min_m, LATTICE.east_min_m])
    cells = np.floor((points - low) / LATTICE.cell_m).astype(int)
    cells = cells[((cells >= 0) & (cells < LATTICE.shape)).all(axis=1)]
    return int(near.free()[cells[:, 0], cells[:, 1]].sum())


def flown(seed: int) -> tuple[NearMap, FloatArray]:
    """A random scene, and what a sensor of random make, with all its faults, shows of it."""
    random = np.random.default_rng(seed)
    points = scene(random)
    sectors = int(random.choice([8, 24, 72, 90, 360]))
    width, seen = math.tau / sectors, sectors
    if random.random() >= 0.7:
        seen = max(sectors // 3, 1)
    error_m, bearing_error = random.uniform(0.0, 0.5), random.uniform(0.0, 0.06)
    lost, dust = random.uniform(0.0, 0.3), random.uniform(0.0, 0.05)
    speed, turning = random.uniform(-1.0, 1.0, 2), random.uniform(-2.0, 2.0)
    near = NearMap(LATTICE)
    for k in range(int(random.integers(4, 40))):
        at, yaw = speed * k * PERIOD_S, turning * k * PERIOD_S
        distance = nearest_m(points, seen, width, yaw, at)
        if k % SIGHTINGS:  # else each thing would be missed as often as it must not be
            distance[random.random(seen) < lost] = np.inf
        told_at = at + 0.5 * error_m * random.uniform(-0.7, 0.7, 2)
        noisy = np.maximum(distance + 0.5 * error_m * random.uniform(-1.0, 1.0, seen), 0.0)
        dusty = random.random(seen) < dust
        noisy[dusty] = random.uniform(0.0, np.minimum(noisy[dusty], REACH_M))
        first_rad = yaw + bearing_error * random.uniform(-1.0, 1.0)
        near.add(
            sweep_of(
                noisy, time_s=k * PERIOD_S, sensor_ne_m=tuple(told_at.tolist()),
                first_rad=first_rad, width_rad=width, error_m=error_m,
                bearing_error_rad=bearing_error,
            )
        )  # fmt: skip
    return near, points


@pytest.mark.parametrize(
    "part", [0, *(pytest.param(k, marks=pytest.mark.nightly) for k in range(1, 500))]
)
def test_what_is_free_holds_no_point_of_any_thing_and_is_not_closed(part: int) -> None:
    free = 0
    for seed in range(20 * part, 20 * part + 20):
        near, points = flown(seed)
        assert wrongly_free(near, points) == 0, seed
        free += int(near.free().sum())
        closed, window = near.closed(), (slice(20, 90), slice(50, 130))
        assert not (closed & near.free()).any()
        assert not (near.occupied() & near.sharp & ~closed).any()
        np.testing.assert_array_equal(near.closed(window), closed[window])
    assert free > 20_000  # it says something


@pytest.mark.parametrize(("sectors", "drift_m_s"), [(8, 0.05), (72, 0.02)])
def test_a_post_that_is_watched_while_the_position_drifts_is_never_in_free_cells(
    sectors: int, drift_m_s: float
) -> None:
    """The vehicle stands still, and thinks that it wanders away from the post."""
    near, thing = NearMap(LATTICE), post(6.0, 0.0, 0.25)
    distance = nearest_m(thing, sectors)
    for k in range(150):
        told = (-drift_m_s * 0.4 * k, 0.0)
        near.add(sweep_of(distance, time_s=0.4 * k, sensor_ne_m=told, error_m=0.35))
        if k % 25 == 24:
            assert wrongly_free(near, thing + np.array(told)) == 0, k


SHOWN = {
    "nothing": NOTHING, "a post": post(6.0, 0.0, 0.5), "a wall": wall((5.5, -30.0), (5.5, 30.0)),
    "says nothing": None,
}  # fmt: skip


@pytest.mark.parametrize(("story", "state"), [
    ("2 nothing", "unknown"), ("3 nothing", "free"),
    ("5 nothing, 74 says nothing", "free"), ("5 nothing, 80 says nothing", "unknown"),  # 7.5 s
    ("5 nothing, 80 says nothing, 2 nothing", "unknown"),
    # sensors send wrong empty sweeps for up to 0.9 s
    ("20 nothing, 1 a post", "occupied"), ("20 nothing, 1 a post, 9 nothing", "occupied"),
    ("20 nothing, 1 a post, 12 nothing", "free"),
    ("20 nothing, 100 a post, 9 nothing", "occupied"),
    ("20 nothing, 100 a post, 12 nothing", "free"),
    # what was met for a moment only is forgotten, what stands there is not
    ("11 a post, 590 says nothing", "occupied"), ("11 a post, 610 says nothing", "unknown"),
    ("41 a post, 610 says nothing", "occupied"),
    ("3 a wall", "occupied"), ("3 a wall", "free before it"), ("3 a wall", "unknown behind it"),
])  # fmt: skip
def test_a_cell_is_free_occupied_or_unknown_by_what_ten_sweeps_a_second_have_shown(
    story: str, state: str
) -> None:
    near, count = NearMap(LATTICE), 0
    for part in story.split(", "):
        sweeps, _, what = part.partition(" ")
        looked(near, SHOWN[what], int(sweeps), start_s=PERIOD_S * count)
        count += int(sweeps)
    state, _, where = state.partition(" ")
    cell = LATTICE.cell_of({"before it": 4.5, "behind it": 6.5}.get(where, 5.5), 0.0)
    assert (near.free()[cell], near.occupied()[cell]) == (state == "free", state == "occupied")


def test_nothing_stays_free_without_a_sweep_nor_when_the_clock_begins_anew() -> None:
    """In the meantime the position may have drifted, too."""
    for start_s, later_s in ((0.0, 8.5), (300.0, 20.0)):
        near = NearMap(LATTICE)
        looked(near, NOTHING, 5, start_s=start_s)
        for at_s, is_free in ((start_s + near.free_for_s, True), (later_s, False), (1e3, False)):
            near.changed = None
            near.expire(at_s)
            assert near.free().any() == is_free
            assert (near.changed is not None) == (at_s == later_s)


def test_a_scan_tells_all_that_is_known_where_something_may_have_changed_and_tells_it_once() -> (
    None
):
    near, ground = NearMap(LATTICE), np.full(LATTICE.shape, 7.0)
    for k in range(SIGHTINGS):
        for at in ((-5.0, -6.0), (6.0, 5.0)):
            near.add(sweep_of(FAR, sensor_ne_m=at, time_s=k * PERIOD_S))
    near.add(sweep_of(nearest_m(post(2.0, 3.0, 0.5))))
    scan, again = near.scan(ground, 50.0), near.scan(ground, 50.0)
    heights = np.full(LATTICE.shape, np.nan)
    heights[scan.window] = scan.heights_m
    free, closed = near.free(), near.closed()
    assert free.any()
    assert closed.any()
    np.testing.assert_array_equal(heights, np.where(closed, 50.0, np.where(free, ground, np.nan)))
    assert (scan.supersedes, again.supersedes, again.heights_m.size) == (True, False, 0)
    for window in ((slice(3, 9), slice(100, 120)), (slice(5, 30), slice(90, 101))):
        near.tell_again(window)  # nobody has taken it
    once_more = near.scan(ground, 50.0)
    assert (once_more.row, once_more.column, *once_more.heights_m.shape) == (3, 90, 27, 30)
    np.testing.assert_array_equal(once_more.heights_m, heights[3:30, 90:120])


def test_an_echo_that_stays_in_free_cells_counts_there_whatever_lies_behind_it() -> None:
    """A wall was free up to, and something new stands before it, nearer than the error."""
    near, barrier, new = NearMap(LATTICE), wall((6.5, -30.0), (6.5, 30.0)), post(5.85, 0.0, 0.05)
    looked(near, barrier, 5, error_m=0.05)
    assert wrongly_free(near, new) > 0
    looked(near, np.concatenate([barrier, new]), SIGHTINGS, start_s=1.0, error_m=0.5)
    assert wrongly_free(near, new[np.hypot(*new.T) < 5.82]) == 0


def test_closed_is_where_something_stands_and_where_no_beam_comes_through() -> None:
    """A gap too narrow for a beam is closed once it was looked at for long; what is far is open."""
    near, posts = NearMap(LATTICE), np.concatenate([post(4.0, e, 0.1) for e in (-0.2, 0.2)])
    assert not near.closed().any()
    looked(near, posts, LOOKS - 1)
    np.testing.assert_array_equal(near.closed(), near.occupied())
    looked(near, posts, 1, start_s=5.0)
    closed = near.closed()
    # posts, and a gap that no sector clears; what is free, and what is behind and far
    for place, is_closed in (
        ((4.0, -0.2), True), ((4.0, 0.2), True), ((3.8, 0.0), True), ((2.0, 0.0), False),
        ((12.0, 0.0), False),
    ):  # fmt: skip
        assert closed[LATTICE.cell_of(*place)] == is_closed


@pytest.mark.parametrize(("range_m", "side_m", "cell_m"), [
    (16.0, 400.0, 0.25), (16.0, 4_000.0, 2.0), (256.0, 4_000.0, 4.0), (64.0, 0.0, 1.0),
])  # fmt: skip
def test_cells_are_a_64th_of_the_range_but_no_more_than_four_million(
    range_m: float, side_m: float, cell_m: float
) -> None:
    north_m, east_m = (-0.5 * side_m, 0.5 * side_m), (3.0, 3.0 + side_m)
    assert cell_for_m(range_m, north_m, east_m) == pytest.approx(cell_m)
