import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vehicle_sim.terrain import Combine, PeakRow, PeakTerrain


def random_peaks(rng: np.random.Generator) -> list[PeakRow]:
    return [
        (
            float(rng.uniform(-5e3, 5e3)),
            float(rng.uniform(-5e3, 5e3)),
            float(rng.uniform(100, 3000)),
            float(rng.uniform(300, 3000)),
            float(rng.uniform(300, 3000)),
        )
        for _ in range(int(rng.integers(0, 8)))
    ]


def test_a_single_peak_is_equation_1_over_the_ground() -> None:
    terrain = PeakTerrain(
        [(1000.0, 2000.0, 900.0, 300.0, 500.0)], combine="maximum", ground_amsl_m=100.0
    )
    assert terrain.height_at_amsl_m(1000.0, 2000.0) == 900.0
    assert terrain.height_at_amsl_m(1300.0, 2000.0) == pytest.approx(900.0 / np.e)
    assert terrain.height_at_amsl_m(1000.0, 2500.0) == pytest.approx(900.0 / np.e)
    assert terrain.height_at_amsl_m(9000.0, 9000.0) == 100.0
    for combine, top_m in (("maximum", 400.0), ("sum", 800.0)):
        twice = PeakTerrain([(0, 0, 400, 9, 9)] * 2, combine=combine, ground_amsl_m=0.0)
        assert twice.height_at_amsl_m(0.0, 0.0) == top_m


def turned_quad(rng: np.random.Generator, size_m: float, near: PeakRow | None = None) -> np.ndarray:
    """Anywhere, or with the top of a peak in it or just outside."""
    centre, angle = rng.uniform(-5e3, 5e3, 2), rng.uniform(-0.3, 0.3)
    if near is not None:
        centre = np.array(near[:2]) + rng.uniform(-0.6, 0.6, 2) * size_m
    square = np.array([(-1, -1), (-1, 1), (1, 1), (1, -1)]) * size_m / 2
    turn = np.array([(np.cos(angle), -np.sin(angle)), (np.sin(angle), np.cos(angle))])
    return centre + square @ turn.T


@settings(max_examples=20)
@given(seed=st.integers(0, 10**6), combine=st.sampled_from(["maximum", "sum"]))
def test_the_highest_point_of_a_quadrilateral_bounds_samples_and_is_attained(
    seed: int, combine: Combine
) -> None:
    rng = np.random.default_rng(seed)
    peaks = random_peaks(rng)
    terrain = PeakTerrain(peaks, combine=combine, ground_amsl_m=50.0)
    places = [*[None] * 10, *peaks]
    quads = np.stack([turned_quad(rng, 400.0, near) for near in places])
    highest, place = terrain.highest_in_quads_amsl_m(quads)
    u, v = np.meshgrid(np.linspace(0, 1, 41), np.linspace(0, 1, 41))
    a, b, c, d = (quads[:, k, None, None] for k in range(4))
    samples = (
        a * ((1 - u) * (1 - v))[None, ..., None]
        + b * ((1 - u) * v)[None, ..., None]
        + c * (u * v)[None, ..., None]
        + d * (u * (1 - v))[None, ..., None]
    )
    brute = terrain.height_amsl_m(samples[..., 0], samples[..., 1]).max(axis=(1, 2))
    assert np.all(highest >= brute - 1e-9)
    if combine == "maximum":
        attained = terrain.height_amsl_m(place[:, 0], place[:, 1])
        np.testing.assert_allclose(attained, highest, rtol=1e-12)
        assert np.all(highest <= brute + 30.0)  # 10 m between samples, slopes up to about 3


@settings(max_examples=20)
@given(seed=st.integers(0, 10**6), combine=st.sampled_from(["maximum", "sum"]))
def test_the_grid_bounds_the_terrain_from_below(seed: int, combine: Combine) -> None:
    rng = np.random.default_rng(seed)
    terrain = PeakTerrain(random_peaks(rng), combine=combine, ground_amsl_m=50.0)
    north, east = np.arange(-5e3, 5e3 + 1, 500.0), np.arange(-5e3, 5e3 + 1, 500.0)
    lowest = terrain.lowest_in_grid_amsl_m(north, east)
    low_n, low_e = (axis.ravel() for axis in np.meshgrid(north[:-1], east[:-1], indexing="ij"))
    u = np.linspace(0, 500, 21)
    brute = terrain.height_amsl_m(
        (low_n[:, None] + u)[:, :, None], (low_e[:, None] + u)[:, None, :]
    )
    assert np.all(lowest.ravel() <= brute.min(axis=(1, 2)) + 1e-9)
