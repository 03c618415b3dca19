import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import Geod
from scipy.interpolate import RegularGridInterpolator

from vehicle_sim.geodesy import FloatArray, LocalFrame
from vehicle_sim.grid import GridTerrain

WGS84 = Geod(ellps="WGS84")
STEP = (1 / 1200, 1 / 1200)
HALF_M = 3_000.0
PLACES = st.sampled_from([(0.0, 0.0), (36.5, -84.3), (-47.0, 179.99), (62.0, -180.0)])
ROWS, COLUMNS = 100, 160


def random_grid(rng: np.random.Generator, place: tuple[float, float]) -> GridTerrain:
    """Rough ground around the origin: steps of up to 120 m between points of about 90 m."""
    return GridTerrain.of(
        rng.integers(200, 320, (ROWS, COLUMNS)).astype(np.int16),
        north_deg=place[0] + 0.5 * ROWS * STEP[0],
        west_deg=place[1] - 0.5 * COLUMNS * STEP[1],
        step_deg=STEP,
        frame=LocalFrame(latitude_deg=place[0], longitude_deg=place[1]),
        area_m=(-HALF_M, HALF_M, -HALF_M, HALF_M),
    )


@settings(max_examples=15)
@given(seed=st.integers(0, 10**6), place=PLACES)
def test_the_grid_is_bilinear_in_latitude_and_longitude(
    seed: int, place: tuple[float, float]
) -> None:
    rng = np.random.default_rng(seed)
    terrain = random_grid(rng, place)
    north, east = rng.uniform(-HALF_M, HALF_M, (2, 200))
    ones = np.ones(200)
    longitude, latitude, _ = WGS84.fwd(
        place[1] * ones,
        place[0] * ones,
        np.degrees(np.arctan2(east, north)),
        np.hypot(north, east),
    )
    east_deg = (longitude - place[1] + 180.0) % 360.0 - 180.0
    surface = RegularGridInterpolator(
        (
            (np.arange(ROWS) + 1 - 0.5 * ROWS) * STEP[0],
            (np.arange(COLUMNS) - 0.5 * COLUMNS) * STEP[1],
        ),
        terrain.heights_m[::-1].astype(float),
    )
    expected = surface(np.stack([latitude - place[0], east_deg], axis=-1))
    # 1 cm: a way of 250 m between the places of the table bends by 1 mm and slopes are up to 2
    np.testing.assert_allclose(terrain.height_amsl_m(north, east), expected, rtol=0, atol=0.01)
    assert terrain.height_at_amsl_m(north[0], east[0]) == pytest.approx(expected[0], abs=0.01)


def turned_quads(rng: np.random.Generator, size_m: float) -> FloatArray:
    centre, angle = rng.uniform(-2_500, 2_500, (20, 1, 2)), rng.uniform(-0.3, 0.3)
    square = np.array([(-1, -1), (-1, 1), (1, 1), (1, -1)]) * size_m / 2
    turn = np.array([(np.cos(angle), -np.sin(angle)), (np.sin(angle), np.cos(angle))])
    return np.asarray(centre + square @ turn.T)


@settings(max_examples=15)
@given(seed=st.integers(0, 10**6), place=PLACES, size_m=st.sampled_from([19.0, 60.0, 250.0]))
def test_the_highest_of_a_quadrilateral_bounds_what_is_in_it(
    seed: int, place: tuple[float, float], size_m: float
) -> None:
    rng = np.random.default_rng(seed)
    terrain, quads = random_grid(rng, place), turned_quads(rng, size_m)
    highest, at = terrain.highest_in_quads_amsl_m(quads)
    u, v = rng.uniform(0, 1, (2, 4_000))
    shares = np.stack([(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v])
    points = np.einsum("kp,ckx->cpx", shares, quads)
    brute = terrain.height_amsl_m(points[..., 0], points[..., 1]).max(axis=1)
    assert (highest >= brute - 1e-6).all()
    attained = terrain.height_amsl_m(at[:, 0], at[:, 1])
    assert (attained >= brute - 0.1 * size_m).all()
    if size_m == 19.0:
        assert (highest <= attained + 6.0).all()  # 1.7 m from a sample at most, slopes up to 3


@settings(max_examples=20)
@given(seed=st.integers(0, 10**6), place=PLACES)
def test_the_lattice_of_lower_bounds_is_not_above_the_terrain(
    seed: int, place: tuple[float, float]
) -> None:
    rng = np.random.default_rng(seed)
    terrain = random_grid(rng, place)
    start = rng.uniform(-2_500, 1_500, 2)
    north, east = (s + np.arange(0.0, 101.0, 4.0) for s in start)
    lowest = terrain.lowest_in_grid_amsl_m(north, east)
    u, v = rng.uniform(0.0, 4.0, (2, 40))
    brute = terrain.height_amsl_m(
        (north[:-1, None] + u)[:, None, :], (east[:-1, None] + v)[None, :, :]
    ).min(axis=-1)
    assert lowest.shape == (25, 25)
    assert (lowest <= brute + 1e-6).all()
    assert (lowest >= brute - 25.0).all()


def test_beyond_its_edge_the_terrain_goes_on_as_there() -> None:
    terrain = random_grid(np.random.default_rng(1), (36.5, -84.3))
    edge = terrain.height_at_amsl_m(HALF_M, -HALF_M)
    assert terrain.height_at_amsl_m(9e4, -9e4) == edge
