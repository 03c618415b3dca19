"""Both kinds of terrain: that their bounds hold, and how files of them are read.

Metres and degrees are those of pyproj, and nothing changes where 180 becomes -180 degrees.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import documents
import numpy as np
import pytest
from documents import AREA_M, HEIGHTS_M, STEP_DEG
from harness import KINDS, Rig, heartbeat, placed
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import Transformer

from vehicle_sim.autopilot.earth import Projection
from vehicle_sim.autopilot.values import Place
from vehicle_sim.elevation import read_grid
from vehicle_sim.errors import InputError
from vehicle_sim.geodesy import FloatArray, LocalFrame
from vehicle_sim.terrain import GridTerrain, PeakRow, PeakTerrain, Terrain

HALF_M = 3_000.0
PLACES = ((0.0, 0.0), (36.5, -84.3), (-47.0, 179.99), (62.0, -180.0))
TERRAINS = st.sampled_from(["maximum", "sum", *PLACES])
SEEDS = st.integers(0, 10**6)
ROWS, COLUMNS = 100, 160
Kind = str | tuple[float, float]


def drawn(rng: np.random.Generator, kind: Kind) -> tuple[Terrain, list[PeakRow]]:
    """Peaks; or about a place rough ground: steps of up to 120 m between points of about 90 m."""
    if isinstance(kind, tuple):

        def nodes(latitude: FloatArray, longitude: FloatArray) -> tuple[FloatArray, FloatArray]:
            east_deg = (longitude - kind[1] + 180.0) % 360.0 - 180.0
            return 0.5 * ROWS - (latitude - kind[0]) / STEP_DEG, 0.5 * COLUMNS + east_deg / STEP_DEG

        grid = GridTerrain(
            rng.integers(200, 320, (ROWS, COLUMNS)).astype(np.int16),
            placed=nodes,
            corner=(0, 0),
            frame=LocalFrame(**placed(kind, height=False)),
            area_m=(-HALF_M, HALF_M, -HALF_M, HALF_M),
        )
        return grid, []
    count = int(rng.integers(0, 8))
    places, heights = rng.uniform(-HALF_M, HALF_M, (count, 2)), rng.uniform(100, 3000, count)
    spreads = rng.uniform(300, 3000, (count, 2))
    rows = [tuple(row) for row in np.column_stack([places, heights, spreads]).tolist()]
    ground_m = float(rng.choice([-50.0, 50.0]))
    return PeakTerrain(rows, combine=kind, ground_amsl_m=ground_m), rows  # type: ignore[arg-type]


@settings(max_examples=40)
@given(seed=SEEDS, kind=TERRAINS, size_m=st.sampled_from([19.0, 60.0, 250.0, 400.0]))
def test_the_highest_of_a_quad_bounds_it_and_is_near(seed: int, kind: Kind, size_m: float) -> None:
    rng = np.random.default_rng(seed)
    terrain, about = drawn(rng, kind)
    # turned, anywhere, and with the tops of peaks in them or just outside: (K, 4, 2)
    tops = np.array([row[:2] for row in about]).reshape(-1, 2)
    near_tops = tops + rng.uniform(-0.6, 0.6, tops.shape) * size_m
    centres = np.concatenate([rng.uniform(-2_500, 2_500, (20, 2)), near_tops])
    square = np.array([(-1, -1), (-1, 1), (1, 1), (1, -1)]) * size_m / 2
    angle = rng.uniform(-0.3, 0.3)
    turn = np.array([(np.cos(angle), -np.sin(angle)), (np.sin(angle), np.cos(angle))])
    quads = centres[:, None] + square @ turn.T
    highest, at = terrain.highest_in_quads_amsl_m(quads)
    u, v = (x.ravel() for x in np.meshgrid(np.linspace(0, 1, 61), np.linspace(0, 1, 61)))
    shares = np.stack([(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v])
    points = np.einsum("kp,ckx->cpx", shares, quads)
    brute = terrain.height_amsl_m(points[..., 0], points[..., 1]).max(axis=1)
    attained = terrain.height_amsl_m(at[:, 0], at[:, 1])
    assert (highest >= brute - 1e-6).all()
    if kind == "maximum":
        np.testing.assert_allclose(attained, highest, rtol=1e-12)
        assert (highest <= brute + 30.0).all()  # 7 m between samples, slopes up to about 9
    elif kind != "sum":
        assert (attained >= brute - 0.1 * size_m).all()
        if size_m == 19.0:
            assert (highest <= attained + 6.0).all()  # 1.7 m from a sample at most, slopes up to 3


@settings(max_examples=40)
@given(seed=SEEDS, kind=TERRAINS, cell_m=st.sampled_from([4.0, 200.0]))
def test_lower_bounds_of_cells_are_below_the_terrain(seed: int, kind: Kind, cell_m: float) -> None:
    rng = np.random.default_rng(seed)
    terrain, _ = drawn(rng, kind)
    begins = rng.uniform(-2_900, -2_000, 2)
    north, east = (start + np.arange(0.0, 25.5) * cell_m for start in begins)
    lowest = terrain.lowest_in_grid_amsl_m(north, east)
    u, v = rng.uniform(0.0, cell_m, (2, 40))
    inside = (north[:-1, None] + u)[:, None, :], (east[:-1, None] + v)[None, :, :]
    brute = terrain.height_amsl_m(*inside).min(axis=-1)
    assert lowest.shape == (25, 25)
    assert (lowest <= brute + 1e-6).all()
    if not isinstance(kind, tuple):
        assert (lowest >= terrain.ground_amsl_m).all()  # type: ignore[attr-defined]
    elif cell_m == 4.0:
        assert (lowest >= brute - 25.0).all()


FRAME = LocalFrame(latitude_deg=47.0, longitude_deg=8.0)
HOLES = HEIGHTS_M.astype(np.float32)
HOLES[100, 119], HOLES[101, 119], HOLES[0, 0] = -9999.0, np.nan, -9999.0


def read(path: Path, nodata: Any = None, frame: LocalFrame = FRAME) -> GridTerrain:
    return read_grid(path, frame, AREA_M, nodata)


def test_a_tile_of_srtm_is_where_its_name_says_and_goes_on_as_at_its_edge(tmp_path: Path) -> None:
    """GeoTIFFs are bilinear, and where GDAL places them: tests/sources/test_elevation.py."""
    tile = np.random.default_rng(5).integers(100, 3_000, (1201, 1201)).astype(">i2")
    path, frame = tmp_path / "N46E008.hgt", LocalFrame(latitude_deg=46.5, longitude_deg=8.5)
    path.write_bytes(tile.tobytes())
    there = frame.to_local(47.0 - 615 / 1200, 8.0 + 580 / 1200)
    terrain = read(path, None, frame)
    assert terrain.height_at_amsl_m(*there) == pytest.approx(tile[615, 580], abs=0.1)
    assert terrain.height_at_amsl_m(9e4, -9e4) == terrain.height_at_amsl_m(*AREA_M[1:3])


def test_what_lies_in_holes_is_what_the_world_says(tmp_path: Path) -> None:
    path = tmp_path / "terrain.tif"
    documents.terrain(path, HOLES, nodata=-9999.0)
    for nodata, height_m in (("sea", 0.0), (12.5, 12.5)):
        assert (read(path, nodata).heights_m == height_m).sum() == 2


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"crs": None}, "north up"),
        ({"transform": (STEP_DEG, 1e-5, 7.9, 0.0, -STEP_DEG, 47.1)}, "north up"),
        ({"transform": (STEP_DEG, 0.0, 7.9, 0.0, STEP_DEG, 46.9)}, "north up"),
        ({"transform": (STEP_DEG, 0.0, 7.99, 0.0, -STEP_DEG, 47.1)}, "does not cover [area]"),
        ({"heights_m": HOLES, "nodata": -9999.0}, "2 points without height"),
        (None, "cannot be read"),
    ],
    ids=str,
)
def test_what_cannot_be_flown_over_is_refused(tmp_path: Path, changes: Any, words: str) -> None:
    path = tmp_path / "terrain.tif"
    path.write_text("nothing") if changes is None else documents.terrain(path, **changes)
    with pytest.raises(InputError, match=r"^terrain\.file = ") as caught:
        read(path)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@given(
    here_deg=st.tuples(st.floats(-80.0, 80.0), st.floats(-179.0, 179.0)),
    away_m=st.tuples(*[st.floats(-1e5, 1e5)] * 2),
)
def test_frames_are_pyprojs_equidistant_ones_there_and_back(here_deg: Any, away_m: Any) -> None:
    """The world's on the ellipsoid, an autopilot's on the sphere."""

    def flat(latitude: float, longitude: float, earth: str) -> Any:
        here = "+proj=aeqd +lat_0={} +lon_0={} +units=m {}".format(*here_deg, earth)
        there = Transformer.from_crs(f"+proj=longlat +no_defs {earth}", here, always_xy=True)
        return pytest.approx(there.transform(longitude, latitude)[::-1], abs=1e-3)

    frame = LocalFrame(**placed(here_deg, height=False))
    there = frame.to_geographic(*away_m)
    assert away_m == flat(*there, "+ellps=WGS84")
    assert frame.to_local(*there) == pytest.approx(away_m, abs=1e-6)
    many = frame.to_geographic_many(*np.array(away_m)[:, None])
    assert (*many[0], *many[1]) == pytest.approx(there, abs=1e-12)
    sphere = Projection(Place(*here_deg, 400.0))
    place = sphere.place(*away_m, -30.0)
    assert away_m == flat(place.latitude_deg, place.longitude_deg, "+R=6371000")
    assert sphere.ned_m(place) == pytest.approx((*away_m, -30.0), abs=1e-4)


START_DEG = 179.9992
"""61 m before it."""


def over_the_line(kind: Any, autopilot: str, longitude_deg: float) -> tuple[Any, Sequence[int]]:
    """Over the line to the east within a fence, into its edge, and what that makes it do."""
    on = {"FENCE_ENABLE": 1.0, "FENCE_TYPE": 2.0, "FENCE_RADIUS": 150.0}
    if autopilot == "px4":
        on = {"GF_ACTION": 3.0, "GF_MAX_HOR_DIST": 150.0}
    flown = Rig(autopilot, kind, (47.0, longitude_deg, 400.0), heading_deg=90.0, **on).armable()
    flown.send(heartbeat())
    for message in (24, 33):
        flown.command(511, message, 500_000)
    flown.climb(12.0)
    for k in range(2800):
        if kind == "copter" and k % 20 == 0:
            flown.aim((0.0, 0.08 * k, -12.0), (0.0, 8.0, 0.0))
        if k == 100:
            flown.fault("ground_fence 5 m 9000 m ahead")  # all of it is read again
        flown.step()
    told = (*flown.all("GLOBAL_POSITION_INT"), *flown.all("GPS_RAW_INT"))
    fields = ("mode", "north_m", "east_m", "altitude_amsl_m")
    rows = [[row[field] for field in fields] for row in flown.truth()]
    return rows, [each.message.lon for each in told]


@pytest.mark.parametrize(("autopilot", "kind"), KINDS)
def test_a_flight_over_the_date_line_is_that_over_any_meridian(kind: str, autopilot: str) -> None:
    here, _ = over_the_line(kind, autopilot, START_DEG - 170.0)
    there, places = over_the_line(kind, autopilot, START_DEG)
    assert max(row[2] for row in here) > 140.0  # over the line and the fence's edge
    assert {row[0] for row in here} & {"RTL", "Return"}
    for (mode, *one), (as_mode, *other) in zip(here, there, strict=True):
        assert mode == as_mode
        assert one == pytest.approx(other, abs=0.05)
    assert {lon > 0 for lon in places} == {True, False}
    assert max(map(abs, places)) <= 1_800_000_000
