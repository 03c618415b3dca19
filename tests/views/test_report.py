"""The report of a flight and its picture, held against what was recorded, by parsers not ours."""

import json
import math
import re
import shutil
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import lxml.etree
import lxml.html
import matplotlib._pylab_helpers
import numpy as np
import pyproj
import pytest
from answers import assert_it_loads_nothing, words_of
from matplotlib.patches import Circle
from planning import column_distance_m
from pymavlink.dialects.v20 import all as wire
from recorded import EPOCH_US
from tlog import frames_of, messages, written

from companion.config import load_mission
from companion.geodesy import FloatArray
from companion.profiles import Weights
from companion.replay.exporting import facts_of, write_report
from companion.views import figure as views
from companion.views.figure import FlightFigure, compose, recorded_figure, save
from companion.world.known_map import KnownMap, empty_map, packed_map

GEOD = pyproj.Geod(ellps="WGS84")
EVIL = "</pre></svg><script>alert('x')</script>"
RADAR = '[[radars]]\nname = "{}"\nnorth_m = {}\neast_m = {}\naltitude_amsl_m = {}\nrange_m = {}\n'
RADAR_NEA_M, RANGE_M = (2000.0, 1500.0, 3000.0), 900.0
TARGET_NE_M = (4000.0, 3000.0)


