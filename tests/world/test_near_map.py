"""The map of near things, against scenes of which every point is known."""

import math

import numpy as np
import pytest

from companion.geodesy import FloatArray
from companion.world.known_map import Lattice
from companion.world.near_map import (
    FORGOTTEN_AFTER_S,
    LOOKS,
    SIGHTINGS,
    NearMap,
    Sweep,
    cell_for_m,
)

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


def looked(near: NearMap, points: FloatArray, count: int, start_s: float = 0.0,
           error_m: float = 0.1) -> None:  # fmt: skip
    """So many sweeps of 72 sectors of a sensor that stands in the middle."""
    distance = nearest_m(points)
    for k in range(count):
        near.add(sweep_of(distance, time_s=start_s + k * PERIOD_S, error_m=error_m))


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


@pytest.mark.parametrize("seed", range(12))
def test_sectors_between_bearings_are_as_clear_as_the_least_of_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count, share = int(rng.choice([1, 8, 72])), float(rng.choice([0.5, 1.0]))
    sweep = sweep_of(
        rng.uniform(0.0, REACH_M, count),
        width_rad=share * math.tau / count,
        first_rad=rng.uniform(-9.0, 9.0),
    )
    bearing, aside = rng.uniform(-9.0, 9.0, 200), rng.uniform(0.0, 1.05 * math.pi, 200)
    turns = bearing + aside * np.linspace(-1.0, 1.0, 4_001)[:, None]
    sector = np.mod(turns - sweep.first_rad, math.tau) / sweep.width_rad
    ring = np.append(sweep.clear_m, [0.0] if share < 1.0 else [])
    least_m = ring[np.minimum(sector.astype(int), len(ring) - 1)].min(axis=0)
    assert (sweep.clear_between_m(bearing, aside) == least_m).all()


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


def test_what_is_looked_at_stays_free_and_what_is_not_is_unknown_in_time() -> None:
    near = NearMap(LATTICE)
    looked(near, NOTHING, 5)
    at_first = near.free()
    half = np.where(np.arange(72) % 71 < 17, REACH_M, 0.0)  # looks to the north-east only
    later_s = 0.5
    while later_s < near.free_for_s + 2.0:
        near.add(sweep_of(FAR, clear_m=half, time_s=later_s))
        later_s += 0.5
    behind = LATTICE.cell_of(-5.0, -5.0)
    assert near.free()[LATTICE.cell_of(5.0, 5.0)]
    assert at_first[behind]
    assert not near.free()[behind]
    assert not near.closed()[behind]
    looked(near, NOTHING, SIGHTINGS, start_s=later_s)
    np.testing.assert_array_equal(near.free(), at_first)


@pytest.mark.parametrize(("start_s", "later_s"), [(0.0, 8.5), (300.0, 20.0)])
def test_nothing_is_free_for_longer_without_any_sweep(start_s: float, later_s: float) -> None:
    """Nor if the clock begins anew: in the meantime the position may have drifted, too."""
    near = NearMap(LATTICE)
    looked(near, NOTHING, 5, start_s=start_s)
    for at_s, is_free in ((start_s + near.free_for_s, True), (later_s, False)):
        near.changed = None
        near.expire(at_s)
        assert (near.changed is None) == near.free().any() == is_free
    near.changed = None
    near.expire(1_000.0)
    assert near.changed is None


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


def test_all_that_beams_have_passed_is_free_a_wall_is_occupied_and_behind_it_nothing_is_known() -> (
    None
):
    near, blocked, columns = NearMap(LATTICE), NearMap(LATTICE), slice(90, 110)
    looked(near, NOTHING, 2)
    assert not near.free().any()  # not before the third in a row
    looked(near, NOTHING, 1)
    north, east = np.meshgrid(*(np.arange(200) * 0.25 - 25.0 + 0.125,) * 2, indexing="ij")
    away = np.hypot(north, east)
    assert near.free()[away < REACH_M - 0.3].all()
    assert not near.free()[away > REACH_M].any()
    assert not near.occupied().any()
    looked(blocked, wall((5.0, -30.0), (5.0, 30.0)), SIGHTINGS)
    row = LATTICE.cell_of(5.0, 0.0)[0]
    assert blocked.free()[100 : row - 2, columns].all()
    assert blocked.occupied()[row, columns].all()
    assert not blocked.free()[row + 2 :, columns].any()


