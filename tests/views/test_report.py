"""The report of a flight, held against what was recorded, read by parsers that are not ours."""

import json
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
from companion.views.report import FlightFacts
from companion.world.known_map import KnownMap, digest_of, empty_map, packed_map

GEOD = pyproj.Geod(ellps="WGS84")
EVIL = "</pre></svg><script>alert('x')</script>"
RADAR = '[[radars]]\nname = "{}"\nnorth_m = {}\neast_m = {}\naltitude_amsl_m = {}\nrange_m = {}\n'
RADAR_NEA_M, RANGE_M = (2000.0, 1500.0, 3000.0), 900.0
TARGET_NE_M = (4000.0, 3000.0)


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
    read = lxml.html.fromstring(page)
    for drawn in read.xpath("//style | //*[local-name() = 'svg']"):
        drawn.drop_tree()
    return " ".join(" ".join(read.itertext()).split()).replace(" : ", ": ")


def figures_of(page: str) -> dict[str, Any]:
    """Text and tree of each."""
    texts = re.findall(r"<svg.*?</svg>", page, flags=re.DOTALL)
    return {text: lxml.etree.fromstring(text.encode()) for text in texts}


def records_of(run: Path) -> list[tuple[int, Any]]:
    """Stamp, in microseconds, and message of each."""
    return list(frames_of((run / "flight.tlog").read_bytes()))


def entries(run: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (run / "journal.jsonl").read_text().splitlines()[1:]]


# --- the numbers


def test_the_numbers_are_those_of_the_positions_from_the_end_of_the_climb_to_the_end(
    run_dir: Path, facts: FlightFacts
) -> None:
    phases = {e["phase"]: e["t_s"] for e in reversed(entries(run_dir)) if e["kind"] == "phase"}
    log = [m for _, m in records_of(run_dir) if m.get_type() == "GLOBAL_POSITION_INT" and m.lat]
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
    assert facts.nearest is not None
    assert facts.nearest.distance_m < facts.clearance_reach_m
    assert facts.nearest.distance_m == pytest.approx(away_m.min(), abs=1e-6)
    assert facts.nearest.time_s == pytest.approx(times_s[away_m.argmin()], abs=1e-6)
    # those within the range of the radar
    to_radar_m = np.linalg.norm(places - RADAR_NEA_M, axis=1)
    within = to_radar_m[:-1] <= RANGE_M
    exposure = facts.exposure
    assert exposure.radar == "near <&>"
    assert exposure.duration_s == pytest.approx(np.diff(times_s)[within].sum(), abs=0.2)
    assert exposure.duration_s > 5.0
    detection = RANGE_M**4 / (RANGE_M**4 + to_radar_m.min() ** 4)
    assert exposure.detection == pytest.approx(detection, rel=1e-6)


def test_times_without_a_fix_and_gaps_of_setpoints_are_those_of_the_log(copy: Path) -> None:
    codec, log, sent_s = wire.MAVLink(None, srcSystem=1, srcComponent=1), b"", list[float]()
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
        log += struct.pack(">Q", at_us) + bytes(m.get_msgbuf())
    (copy / "flight.tlog").write_bytes(log)
    facts = facts_of(copy)
    assert facts.without_fix_s == pytest.approx(10.0, abs=1.0)
    flying_s = np.array(sent_s)[np.array(sent_s) > 45.0]
    assert facts.setpoint_gap_s == pytest.approx(np.diff(flying_s).max(), abs=1e-6)
    assert facts.setpoint_gap_s > 1.5


# --- the page


def test_holds_plans_and_times_are_those_of_the_files(run_dir: Path, page: str) -> None:
    said, words = entries(run_dir), words_of(page)
    held = [e for e in said if e["kind"] == "phase" and "holding" in (e["phase"], e["was"])]
    for expected in (
        f"Holds 1, {held[1]['t_s'] - held[0]['t_s']:.0f} s in all paused by a person",
        "Planning time, median 300 ms, longest 900 ms T is",
        "2 of 2 subpaths flown; 0 plans refused, 0 late",
        "✔ Arrived: target reached",
        *(
            f" {e['length_m']:,.0f} {e['evaluations']:,} "
            for e in said
            if e["kind"] == "plan ready"
        ),
    ):
        assert expected in words
    assert sum(e["kind"] == "say" for e in said) == words.count("companion: ")
    assert "cut as time was up" not in words


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
    figures = figures_of(page)
    assert len(figures) == 2
    for text, root in figures.items():
        assert root.tag == "{http://www.w3.org/2000/svg}svg"
        assert set(re.findall(r'(?:href="#|url\(#)([^")]*)', text)) <= set(root.xpath("//@id"))


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
    assert figures_of(page)


# --- what is not there, or otherwise


def without_a_map(run: Path) -> None:
    (run / "known.npz").unlink()
    (run / "inputs.msgpack").unlink(missing_ok=True)


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
    end = {"t_s": 99.0, "kind": "end", "outcome": "failed", "reason": "the vehicle disarmed"}
    with (run / "journal.jsonl").open("a") as file:
        file.write(json.dumps(end) + "\n")


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
    assert kept.seen.sum() > 1000
    assert digest_of(again) == digest_of(kept)