@pytest.fixture(scope="module")
def run_dir(run_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short flight past a radar, over a hill that came to be known."""
    run = Path(shutil.copytree(run_dir, tmp_path_factory.mktemp("reported") / "run"))
    with (run / "mission.toml").open("a", encoding="utf-8") as file:
        file.write(RADAR.format("near <&>", *RADAR_NEA_M, RANGE_M))
    (run / "known.npz").write_bytes(packed_map(hill(run)))
    facts = {"companion": "0", "planning_s": [0.2, 0.9, 0.3], "began": "2026-05-04T10:20:30+00:00"}
    (run / "run.json").write_text(json.dumps(facts))
    return run


def hill(run: Path) -> KnownMap:
    """Beside the path, seen but for its south."""
    task = load_mission(str(run / "mission.toml")).task
    blank = empty_map(task.cell_m, task.limits.north_m, task.limits.east_m)
    rows, columns = blank.upper_m.shape
    north = blank.north_min_m + (np.arange(rows) + 0.5) * blank.cell_m
    east = blank.east_min_m + (np.arange(columns) + 0.5) * blank.cell_m
    away = np.hypot(north[:, None] - 3000.0, east[None, :] - 900.0)
    heights = np.where(north[:, None] > 500.0, 2600.0 * np.exp(-((away / 1500.0) ** 2)), np.inf)
    return replace(blank, upper_m=heights, seen=np.isfinite(heights), registration_m=12.0)


def report_of(run: Path, out: Path | None = None) -> str:
    write_report(run, out)
    return (out or run / "report.html").read_text(encoding="utf-8")


def entries(run: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (run / "journal.jsonl").read_text().splitlines()[1:]]


# --- the numbers


def test_the_numbers_are_those_of_the_positions_from_the_end_of_the_climb_to_the_end(
    run_dir: Path,
) -> None:
    facts = facts_of(run_dir)
    phases = {e["phase"]: e["t_s"] for e in reversed(entries(run_dir)) if e["kind"] == "phase"}
    log = [m for m in messages(run_dir) if m.get_type() == "GLOBAL_POSITION_INT" and m.lat]
    times_s, latitudes, longitudes, up_m = np.array(
        [(m.time_boot_ms * 1e-3, m.lat * 1e-7, m.lon * 1e-7, m.alt * 1e-3) for m in log]
    )[[phases["flying"] <= m.time_boot_ms * 1e-3 < phases["done"] for m in log]].T
    frame = facts.flight.mission.frame
    assert facts.duration_s == pytest.approx(times_s[-1] - times_s[0], abs=0.01)
    # geodesics between the positions, and from the first and the last to the target
    assert facts.flown_m == pytest.approx(GEOD.line_length(longitudes, latitudes), rel=2e-3)
    target = frame.to_geodetic_deg(*TARGET_NE_M)
    first_m, last_m = (
        GEOD.line_length([longitudes[k], target[1]], [latitudes[k], target[0]]) for k in (0, -1)
    )
    assert facts.straight_m == pytest.approx(first_m, rel=1e-4)
    assert facts.left_m == pytest.approx(last_m, abs=0.1)
    # every position to every known cell
    local = [frame.to_local_m(*place) for place in zip(latitudes, longitudes, strict=True)]
    places = np.column_stack([local, up_m])
    known = hill(run_dir)
    seen = replace(known, upper_m=np.where(known.seen, known.upper_m, -np.inf))
    away_m = column_distance_m(seen, places, 2_000.0)
    assert facts.nearest.distance_m < facts.clearance_reach_m
    assert facts.nearest.distance_m == pytest.approx(away_m.min(), abs=1e-6)
    assert facts.nearest.time_s == pytest.approx(times_s[away_m.argmin()], abs=1e-6)
    # those within the range of the radar
    to_radar_m = np.linalg.norm(places - RADAR_NEA_M, axis=1)
    inside_s = np.diff(times_s)[to_radar_m[:-1] <= RANGE_M].sum()
    detection = RANGE_M**4 / (RANGE_M**4 + to_radar_m.min() ** 4)
    assert facts.exposure.radar == "near <&>"
    assert 5.0 < facts.exposure.duration_s == pytest.approx(inside_s, abs=0.2)
    assert facts.exposure.detection == pytest.approx(detection, rel=1e-6)


def test_times_without_a_fix_and_gaps_of_setpoints_are_those_of_the_log(copy: Path) -> None:
    codec, log, sent_s = wire.MAVLink(None, 1, 1), list[tuple[int, bytes]](), list[float]()
    for at_us, m in frames_of((copy / "flight.tlog").read_bytes()):
        time_s, sender = (at_us - EPOCH_US) * 1e-6, m.get_srcComponent()
        if m.get_type() == "GPS_RAW_INT":
            lost = 60.0 <= time_s < 70.0
            m.fix_type, m.satellites_visible = (1, 2) if lost else (m.fix_type, 9)
            codec.seq = m.get_seq()
            m.pack(codec)
        if m.get_type() == "SET_POSITION_TARGET_GLOBAL_INT" and sender == 195:
            if 50.0 <= time_s < 51.5:
                continue
            sent_s.append(time_s)
        log.append((at_us, bytes(m.get_msgbuf())))
    written(copy / "flight.tlog", log)
    facts = facts_of(copy)
    assert facts.without_fix_s == pytest.approx(10.0, abs=1.0)
    flying_s = np.array(sent_s)[np.array(sent_s) > 45.0]
    assert 1.5 < facts.setpoint_gap_s == pytest.approx(np.diff(flying_s).max(), abs=1e-6)


# --- the page


def test_the_page_says_what_the_files_say_is_whole_and_loads_nothing(
    run_dir: Path, tmp_path: Path
) -> None:
    """Each figure is XML, and holds what it refers to."""
    page, said = report_of(run_dir, tmp_path / "report.html"), entries(run_dir)
    words, read = words_of(page), lxml.html.fromstring(page)
    held = [e for e in said if e["kind"] == "phase" and "holding" in (e["phase"], e["was"])]
    ready = [e for e in said if e["kind"] == "plan ready"]
    for expected in (
        f"Holds 1, {held[1]['t_s'] - held[0]['t_s']:.0f} s in all paused by a person",
        "Planning time, median 300 ms, longest 900 ms T is",
        "2 of 2 subpaths flown; 0 plans refused, 0 late",
        "✔ Arrived: target reached",
        *(f" {e['length_m']:,.0f} {e['evaluations']:,} " for e in ready),
    ):
        assert expected in words
    assert {weight.name for weight in fields(Weights)} <= {*read.xpath("//th/text()")}
    assert sum(e["kind"] == "say" for e in said) == words.count("companion: ")
    assert "cut as time was up" not in words
    assert_it_loads_nothing(page)
    ids = read.xpath("//@id")
    assert len(ids) == len(set(ids))
    figures = re.findall(r"<svg.*?</svg>", page, flags=re.DOTALL)
    assert len(figures) == 2
    for text in figures:
        root = lxml.etree.fromstring(text.encode())
        assert root.tag == "{http://www.w3.org/2000/svg}svg"
        assert set(re.findall(r'(?:href="#|url\(#)([^")]*)', text)) <= set(root.xpath("//@id"))


# --- the picture

BEGINS = {".png": b"\x89PNG\r\n\x1a\n", ".svg": b"<?xml", ".PDF": b"%PDF"}


@pytest.fixture(scope="module")
def pictured(run_dir: Path) -> FlightFigure:
    """Without the track that was flown, over the south-western corner of the map."""
    facts, known = facts_of(run_dir), hill(run_dir)
    corner = replace(known, upper_m=known.upper_m[:100, :100], seen=known.seen[:100, :100])
    shown = recorded_figure(facts.flight, corner)
    return replace(shown, track_nea_m=None, title="$5 a_b")


def axes_of(flight: FlightFigure) -> dict[str, Any]:
    return {str(axes.get_label()): axes for axes in compose(flight).axes}


def line_of(axes: Any, label: str) -> FloatArray:
    (line,) = (line for line in axes.lines if line.get_label() == label and len(line.get_xdata()))
    return np.stack(line.get_data(), axis=-1)


def labels_of(axes: Any) -> set[str]:
    return set(axes.get_legend_handles_labels()[1])


@pytest.mark.parametrize("suffix", BEGINS)
def test_the_same_flight_gives_the_same_picture_of_the_kind_that_is_named(
    pictured: FlightFigure, suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The terrain of an .svg is an image, and its lines are lines.  Nothing known is a picture."""
    monkeypatch.setattr(views, "DPI", 40)  # it is sooner drawn
    monkeypatch.setattr(views, "_BLOCKS", 30)
    one, two = tmp_path / f"one{suffix}", tmp_path / f"two{suffix}"
    for path in (one, two):
        save(compose(pictured), path)
    assert not matplotlib._pylab_helpers.Gcf.figs  # none stays open
    assert one.read_bytes().startswith(BEGINS[suffix])
    assert one.read_bytes() == two.read_bytes()
    if suffix == ".svg":
        tags = [each.tag.partition("}")[2] for each in lxml.etree.parse(one).iter("*")]
        assert tags.count("image") >= 2
        assert 50 < tags.count("path") < 3000
    nothing = np.full_like(pictured.known.upper_m, math.inf)
    unknown = replace(pictured.known, upper_m=nothing)
    save(compose(replace(pictured, known=unknown, legs_nea_m=())), one)


def test_the_plan_shows_the_path_in_kilometres_and_radars_as_wide_as_within_the_band(
    pictured: FlightFigure,
) -> None:
    known = pictured.known
    whole = replace(known, upper_m=np.zeros((100, 100)), seen=np.ones((100, 100), dtype=bool))
    plan = axes_of(replace(pictured, known=whole))["plan"]
    assert "unknown ground" not in labels_of(plan)
    path = np.concatenate(pictured.legs_nea_m)
    np.testing.assert_allclose(line_of(plan, "planned path"), path[:, [1, 0]])
    edges_m = pytest.approx((known.north_min_m, known.north_min_m + 100 * known.cell_m))
    assert [plan.get_xlim(), plan.get_ylim()] == [edges_m, edges_m]
    assert "km" in plan.get_xlabel()
    assert plan.xaxis.get_major_formatter()(2500.0) == "2.5"
    assert plan.get_aspect() == 1.0
    radii_m = {patch.get_radius() for patch in plan.patches if isinstance(patch, Circle)}
    for radar in pictured.task.radars:
        above_m = max(pictured.band_m[0] - radar.centre_nea_m[2], 0.0)
        assert math.sqrt(radar.range_m**2 - above_m**2) in map(pytest.approx, radii_m)
    filled = [(patch.get_label(), patch.get_facecolor()[3] > 0.0) for patch in plan.patches]
    assert filled.count(("keep-out", True)) == 2
    assert filled.count(("keep-in", False)) == 1


def test_the_profile_shows_the_terrain_under_the_path_and_both_paths_over_it(
    pictured: FlightFigure,
) -> None:
    """The flown track at the nearest place of the path, or as its own; unknown ground as such."""
    path, known = np.concatenate(pictured.legs_nea_m), pictured.known
    higher = replace(pictured, track_nea_m=np.add(path, (0.0, 0.0, 7.0)))
    axes = axes_of(higher)
    profile = axes["profile"]
    assert "unknown ground" in labels_of(axes["plan"])
    under, over = (line_of(profile, n) for n in ("terrain under the path", "planned path"))
    cells = (path[:, :2] - (known.north_min_m, known.east_min_m)) // known.cell_m
    heights_m = known.upper_m[tuple(cells.astype(int).T)]
    np.testing.assert_allclose(under[:, 1], np.where(heights_m < math.inf, heights_m, math.nan))
    assert any(each.get_hatch() for each in profile.collections)  # where it began
    np.testing.assert_allclose(over[:, 1], path[:, 2])
    along_m = np.linalg.norm(np.diff(path[:, :2], axis=0), axis=1).sum()
    assert over[-1, 0] == pytest.approx(along_m)
    np.testing.assert_allclose(line_of(profile, "flown track"), np.add(over, (0.0, 7.0)), atol=1e-9)
    alone = axes_of(replace(pictured, legs_nea_m=(), track_nea_m=path))
    assert "planned path" not in labels_of(alone["plan"])
    np.testing.assert_allclose(line_of(alone["profile"], "flown track")[:, 1], path[:, 2])


# --- what is not there, or otherwise


def without_inputs(run: Path, known: bytes | None) -> None:
    """From which a map would grow again.  known: what stands for it."""
    (run / "inputs.msgpack").unlink()
    (run / "known.npz").unlink()
    if known is not None:
        (run / "known.npz").write_bytes(known)


def noting(run: Path, *more: dict[str, Any], **of_plans: Any) -> None:
    """More at the end of the journal, and about the plans."""
    header, *_ = (run / "journal.jsonl").read_text().splitlines()
    said = [e | of_plans if e["kind"] == "plan ready" else e for e in entries(run)]
    lines = [header, *map(json.dumps, [*said, *more])]
    (run / "journal.jsonl").write_text("\n".join(lines) + "\n")


def evil(run: Path) -> None:
    with (run / "mission.toml").open("a", encoding="utf-8") as file:
        file.write(f"# {EVIL}\n" + RADAR.format(EVIL, 3000.0, 3000.0, 3000.0, 2000.0))
    (run / "run.json").write_text(json.dumps({"companion": EVIL, "began": EVIL}))
    noting(
        run,
        {"t_s": 50.0, "kind": "vehicle says", "text": EVIL},
        {"t_s": 51.0, "kind": "part died", "error": EVIL},
        END | {"reason": EVIL},
    )


END = {"t_s": 99.0, "kind": "end", "outcome": "failed", "reason": "the vehicle disarmed"}
CUT = {"t_s": 90.0, "kind": "plan refused", "plan_id": 9, "reason": "OUT_OF_TIME", "broken": []}
CUT |= {"evaluations": 341, "out_of_time": True}
ODD_FACTS = b'{"planning_s":["x",null],"began":5,"times_real_time":"fast","companion":[1]}'
ODD: dict[str, tuple[Callable[[Path], object], list[str]]] = {
    "no map": (lambda run: without_inputs(run, None), ["the known map was not recorded"]),
    "a damaged run.json": (lambda run: (run / "run.json").write_bytes(b"\0{"), ["run.json: "]),
    "a damaged map": (lambda run: without_inputs(run, b"\0{"), ["known.npz: "]),
    "odd values": (
        lambda run: (run / "run.json").write_bytes(ODD_FACTS),
        ["Planning time, median not recorded"],
    ),
    "out of time": (
        lambda run: noting(run, CUT, out_of_time=True),
        [
            "; of 3 the search was cut as time was up: raise planner.planning_time_s",
            "plan 9 refused: OUT_OF_TIME; time was up after 341 candidates",
        ],
    ),
    "failed": (
        lambda run: noting(run, END),
        [
            "✘ Failed: the vehicle disarmed",
            "Held before: paused by a person (",
            "What to do: See its messages for the reason.",
            "from the last target at the end",
        ],
    ),
    # what comes from the flight is text and no markup; and the last end counts
    "evil": (evil, [f"✘ Failed: {EVIL}", f"vehicle: {EVIL}", f"has died: {EVIL}"]),
}


@pytest.mark.parametrize("what", ODD)
def test_what_is_odd_about_a_flight_is_told(
    copy: Path, what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    change, expected = ODD[what]
    if what != "evil":  # nine tenths of the time of a report goes into its figures
        monkeypatch.setattr("companion.views.report.svg_figures", lambda _facts: {})
    change(copy)
    page = report_of(copy)
    words = words_of(page)
    for each in expected:
        assert each in words
    assert ("Nearest to known terrain" in words) == (what not in ("no map", "a damaged map"))
    assert not lxml.html.fromstring(page).xpath("//script")
    for text in re.findall(r"<svg.*?</svg>", page, flags=re.DOTALL):
        lxml.etree.fromstring(text.encode())
