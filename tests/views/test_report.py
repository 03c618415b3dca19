"""The report of a flight, held against what was recorded, read by parsers that are not ours."""

import html
import itertools
import json
import math
import re
import shutil
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import lxml.etree
import lxml.html
import numpy as np
import pyproj
import pytest
from planning import column_distance_m
from pymavlink.dialects.v20 import all as wire
from recorded import EPOCH_US, run_folder
from short_flight import fly_short
from tlog import frames_of

from companion.config import load_mission
from companion.replay.exporting import facts_of, write_report
from companion.views.report_facts import FlightFacts
from companion.world.known_map import KnownMap, digest_of, empty_map, packed_map

GEOD = pyproj.Geod(ellps="WGS84")
EVIL = "</pre></svg><script>alert('x')</script>"
RADAR = '[[radars]]\nname = "{}"\nnorth_m = {}\neast_m = {}\naltitude_amsl_m = {}\nrange_m = {}\n'
RADAR_NEA_M, RANGE_M = (2000.0, 1500.0, 3000.0), 900.0
TARGET_NE_M = (4000.0, 3000.0)
Record = tuple[int, Any]
"""Stamp, in microseconds, and message."""


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short flight past a radar, over a hill that came to be known."""
    run = run_folder(tmp_path_factory.mktemp("recorded"))
    with (run / "mission.toml").open("a", encoding="utf-8") as file:
        file.write(RADAR.format("near <&>", *RADAR_NEA_M, RANGE_M))
    (run / "known.npz").write_bytes(packed_map(hill(run)))
    facts = json.loads((run / "run.json").read_text())
    facts |= {"planning_s": [0.2, 0.9, 0.3], "began": "2026-05-04T10:20:30+00:00"}
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


@pytest.fixture(scope="module")
def facts(run_dir: Path) -> FlightFacts:
    return facts_of(run_dir)


@pytest.fixture(scope="module")
def page(run_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    file = tmp_path_factory.mktemp("page") / "report.html"
    write_report(run_dir, file)
    return file.read_text(encoding="utf-8")


@pytest.fixture
def copy(run_dir: Path, tmp_path: Path) -> Path:
    """The same run folder, to be spoiled."""
    return Path(shutil.copytree(run_dir, tmp_path / "run"))


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """For the words alone: nine tenths of the time of a report goes into its figures."""
    monkeypatch.setattr("companion.views.report.svg_figures", lambda _facts: {})


def report_of(run: Path) -> str:
    write_report(run, None)
    return (run / "report.html").read_text(encoding="utf-8")


def words_of(page: str) -> str:
    """What a person reads on it."""
    shown = re.sub(r"<style>.*?</style>|<svg.*?</svg>", "", page, flags=re.DOTALL)
    return " ".join(html.unescape(re.sub(r"<[^>]*>", " ", shown)).split())


def records_of(run: Path) -> list[Record]:
    return list(frames_of((run / "flight.tlog").read_bytes()))


def entries(run: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (run / "journal.jsonl").read_text().splitlines()[1:]]


@pytest.fixture(scope="module")
def way(run_dir: Path) -> list[tuple[float, float, float, float]]:
    """Time, latitude, longitude, altitude from the end of the climb until the mission is over."""
    phases = [(e["t_s"], e["phase"]) for e in entries(run_dir) if e["kind"] == "phase"]
    begin = next(t_s for t_s, phase in phases if phase == "flying")
    end = next(t_s for t_s, phase in phases if phase == "done")
    found = [m for _, m in records_of(run_dir) if m.get_type() == "GLOBAL_POSITION_INT" and m.lat]
    rows = [(m.time_boot_ms * 1e-3, m.lat * 1e-7, m.lon * 1e-7, m.alt * 1e-3) for m in found]
    return [row for row in rows if begin <= row[0] < end]


# --- the numbers


def test_the_length_flown_is_that_of_the_geodesics_between_the_positions(
    way: Any, facts: FlightFacts
) -> None:
    latitudes, longitudes = [row[1] for row in way], [row[2] for row in way]
    target = facts.flight.mission.frame.to_geodetic_deg(*TARGET_NE_M)
    expected = GEOD.line_length(longitudes, latitudes)
    assert facts.flown_m == pytest.approx(expected, rel=2e-3)
    first, last = (
        GEOD.line_length([longitudes[k], target[1]], [latitudes[k], target[0]]) for k in (0, -1)
    )
    assert facts.straight_m == pytest.approx(first, rel=1e-4)
    assert facts.left_m == pytest.approx(last, abs=0.1)
    assert facts.duration_s == pytest.approx(way[-1][0] - way[0][0], abs=0.01)


def test_the_worst_clearance_is_that_of_every_position_to_every_known_cell(
    run_dir: Path, way: Any, facts: FlightFacts
) -> None:
    known, frame = hill(run_dir), facts.flight.mission.frame
    places = [(*frame.to_local_m(latitude, longitude), up) for _, latitude, longitude, up in way]
    seen = replace(known, upper_m=np.where(known.seen, known.upper_m, -np.inf))
    away_m = column_distance_m(seen, np.array(places), 2_000.0)
    assert facts.nearest is not None
    assert facts.nearest.distance_m < facts.clearance_reach_m
    assert facts.nearest.distance_m == pytest.approx(away_m.min(), abs=1e-6)
    assert facts.nearest.time_s == pytest.approx(way[away_m.argmin()][0], abs=1e-6)


def test_the_exposure_is_that_of_the_positions_within_the_range(
    way: Any, facts: FlightFacts
) -> None:
    frame = facts.flight.mission.frame
    rows = [(t_s, (*frame.to_local_m(lat, lon), up)) for t_s, lat, lon, up in way]
    pairs = [
        (after[0] - here[0], math.dist(here[1], after[1]))
        for here, after in itertools.pairwise(rows)
        if math.dist(here[1], RADAR_NEA_M) <= RANGE_M
    ]
    nearest_m = min(math.dist(place, RADAR_NEA_M) for _, place in rows)
    exposure = facts.exposure
    assert exposure.duration_s == pytest.approx(sum(s for s, _ in pairs), abs=0.2)
    assert exposure.length_m == pytest.approx(sum(m for _, m in pairs), rel=0.02)
    assert exposure.duration_s > 5.0
    detection = RANGE_M**4 / (RANGE_M**4 + nearest_m**4)
    assert exposure.detection == pytest.approx(detection, rel=1e-6)
    assert exposure.radar == "near <&>"


def write_log(run: Path, records: list[Record]) -> None:
    log = b"".join(struct.pack(">Q", at_us) + bytes(m.get_msgbuf()) for at_us, m in records)
    (run / "flight.tlog").write_bytes(log)


def test_times_without_a_fix_and_gaps_of_setpoints_are_those_of_the_log(copy: Path) -> None:
    codec, changed, sent_s = wire.MAVLink(None, srcSystem=1, srcComponent=1), [], list[float]()
    for at_us, m in records_of(copy):
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
        changed.append((at_us, m))
    write_log(copy, changed)
    facts = facts_of(copy)
    assert facts.without_fix_s == pytest.approx(10.0, abs=1.0)
    assert facts.fewest_satellites == 2.0
    flying_s = np.array(sent_s)[np.array(sent_s) > 45.0]
    assert facts.setpoint_gap_s == pytest.approx(np.diff(flying_s).max(), abs=1e-6)
    assert facts.setpoint_gap_s > 1.5


def test_holds_plans_and_times_are_those_of_the_files(run_dir: Path, page: str) -> None:
    said, words = entries(run_dir), words_of(page)
    held = [e for e in said if e["kind"] == "phase" and "holding" in (e["phase"], e["was"])]
    assert f"Holds 1, {held[1]['t_s'] - held[0]['t_s']:.0f} s in all paused by a person" in words
    assert "Planning time, median 300 ms, longest 900 ms T is" in words
    assert "2 of 2 subpaths flown; 0 plans refused, 0 late" in words
    assert "2026-05-04 10:20:30 UTC" in words
    assert "✔ Arrived : target reached" in words.replace("Arrived:", "Arrived :")
    for entry in said:
        if entry["kind"] == "plan ready":
            assert f" {entry['length_m']:,.0f} {entry['evaluations']:,} " in words
    assert f"{sum(e['kind'] == 'say' for e in said)}" == f"{words.count('companion: ')}"
    assert "cut as time was up" not in words


# --- the page


def test_the_page_is_whole_and_loads_nothing(page: str) -> None:
    """Each figure is XML, and holds what it refers to."""
    read = lxml.html.fromstring(page)
    loads = {"script", "link", "iframe", "object", "embed", "base", "form", "img"}
    assert not loads & {each.tag for each in read.iter()}
    assert not read.xpath("//@*[starts-with(name(), 'on')]")
    links = {"src", "href", "xlink:href", "action", "srcset", "data", "poster"}
    for link in (each.get(name) for each in read.iter() for name in links & {*each.keys()}):
        assert link.startswith(("#", "data:image/png;base64,"))
    assert "@import" not in page
    assert all(url.startswith("#") for url in re.findall(r"url\(([^)]*)\)", page))
    assert "default-src 'none'" in page
    ids = read.xpath("//@id")
    assert len(ids) == len(set(ids))
    figures = re.findall(r"<svg.*?</svg>", page, flags=re.DOTALL)
    assert len(figures) == 2
    for figure in figures:
        root = lxml.etree.fromstring(figure.encode())
        assert root.tag == "{http://www.w3.org/2000/svg}svg"
        assert set(re.findall(r'(?:href="#|url\(#)([^")]*)', figure)) <= set(root.xpath("//@id"))


def test_what_comes_from_the_flight_is_text_and_no_markup(copy: Path) -> None:
    with (copy / "mission.toml").open("a", encoding="utf-8") as file:
        file.write(f"# {EVIL}\n" + RADAR.format(EVIL, 3000.0, 3000.0, 3000.0, 2000.0))
    evil = [
        {"t_s": 50.0, "kind": "vehicle says", "text": EVIL},
        {"t_s": 51.0, "kind": "part died", "error": EVIL},
        {"t_s": 52.0, "kind": "end", "outcome": "failed", "reason": EVIL},
    ]
    with (copy / "journal.jsonl").open("a") as file:
        file.writelines(json.dumps(each) + "\n" for each in evil)
    (copy / "run.json").write_text(json.dumps({"companion": EVIL, "began": EVIL}))
    page = report_of(copy)
    assert not lxml.html.fromstring(page).xpath("//script")
    assert words_of(page).count(EVIL) >= 5
    assert f"✘ Failed: {EVIL}" in words_of(page)  # by the last end
    for figure in re.findall(r"<svg.*?</svg>", page, flags=re.DOTALL):
        lxml.etree.fromstring(figure.encode())


# --- what is not there, or otherwise


def without_a_map(run: Path) -> None:
    (run / "known.npz").unlink()
    (run / "inputs.msgpack").unlink()


def with_odd_values(run: Path) -> None:
    odd = {"planning_s": ["x", None], "began": 5, "times_real_time": "fast", "companion": [1]}
    (run / "run.json").write_text(json.dumps(odd))


def cut_by_time(run: Path) -> None:
    refused = {"kind": "plan refused", "plan_id": 9, "reason": "OUT_OF_TIME", "broken": []}
    refused |= {"t_s": 90.0, "evaluations": 341, "out_of_time": True}
    header, *_ = (run / "journal.jsonl").read_text().splitlines()
    said = [e | {"out_of_time": True} if e["kind"] == "plan ready" else e for e in entries(run)]
    lines = [header, *map(json.dumps, [*said, refused])]
    (run / "journal.jsonl").write_text("\n".join(lines) + "\n")


def failed(run: Path) -> None:
    end = '"outcome":"{}","reason":"{}"'
    was, now = end.format("arrived", "target reached"), end.format("failed", "the vehicle disarmed")
    text = (run / "journal.jsonl").read_text()
    assert was in text
    (run / "journal.jsonl").write_text(text.replace(was, now))


ODD: dict[str, tuple[Callable[[Path], object], list[str]]] = {
    "no map": (without_a_map, ["the known map was not recorded"]),
    "a damaged run.json": (lambda run: (run / "run.json").write_bytes(b"\0{"), ["run.json: "]),
    "a damaged map": (lambda run: (run / "known.npz").write_bytes(b"\0{"), ["known.npz: "]),
    "odd values": (with_odd_values, ["Planning time, median not recorded"]),
    "out of time": (
        cut_by_time,
        [
            "; of 3 the search was cut as time was up: raise planner.planning_time_s",
            "plan 9 refused: OUT_OF_TIME; time was up after 341 candidates",
        ],
    ),
    "failed": (
        failed,
        [
            "✘ Failed: the vehicle disarmed",
            "Held before: paused by a person (",
            "What to do: See its messages for the reason.",
            "from the last target at the end",
        ],
    ),
}


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("what", ODD)
def test_what_is_odd_about_a_flight_is_told(copy: Path, what: str) -> None:
    change, expected = ODD[what]
    change(copy)
    words = words_of(report_of(copy))
    for each in expected:
        assert each in words
    assert ("Nearest to known terrain" in words) == (what not in ("no map", "a damaged map"))


def test_a_map_that_was_not_kept_grows_again_in_a_replay(tmp_path: Path) -> None:
    fly_short(tmp_path / "run")
    journal = tmp_path / "run" / "journal.jsonl"
    head = {"mission": "", "seed": 1, "profile": "flight", "lockstep": True}
    first, _, rest = journal.read_text().partition("\n")
    whole = json.dumps(json.loads(first) | head, separators=(",", ":"))
    journal.write_text(f"{whole}\n{rest}")
    kept = facts_of(tmp_path / "run").known
    (tmp_path / "run" / "known.npz").unlink()
    again = facts_of(tmp_path / "run").known
    assert kept is not None
    assert again is not None
    assert kept.seen.sum() > 1000
    assert digest_of(again) == digest_of(kept)
