"""The terrain radar against brute force: every sample of a cell, every metre of a line of sight.

A cell may be called hidden only if it is (nothing is ever hidden that is in sight), and what is
called seen although it is hidden lies so little behind a ridge that the ridge hardly hides it.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from pyproj import Geod

from vehicle_sim.geodesy import LocalFrame
from vehicle_sim.sensors.terrain_radar import UNSEEN_M, ScanRequest, TerrainRadar, Viewpoint
from vehicle_sim.terrain import PeakRow, PeakTerrain, Terrain
from vehicle_sim.world import read_world

FloatArray = NDArray[np.float64]
Height = Callable[[FloatArray, FloatArray], FloatArray]
WGS84 = Geod(ellps="WGS84")
FRAME = LocalFrame(latitude_deg=47.0, longitude_deg=8.0)
ALL_BLOCKS = (1 << 56) - 1
RANGE_M = 4000.0
FAR = (9e4, 9e4)
"""A corner of the map, where true north and the local frame's north differ."""


def peaks(
    rng: np.random.Generator, number: tuple[int, int], centre_ne_m: tuple[float, float]
) -> list[PeakRow]:
    """North, east, height and two spreads."""
    places = ((centre_m - 4e3, centre_m + 4e3) for centre_m in centre_ne_m)
    low, high = zip(*places, *[(200.0, 1500.0)] * 3, strict=True)
    return [tuple(rng.uniform(low, high).tolist()) for _ in range(int(rng.integers(*number)))]


def hills(rng: np.random.Generator, centre_ne_m: tuple[float, float]) -> PeakTerrain:
    return PeakTerrain(peaks(rng, (1, 8), centre_ne_m), combine="maximum", ground_amsl_m=100.0)


def viewpoint(
    centre_ne_m: tuple[float, float], altitude_amsl_m: float, *, frame: LocalFrame = FRAME
) -> Viewpoint:
    latitude_deg, longitude_deg = frame.to_geographic(*centre_ne_m)
    return Viewpoint(
        latitude_deg=latitude_deg, longitude_deg=longitude_deg, altitude_amsl_m=altitude_amsl_m
    )


def request_about(
    centre_ne_m: tuple[float, float],
    spacing_m: int,
    mask: int = ALL_BLOCKS,
    *,
    frame: LocalFrame = FRAME,
) -> ScanRequest:
    north_m, east_m = centre_ne_m
    corner = frame.to_geographic(north_m - 14 * spacing_m, east_m - 16 * spacing_m)
    return ScanRequest(
        latitude_deg=round(corner[0], 7),
        longitude_deg=round(corner[1], 7),
        spacing_m=spacing_m,
        mask=mask,
    )


def to_local(request: ScanRequest, a_m: FloatArray, b_m: FloatArray) -> tuple[FloatArray, ...]:
    """Metres true north and east of the corner -> the world's frame, by geodesics."""
    ones = np.ones_like(a_m)
    lon, lat, _ = WGS84.fwd(
        request.longitude_deg * ones,
        request.latitude_deg * ones,
        np.degrees(np.arctan2(b_m, a_m)),
        np.hypot(a_m, b_m),
    )
    azimuth, _, distance = WGS84.inv(8.0 * ones, 47.0 * ones, lon, lat)
    return distance * np.cos(np.radians(azimuth)), distance * np.sin(np.radians(azimuth))


def cells(radar: TerrainRadar, request: ScanRequest, view: Viewpoint) -> NDArray[np.int64]:
    """The answer as an array by cell (28 north, 32 east), put together by the definition."""
    grid = np.full((28, 32), 99999, dtype=np.int64)
    for block in radar.answer(request, view):
        row, column = divmod(block.gridbit, 8)
        for x in range(4):
            for y in range(4):
                grid[4 * row + x, 4 * column + y] = block.heights_amsl_m[4 * x + y]
    return grid


@settings(max_examples=3)
@given(seed=st.integers(0, 10**6), far=st.booleans())
def test_a_seen_cell_is_its_highest_terrain_rounded_up(seed: int, *, far: bool) -> None:
    rng = np.random.default_rng(seed)
    centre = FAR if far else (0.0, 0.0)
    terrain = hills(rng, centre)
    radar = TerrainRadar(terrain, FRAME, range_m=RANGE_M)
    request = request_about(centre, 60)
    got = cells(radar, request, viewpoint(centre, 9000.0))  # from so high everything is in sight
    step = np.linspace(0, 60, 13)
    i, j = np.meshgrid(np.arange(28), np.arange(32), indexing="ij")
    a = i[..., None, None] * 60 + step[:, None] + 0 * step
    b = j[..., None, None] * 60 + step[:, None] * 0 + step
    north, east = to_local(request, a.ravel(), b.ravel())
    brute = terrain.height_amsl_m(north, east).reshape(28, 32, -1).max(axis=-1)
    assert not np.any(got == UNSEEN_M)
    assert np.all(got >= brute - 1e-6)
    assert np.all(got <= brute + 1.0 + 25.0)  # 5 m between samples, slopes up to about 7
    assert np.mean(got <= brute + 2.0) > 0.5  # and mostly not more than the rounding


