"""What the radar calls hidden against rays marched over the true ground in small steps.

A cell may be called hidden only if it is (nothing is ever hidden that is in sight), and what is
called seen although it is hidden lies so little behind a ridge that the ridge hardly hides it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from vehicle_sim.geodesy import LocalFrame
from vehicle_sim.sensors.terrain_radar import UNSEEN_M, ScanRequest, TerrainRadar, Viewpoint
from vehicle_sim.terrain import PeakRow, PeakTerrain, Terrain
from vehicle_sim.world import read_world

FloatArray = NDArray[np.float64]
Height = Callable[[FloatArray, FloatArray], FloatArray]
FRAME = LocalFrame(latitude_deg=47.0, longitude_deg=8.0)
VALLEY = Path(__file__).parents[2] / "companion" / "environments" / "valley" / "world.toml"
ROWS, COLUMNS = 28, 32
EARTH_M = 6_371_009.0
STEPS = 400
"""Of a ray."""


@dataclass(frozen=True, kw_only=True)
class Look:
    """One request of the radar, and what the marcher says of the same cells.  (28, 32) each."""

    called_hidden: NDArray[np.bool_]
    in_range: NDArray[np.bool_]
    covered_m: FloatArray
    """How far the ground rises above the best line of sight to the cell; <= 0: in sight."""


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


def look(
    terrain: Terrain,
    height: Height,
    frame: LocalFrame,
    *,
    range_m: float,
    spacing_m: int,
    eye: tuple[float, float, float],
) -> Look:
    corner = frame.to_geographic(eye[0] - 14 * spacing_m, eye[1] - 16 * spacing_m)
    request = ScanRequest(
        latitude_deg=corner[0],
        longitude_deg=corner[1],
        spacing_m=spacing_m,
        mask=(1 << 56) - 1,
    )
    place = frame.to_geographic(eye[0], eye[1])
    view = Viewpoint(latitude_deg=place[0], longitude_deg=place[1], altitude_amsl_m=eye[2])
    heights = np.empty((ROWS, COLUMNS), dtype=np.int64)
    for block in TerrainRadar(terrain, frame, range_m=range_m).answer(request, view):
        row, column = divmod(block.gridbit, 8)
        cells = np.array(block.heights_amsl_m).reshape(4, 4)
        heights[4 * row : 4 * row + 4, 4 * column : 4 * column + 4] = cells
    # Corners, middles of the sides and the middle of every cell, as the message defines them.
    at = np.arange(3) * 0.5 * spacing_m
    north = (np.arange(ROWS) * spacing_m)[:, None, None, None] + at[:, None]
    east = (np.arange(COLUMNS) * spacing_m)[None, :, None, None] + at[None, :]
    own = LocalFrame(latitude_deg=corner[0], longitude_deg=corner[1])
    ravelled = (x.ravel() for x in np.broadcast_arrays(north, east))
    points = np.stack(frame.to_local_many(*own.to_geographic_many(*ravelled)), axis=-1)
    covered = marched(height, eye, points).reshape(ROWS, COLUMNS, 9)
    middle = points.reshape(ROWS, COLUMNS, 9, 2)[:, :, 4]
    away_m = np.hypot(middle[..., 0] - eye[0], middle[..., 1] - eye[1])
    return Look(
        called_hidden=heights == UNSEEN_M,
        in_range=away_m < range_m - 1.0,
        covered_m=covered.min(axis=-1),
    )


def hills(seed: int, combine: str) -> tuple[PeakTerrain, Height]:
    """A random world, and its height written down once more from eq. 1."""
    rng = np.random.default_rng(seed)
    rows: list[PeakRow] = [
        (
            float(rng.uniform(-4e3, 4e3)),
            float(rng.uniform(-4e3, 4e3)),
            float(rng.uniform(200, 1500)),
            float(rng.uniform(200, 1500)),
            float(rng.uniform(200, 1500)),
        )
        for _ in range(int(rng.integers(3, 14)))
    ]

    def height(north_m: FloatArray, east_m: FloatArray) -> FloatArray:
        total = np.zeros(np.broadcast(north_m, east_m).shape)
        for n, e, h, sn, se in rows:
            peak = h * np.exp(-(((north_m - n) / sn) ** 2) - ((east_m - e) / se) ** 2)
            total = np.maximum(total, peak) if combine == "maximum" else total + peak
        return np.maximum(total, 100.0)

    literal = "maximum" if combine == "maximum" else "sum"
    return PeakTerrain(rows, combine=literal, ground_amsl_m=100.0), height  # type: ignore[arg-type]


def check(got: Look, *, steepest: float, range_m: float) -> None:
    in_sight = got.in_range & (got.covered_m <= 0.0)
    false_hidden = got.called_hidden & in_sight
    false_seen = ~got.called_hidden & got.in_range & (got.covered_m > 0.0)
    assert false_hidden.sum() == 0
    assert false_seen.sum() <= 0.15 * got.in_range.sum()
    # The radar's bounds are those of cells of a four-hundredth of its range, and of those around.
    assert np.max(got.covered_m[false_seen], initial=0.0) <= steepest * range_m / 400.0 * 5.0


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
def test_random_worlds(seed: int, combine: str, spacing_m: int, above_ground_m: float) -> None:
    terrain, height = hills(seed, combine)
    ground_m = float(height(np.array([0.0]), np.array([0.0]))[0])
    got = look(
        terrain,
        height,
        FRAME,
        range_m=4000.0,
        spacing_m=spacing_m,
        eye=(0.0, 0.0, ground_m + above_ground_m),
    )
    check(got, steepest=1.5, range_m=4000.0)


@pytest.mark.sample(2)
@pytest.mark.parametrize(
    ("north_m", "east_m", "above_ground_m"),
    [(71.0, 2252.0, 20.0), (1966.0, -454.0, 20.0), (1521.0, 190.0, 150.0)],
)
def test_the_valley(north_m: float, east_m: float, above_ground_m: float) -> None:
    world = read_world(VALLEY)
    terrain = world.truth()
    eye = (north_m, east_m, terrain.height_at_amsl_m(north_m, east_m) + above_ground_m)
    got = look(terrain, terrain.height_amsl_m, world.frame, range_m=1500.0, spacing_m=48, eye=eye)
    assert got.called_hidden[got.in_range].any()
    check(got, steepest=0.7, range_m=1500.0)
