from pathlib import Path

import growth
import numpy as np
import pytest
import rasterio

from companion.campaign import drawn_world
from companion.world.simulated_scan import simulated_scan, true_map


def test_a_scan_of_the_surroundings_alone_is_that_of_the_whole_world() -> None:
    world = drawn_world.spread_out(100)
    blank = growth.map_of(world)
    range_m = world.task.settings.scan_range_m
    whole = simulated_scan(true_map(world.terrain, blank), world.start_nea_m, range_m)
    found = growth.scan_of(world, growth.near(world), blank)
    before, after = blank.with_scan(whole), blank.with_scan(found)
    assert np.isfinite(before.upper_m).sum() > 10_000
    np.testing.assert_array_equal(after.upper_m, before.upper_m)
    assert len(growth.near(world).peaks) < len(world.terrain.peaks)


def test_the_map_never_has_more_cells_than_a_mission_may_have(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    world = drawn_world.spread_out(100)
    assert growth.map_of(world).upper_m.size > 100_000
    monkeypatch.setattr(growth, "_MOST_CELLS", 100_000.0)
    assert 90_000 < growth.map_of(world).upper_m.size <= 100_000


def test_the_elevation_file_has_the_promised_cells_and_heights(tmp_path: Path) -> None:
    path = growth.relief(1_500**2, tmp_path)
    with rasterio.open(path) as file:
        heights = file.read(1)
        middle = file.xy(750, 750, offset="ul")
    assert heights.shape == (1_500, 1_500)
    assert heights.min() == 0
    assert heights.max() == 4_500
    np.testing.assert_allclose(middle, (8.0, 47.0), atol=1e-9)
    np.testing.assert_array_equal(heights[1_023], heights[1_024])  # mirrored: no cliff at the seam