@pytest.mark.parametrize("times", [1, 100])
def test_what_has_gone_leaves_free_cells_after_more_empty_sweeps_than_sensors_send_wrongly(
    times: int,
) -> None:
    near, cell = NearMap(LATTICE), LATTICE.cell_of(5.5, 0.0)
    looked(near, NOTHING, 20, start_s=8.0 - times * PERIOD_S)  # it was free before
    looked(near, post(6.0, 0.0, 0.5), times, start_s=10.0 - times * PERIOD_S)
    looked(near, NOTHING, 9, start_s=10.0)
    assert near.occupied()[cell]
    assert not near.free()[cell]
    looked(near, NOTHING, 3, start_s=10.9)
    assert not near.occupied().any()
    assert near.free()[cell]


@pytest.mark.parametrize(("standing_s", "is_remembered"), [(1.0, False), (4.0, True)])
def test_what_was_met_for_a_moment_only_is_forgotten_and_unknown(
    standing_s: float, *, is_remembered: bool
) -> None:
    near, cell = NearMap(LATTICE), LATTICE.cell_of(5.5, 0.0)
    looked(near, post(6.0, 0.0, 0.5), round(standing_s / PERIOD_S) + 1)
    later_s = standing_s + FORGOTTEN_AFTER_S + 1.0
    near.add(sweep_of(FAR, clear_m=np.zeros(72), time_s=later_s))  # says nothing
    assert near.occupied()[cell] == is_remembered
    assert not near.free()[cell]


@pytest.mark.parametrize("seed", range(6))
def test_an_echo_is_somewhere_across_its_sector_as_far_as_its_error_lets_it_be(seed: int) -> None:
    """All cells with a point well inside of that are met, and none that is a cell away."""
    rng, near = np.random.default_rng(seed), NearMap(LATTICE)
    echo_m, error_m, width = rng.uniform(3.0, 15.0), rng.uniform(0.0, 0.9), math.tau / 24
    first_rad, at = rng.uniform(-9.0, 9.0), rng.uniform(-2.0, 2.0, 2)
    told = {"first_rad": first_rad, "width_rad": width, "sensor_ne_m": tuple(at.tolist())}
    near.add(sweep_of(np.array([echo_m]), error_m=error_m, **told))
    away = np.linspace(echo_m - error_m, echo_m + error_m, 60)[:, None]
    turn = first_rad + np.linspace(0.0, width, 400)
    points = (at + np.stack([away * np.cos(turn), away * np.sin(turn)], axis=-1)).reshape(-1, 2)
    inner = points.reshape(60, 400, 2)[5:-5, 20:-20].reshape(-1, 2)
    rows, columns = np.floor((inner + 25.0) / LATTICE.cell_m).astype(int).T
    assert near.occupied()[rows, columns].all()
    middles = (np.argwhere(near.occupied()) + 0.5) * LATTICE.cell_m - 25.0
    gap_m = np.hypot(*(middles[:, None] - points).T).min(axis=0)
    assert (gap_m <= LATTICE.cell_m).all()


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


@pytest.mark.parametrize("seed", range(8))
def test_the_gap_of_a_point_is_that_to_the_nearest_cell_where_something_stands(seed: int) -> None:
    rng, near = np.random.default_rng(seed), NearMap(LATTICE)
    cells, within_m = rng.integers(0, 200, (int(rng.integers(0, 9)), 2)), float(rng.uniform(1, 60))
    near.met_since_s[tuple(cells.T)] = 1.0
    points = rng.uniform(-24.0, 24.0, (5, 2))
    low = cells * LATTICE.cell_m - 25.0
    over = np.maximum(low - points[:, None], points[:, None] - low - LATTICE.cell_m)
    truth_m = np.hypot(*np.moveaxis(np.maximum(over, 0.0), -1, 0)).min(axis=1, initial=math.inf)
    told_m = near.gaps_m(points, within_m)
    assert told_m[truth_m <= within_m] == pytest.approx(truth_m[truth_m <= within_m])
    assert (told_m[truth_m > within_m] > within_m).all()


@pytest.mark.parametrize(("range_m", "side_m", "cell_m"), [
    (16.0, 400.0, 0.25), (16.0, 4_000.0, 2.0), (256.0, 4_000.0, 4.0), (64.0, 0.0, 1.0),
])  # fmt: skip
def test_cells_are_a_64th_of_the_range_but_no_more_than_four_million(
    range_m: float, side_m: float, cell_m: float
) -> None:
    north_m, east_m = (-0.5 * side_m, 0.5 * side_m), (3.0, 3.0 + side_m)
    assert cell_for_m(range_m, north_m, east_m) == pytest.approx(cell_m)
