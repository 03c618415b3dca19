import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse.csgraph import connected_components

from companion.paper.guide import tangent_guide_rad
from companion.world.radars import Radar

Place = tuple[float, float]


def radar(north: float, east: float, range_m: float) -> Radar:
    return Radar(name=f"{north:.0f}/{east:.0f}", centre_nea_m=(north, east, 0.0), range_m=range_m)


def tangent_bearings(s: Place, r: Radar) -> list[float]:
    """Bearings of the two tangent points: where the circle meets Thales' circle over S and O."""
    s_, o = complex(*s), complex(*r.centre_nea_m[:2])
    d = abs(o - s_)
    towards_s = (s_ - o) / d
    along = r.range_m / d
    aside = math.sqrt(1.0 - along**2)
    points = [o + r.range_m * towards_s * complex(along, side * aside) for side in (1, -1)]
    return [math.atan2((p - s_).imag, (p - s_).real) for p in points]


def turned(a: float, b: float) -> float:
    """The angle from b to a, in -pi to pi."""
    return math.atan2(math.sin(a - b), math.cos(a - b))


def brute_force_guide(s: Place, t: Place, radars: list[Radar], overlap_m: float) -> float:
    """Section 2.6 by sampling S-T, a graph of overlaps and Thales' tangent points."""
    straight = math.atan2(t[1] - s[1], t[0] - s[0])
    along = np.linspace(0.0, 1.0, 20_001)
    n, e = s[0] + along * (t[0] - s[0]), s[1] + along * (t[1] - s[1])
    centres = np.array([r.centre_nea_m[:2] for r in radars])
    ranges = np.array([r.range_m for r in radars])
    inside = np.hypot(n - centres[:, :1], e - centres[:, 1:]) < ranges[:, None]
    around = np.hypot(*(centres - s).T) > ranges
    inside &= around[:, None]
    if not inside.any():
        return straight
    first = np.where(inside.any(axis=1), inside.argmax(axis=1), 10**9).argmin()
    apart = np.hypot(*(centres[:, None] - centres[None]).T)
    joined = apart < ranges[:, None] + ranges[None, :] - overlap_m
    joined &= around[:, None] & around[None, :]
    _, label = connected_components(joined, directed=False)
    offsets = [
        turned(bearing, straight)
        for k in np.flatnonzero(label == label[first])
        for bearing in tangent_bearings(s, radars[k])
    ]
    left, right = np.clip([min(offsets), max(offsets)], *np.radians([-135.0, 135.0]))
    return straight + (left if abs(left) < abs(right) else right)


@pytest.mark.parametrize("off_m", [-100.0, -0.01, 0.01, 100.0])
def test_circles_count_as_one_from_an_overlap_of_more_than_d_overlap_on(off_m: float) -> None:
    """The paper's Fig. 2: SN round both circles, or SC between them."""
    o1, apart = radar(50_000.0, -1_000.0, 10_000.0), 10_000.0 + 12_000.0 - 2_000.0 + off_m
    o2 = radar(50_000.0, -1_000.0 + apart, 12_000.0)
    s, t = (0.0, 0.0), (100_000.0, 0.0)
    outer, alone = sorted(tangent_bearings(s, o1))
    assert outer < 0.0 < alone < -outer
    found = tangent_guide_rad(s, t, (o1, o2), 2_000.0)
    assert found == pytest.approx(outer if off_m < 0.0 else alone)
    beside = radar(50_000.0, 10_000.0 + 0.001 * off_m, 10_000.0)  # the line misses it, or not
    assert (tangent_guide_rad(s, t, (beside,), 2_000.0) == 0.0) == (off_m > 0.0)


@given(
    seed=st.integers(0, 10**6),
    overlap_m=st.sampled_from([0.0, 2_000.0, 6_000.0]),
    turn=st.floats(-3.1, 3.1),
)
def test_the_guide_is_that_of_section_2_6_by_brute_force(
    seed: int, overlap_m: float, turn: float
) -> None:
    rng, way = np.random.default_rng(seed), complex(math.cos(turn), math.sin(turn))

    def place(north: float, east: float) -> Place:
        return (complex(north, east) * way).real, (complex(north, east) * way).imag

    # some about S, some behind it, some beyond T
    around = zip(rng.uniform(-15e3, 115e3, 5), rng.uniform(-30e3, 30e3, 5), strict=True)
    radars = [radar(*place(*at), rng.uniform(3_000, 12_000)) for at in around]
    s, t = place(0.0, rng.uniform(-5e3, 5e3)), place(100e3, rng.uniform(-5e3, 5e3))
    expected = brute_force_guide(s, t, radars, overlap_m)
    found = tangent_guide_rad(s, t, radars, overlap_m)
    assert turned(found, expected) == pytest.approx(0.0, abs=1e-9)