@pytest.mark.parametrize("centre", [(0.0, 0.0), FAR])
def test_what_is_out_of_range_is_unseen(centre: tuple[float, float]) -> None:
    radar = TerrainRadar(hills(np.random.default_rng(1), centre), FRAME, range_m=RANGE_M)
    request = request_about(centre, 250)
    got = cells(radar, request, viewpoint(centre, 9000.0))
    i, j = (axis.ravel() for axis in np.meshgrid(np.arange(28), np.arange(32), indexing="ij"))
    middle_n, middle_e = to_local(request, (i + 0.5) * 250.0, (j + 0.5) * 250.0)
    distance = np.hypot(middle_n - centre[0], middle_e - centre[1])
    unseen = got.ravel() == UNSEEN_M
    assert np.all(unseen[distance > RANGE_M + 1.0])
    assert not np.any(unseen[distance < RANGE_M - 200.0])


@pytest.mark.parametrize("eye_m", [3.0, 10.0, 25.0])
def test_the_horizon_is_where_the_earth_curves_away(eye_m: float) -> None:
    """At R acos(R / (R + h)), and of a mast by as much farther as its own horizon is away."""
    mast_m, earth_m, spread_m = 12.0, 6_371_000.0, 400.0
    far_m = earth_m * math.acos(earth_m / (earth_m + eye_m))
    beyond_m = far_m + earth_m * math.acos(earth_m / (earth_m + mast_m))
    ways = ((1.0, 0.0), (-0.6, 0.8))
    for share, seen in ((0.97, True), (1.05, False)):
        masts = [
            (share * beyond_m * n, share * beyond_m * e, mast_m, spread_m, 400.0) for n, e in ways
        ]
        for peaks, away_m in (([], share * far_m), (masts, share * beyond_m)):
            terrain = PeakTerrain(peaks, combine="maximum", ground_amsl_m=0.0)
            radar = TerrainRadar(terrain, FRAME, range_m=5e4)
            for north, east in ways:
                at = FRAME.to_geographic(away_m * north, away_m * east)
                asked = ScanRequest(latitude_deg=at[0], longitude_deg=at[1], spacing_m=1, mask=1)
                (block,) = radar.answer(asked, viewpoint((0.0, 0.0), eye_m))
                assert (block.heights_amsl_m[0] != UNSEEN_M) == seen


@given(mask=st.integers(0, ALL_BLOCKS))
@settings(max_examples=10)
def test_the_mask_picks_blocks_and_changes_nothing_in_them(mask: int) -> None:
    terrain = hills(np.random.default_rng(1), (0.0, 0.0))
    radar, view = TerrainRadar(terrain, FRAME, range_m=RANGE_M), viewpoint((0.0, 0.0), 1000.0)
    every = {b.gridbit: b for b in radar.answer(request_about((0.0, 0.0), 100), view)}
    picked = radar.answer(request_about((0.0, 0.0), 100, mask), view)
    assert [b.gridbit for b in picked] == [bit for bit in range(56) if mask >> bit & 1]
    assert all(every[b.gridbit] == b for b in picked)


@pytest.mark.parametrize(("spacing_m", "latitude_deg"), [(0, 47.0), (100, 91.0), (100, -214.0)])
def test_nonsense_is_answered_with_nothing(spacing_m: int, latitude_deg: float) -> None:
    radar = TerrainRadar(hills(np.random.default_rng(2), (0.0, 0.0)), FRAME, range_m=RANGE_M)
    request = ScanRequest(
        latitude_deg=latitude_deg, longitude_deg=8.0, spacing_m=spacing_m, mask=ALL_BLOCKS
    )
    assert radar.answer(request, viewpoint((0.0, 0.0), 1000.0)) == ()


def test_cells_the_size_of_a_country_are_survived() -> None:
    radar = TerrainRadar(hills(np.random.default_rng(2), (0.0, 0.0)), FRAME, range_m=RANGE_M)
    got = cells(radar, request_about((0.0, 0.0), 65535), viewpoint((0.0, 0.0), 1000.0))
    assert np.all((got == UNSEEN_M) | (got >= 100))


# --- what is hidden: rays marched over the true ground in small steps -----------------------------

VALLEY = Path(__file__).parents[2] / "companion" / "environments" / "valley" / "world.toml"
EARTH_M = 6_371_009.0
STEPS = 400
"""Of a ray."""


