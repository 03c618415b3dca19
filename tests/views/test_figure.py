"""The picture of a flight: what its plan and its profile show, and that there always is one."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import lxml.etree
import matplotlib._pylab_helpers
import numpy as np
import pytest
from matplotlib.patches import Circle

from companion.config import load_mission
from companion.geodesy import FloatArray
from companion.views import figure as views
from companion.views.figure import FlightFigure, compose, save
from companion.world.known_map import empty_map
from companion.world.radars import Radar
from companion.world.zones import CircleZone, PolygonZone

CELL_M = 25.0
MIDDLES_M = (np.arange(200) + 0.5) * CELL_M
BEGINS = {".png": b"\x89PNG\r\n\x1a\n", ".svg": b"<?xml", ".PDF": b"%PDF"}


def hill(north_m: FloatArray, east_m: FloatArray) -> FloatArray:
    return 100.0 + 400.0 * np.exp(-(((north_m - 2500) / 900) ** 2) - ((east_m - 2000) / 600) ** 2)


def a_flight() -> FlightFigure:
    """Over the hill in two straight legs, from one corner of 5 km by 5 km to near the other."""
    first = np.linspace((500.0, 500.0, 520.0), (2500.0, 2000.0, 580.0), 60)
    second = np.linspace((2500.0, 2000.0, 580.0), (3500.0, 4300.0, 560.0), 60)
    heights_m = hill(MIDDLES_M[:, None], MIDDLES_M)
    known = empty_map(CELL_M, (0.0, 5000.0), (0.0, 5000.0))
    task = load_mission("environment-1").task
    return FlightFigure(
        title="a flight of $5 worth_of words",
        caption="one line",
        task=replace(
            task,
            limits=replace(task.limits, floor_amsl_m=450.0, ceiling_amsl_m=700.0),
            radars=(Radar(name="r", centre_nea_m=(4000.0, 1000.0, 100.0), range_m=700.0),),
            zones=(CircleZone(name="c", north_m=800.0, east_m=3500.0, radius_m=400.0),),
        ),
        known=replace(known, upper_m=heights_m, seen=np.ones_like(heights_m, dtype=bool)),
        start_nea_m=(500.0, 500.0, 520.0),
        targets_ne_m=((3500.0, 4300.0),),
        legs_nea_m=(first, second),
        scans_nea_m=((500.0, 500.0, 520.0), (1500.0, 1250.0, 550.0)),
        vehicle_zones=(
            PolygonZone(name="p", vertices_ne_m=((4500, 3000), (4900, 3100), (4700, 3500))),
        ),
    )


PATH = np.concatenate(a_flight().legs_nea_m)


def axes_of(flight: FlightFigure) -> dict[str, Any]:
    return {str(axes.get_label()): axes for axes in compose(flight).axes}


def line_of(axes: Any, label: str) -> FloatArray:
    (line,) = (line for line in axes.lines if line.get_label() == label and len(line.get_xdata()))
    return np.stack(line.get_data(), axis=-1)


def labels_of(axes: Any) -> set[str]:
    return set(axes.get_legend_handles_labels()[1])


@pytest.mark.parametrize("suffix", BEGINS)
def test_the_same_flight_gives_the_same_picture_of_the_kind_that_is_named(
    suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The terrain of an .svg is an image, and its lines are lines.  Nothing known is a picture."""
    monkeypatch.setattr(views, "DPI", 40)  # it is sooner drawn
    monkeypatch.setattr(views, "_BLOCKS", 30)
    one, two = tmp_path / f"one{suffix}", tmp_path / f"two{suffix}"
    for path in (one, two):
        save(compose(a_flight()), path)
    assert not matplotlib._pylab_helpers.Gcf.figs  # none stays open
    assert one.read_bytes().startswith(BEGINS[suffix])
    assert one.read_bytes() == two.read_bytes()
    if suffix == ".svg":
        tags = [each.tag.partition("}")[2] for each in lxml.etree.parse(one).iter("*")]
        assert tags.count("image") >= 2
        assert 50 < tags.count("path") < 3000
    nothing = a_flight()
    nothing.known.upper_m[:] = math.inf
    save(compose(replace(nothing, legs_nea_m=())), one)


def test_the_plan_shows_the_path_in_kilometres_and_radars_as_wide_as_within_the_band() -> None:
    plan = axes_of(a_flight())["plan"]
    np.testing.assert_allclose(line_of(plan, "planned path"), PATH[:, [1, 0]])
    assert [plan.get_xlim(), plan.get_ylim()] == [pytest.approx((0.0, 5000.0))] * 2
    assert "km" in plan.get_xlabel()
    assert plan.xaxis.get_major_formatter()(2500.0) == "2.5"
    assert plan.get_aspect() == 1.0
    assert "unknown ground" not in labels_of(plan)
    (radius_m,) = (patch.get_radius() for patch in plan.patches if isinstance(patch, Circle))
    above_m = 350.0  # the band begins so far above the radar
    assert radius_m == pytest.approx(math.sqrt(700.0**2 - above_m**2))
    assert sum(patch.get_label() == "keep-out" for patch in plan.patches) == 2


def test_the_profile_shows_the_terrain_under_the_path_and_both_paths_over_it() -> None:
    """The flown track at the nearest place of the path, or as its own; unknown ground as such."""
    higher = replace(a_flight(), track_nea_m=np.add(PATH, (0.0, 0.0, 7.0)))
    higher.known.upper_m[:60, :60] = math.inf
    axes = axes_of(higher)
    profile, unknown = axes["profile"], (PATH[:, :2] < 60 * CELL_M).all(axis=1)
    assert "unknown ground" in labels_of(axes["plan"])
    under, over = (line_of(profile, n) for n in ("terrain under the path", "planned path"))
    middles = (np.floor(PATH[:, :2] / CELL_M) + 0.5) * CELL_M  # of the cell that holds the point
    expected = np.where(unknown, np.nan, hill(middles[:, 0], middles[:, 1]))
    np.testing.assert_allclose(under[:, 1], expected)
    assert any(each.get_hatch() for each in profile.collections)  # along the corner
    np.testing.assert_allclose(over[:, 1], PATH[:, 2])
    first_m, second_m = math.hypot(2000.0, 1500.0), math.hypot(1000.0, 2300.0)
    assert over[-1, 0] == pytest.approx(first_m + second_m)
    assert line_of(profile, "scan (p_scan)")[1, 0] == pytest.approx(first_m / 2, abs=30.0)
    np.testing.assert_allclose(line_of(profile, "flown track"), np.add(over, (0.0, 7.0)), atol=1e-9)
    alone = axes_of(replace(a_flight(), legs_nea_m=(), track_nea_m=PATH))
    assert "planned path" not in labels_of(alone["plan"])
    np.testing.assert_allclose(line_of(alone["profile"], "flown track")[:, 1], PATH[:, 2])