def marched(height: Height, eye: tuple[float, float, float], points_ne_m: FloatArray) -> FloatArray:
    """How far the ground rises above the line from the eye to each point.  (K, 2) -> (K,).

    The line is straight in the space about a sphere of radius R: between two points at distances
    r1 and r2 from its middle, 1 / r goes with the sines of the angles to them.
    """
    most = np.empty(len(points_ne_m))
    share = ((np.arange(STEPS) + 0.5) / STEPS)[:, None]
    for start in range(0, len(points_ne_m), 256):
        north, east = points_ne_m[start : start + 256].T
        top = height(north, east)
        ground = height(eye[0] + share * (north - eye[0]), eye[1] + share * (east - eye[1]))
        angle = np.hypot(north - eye[0], east - eye[1]) / EARTH_M
        over = np.sin((1.0 - share) * angle) / (EARTH_M + eye[2])
        over += np.sin(share * angle) / (EARTH_M + top)
        line = np.sin(angle) / over - EARTH_M
        most[start : start + 256] = (ground - line).max(axis=0)
    return most


def check(
    terrain: Terrain,
    height: Height,
    frame: LocalFrame,
    eye: tuple[float, float, float],
    *,
    range_m: float,
    spacing_m: int,
    steepest: float,
) -> bool:
    """Hold what is called hidden to the rays; returns whether any cell in range is."""
    request = request_about(eye[:2], spacing_m, frame=frame)
    view = viewpoint(eye[:2], eye[2], frame=frame)
    hidden = cells(TerrainRadar(terrain, frame, range_m=range_m), request, view) == UNSEEN_M
    # corners, middles of the sides and the middle of every cell, as the message defines them
    at = np.arange(3) * 0.5 * spacing_m
    north = (np.arange(28) * spacing_m)[:, None, None, None] + at[:, None]
    east = (np.arange(32) * spacing_m)[None, :, None, None] + at[None, :]
    own = LocalFrame(latitude_deg=request.latitude_deg, longitude_deg=request.longitude_deg)
    ravelled = (x.ravel() for x in np.broadcast_arrays(north, east))
    points = np.stack(frame.to_local_many(*own.to_geographic_many(*ravelled)), axis=-1)
    covered_m = marched(height, eye, points).reshape(28, 32, 9).min(axis=-1)
    middle = points.reshape(28, 32, 9, 2)[:, :, 4]
    in_range = np.hypot(middle[..., 0] - eye[0], middle[..., 1] - eye[1]) < range_m - 1.0
    false_seen = ~hidden & in_range & (covered_m > 0.0)
    assert not np.any(hidden & in_range & (covered_m <= 0.0))
    assert false_seen.sum() <= 0.15 * in_range.sum()
    # the radar's bounds are those of cells of a four-hundredth of its range, and of those around
    assert np.max(covered_m[false_seen], initial=0.0) <= steepest * range_m / 400.0 * 5.0
    return bool(np.any(hidden & in_range))


@pytest.mark.parametrize(
    ("seed", "combine", "spacing_m", "above_ground_m"),
    [
        *((0, "maximum", 50, 150.0), (3, "sum", 160, 5.0)),
        *(
            pytest.param(*row, marks=pytest.mark.nightly)
            for row in (
                *((0, "maximum", 160, 5.0), (3, "sum", 50, 150.0)),
                *((7, "maximum", 160, 150.0), (7, "maximum", 50, 5.0)),
            )
        ),
    ],
)
def test_random_worlds(seed: int, combine: Any, spacing_m: int, above_ground_m: float) -> None:
    rows = peaks(np.random.default_rng(seed), (3, 14), (0.0, 0.0))

    def height(north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        """Written down once more from eq. 1."""
        total = np.zeros(np.broadcast(north_m, east_m).shape)
        for n, e, h, sn, se in rows:
            peak = h * np.exp(-(((north_m - n) / sn) ** 2) - ((east_m - e) / se) ** 2)
            total = np.maximum(total, peak) if combine == "maximum" else total + peak
        return np.maximum(total, 100.0)

    terrain = PeakTerrain(rows, combine=combine, ground_amsl_m=100.0)
    eye = (0.0, 0.0, float(height(np.zeros(1), np.zeros(1))[0]) + above_ground_m)
    check(terrain, height, FRAME, eye, range_m=4000.0, spacing_m=spacing_m, steepest=1.5)


@pytest.mark.sample(2)
@pytest.mark.parametrize(
    ("north_m", "east_m", "above_ground_m"),
    [(71.0, 2252.0, 20.0), (1966.0, -454.0, 20.0), (1521.0, 190.0, 150.0)],
)
def test_the_valley(north_m: float, east_m: float, above_ground_m: float) -> None:
    world = read_world(VALLEY)
    terrain = world.truth()
    eye = (north_m, east_m, terrain.height_at_amsl_m(north_m, east_m) + above_ground_m)
    height, frame = terrain.height_amsl_m, world.frame
    assert check(terrain, height, frame, eye, range_m=1500.0, spacing_m=48, steepest=0.7)
