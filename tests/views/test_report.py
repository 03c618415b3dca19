"""The report of a flight, held against what was recorded, read by parsers that are not ours."""

import html.parser
import json
import math
import re
import shutil
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import lxml.etree
import numpy as np
import pyproj
import pytest
from answers import answered
from pymavlink.dialects.v20 import all as wire
from recorded import EPOCH_US, run_folder
from short_flight import fly_short

from companion.config import load_mission
from companion.replay.exporting import facts_of, write_report
from companion.views.report_facts import FlightFacts
from companion.world.known_map import KnownMap, digest_of, empty_map, packed_map

GEOD = pyproj.Geod(ellps="WGS84")
EVIL = "</pre></svg><script>alert('x')</script>"
RADAR = '[[radars]]\nname = "{}"\nnorth_m = {}\neast_m = {}\naltitude_amsl_m = {}\nrange_m = {}\n'
VOID = {"meta", "br", "img", "input", "link", "hr"}


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short flight past a radar, over a hill that came to be known."""
    run = run_folder(tmp_path_factory.mktemp("recorded"))
    radar = RADAR.format("near <&>", 2000.0, 1500.0, 3000.0, 900.0)
    with (run / "mission.toml").open("a", encoding="utf-8") as file:
        file.write(radar)
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


def records_of(run: Path) -> list[tuple[int, bytes]]:
    """Stamp and frame of each record of the log."""
    log, records, at = (run / "flight.tlog").read_bytes(), [], 0
    while at < len(log):
        end = at + 8 + 12 + log[at + 9]
        records.append((struct.unpack_from(">Q", log, at)[0], log[at + 8 : end]))
        at = end
    return records


def positions(run: Path) -> list[tuple[float, float, float, float]]:
    """Vehicle time, latitude, longitude, altitude, by pymavlink."""
    parser, found = wire.MAVLink(None), []
    for _, frame in records_of(run):
        message: Any = parser.decode(bytearray(frame))
        if message.get_type() == "GLOBAL_POSITION_INT" and message.lat:
            place = message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3
            found.append((message.time_boot_ms * 1e-3, *place))
    return found


def entries(run: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (run / "journal.jsonl").read_text().splitlines()[1:]]


def on_the_way(run: Path) -> list[tuple[float, float, float, float]]:
    """Positions from the end of the climb on, until the mission is over."""
    phases = [(e["t_s"], e["phase"]) for e in entries(run) if e["kind"] == "phase"]
    begin = next(t_s for t_s, phase in phases if phase == "flying")
    end = next(t_s for t_s, phase in phases if phase == "done")
    return [each for each in positions(run) if begin <= each[0] < end]


# --- the numbers


def test_the_length_flown_is_that_of_the_geodesics_between_the_positions(
    run_dir: Path, facts: FlightFacts
) -> None:
    rows = on_the_way(run_dir)
    expected = GEOD.line_length([r[2] for r in rows], [r[1] for r in rows])
    assert facts.flown_m == pytest.approx(expected, rel=2e-3)
    target = facts.flight.mission.frame.to_geodetic_deg(4000.0, 3000.0)
    straight = GEOD.line_length([rows[0][2], target[1]], [rows[0][1], target[0]])
    assert facts.straight_m == pytest.approx(straight, rel=1e-4)
    left = GEOD.line_length([rows[-1][2], target[1]], [rows[-1][1], target[0]])
    assert facts.left_m == pytest.approx(left, abs=0.1)
    assert facts.duration_s == pytest.approx(rows[-1][0] - rows[0][0], abs=0.01)


def test_the_worst_clearance_is_that_of_every_position_to_every_known_cell(
    run_dir: Path, facts: FlightFacts
) -> None:
    known, frame = hill(run_dir), facts.flight.mission.frame
    rows, columns = np.nonzero(known.seen)
    near = known.upper_m[rows, columns] > 300.0
    rows, columns = rows[near], columns[near]
    south, west = known.north_min_m + rows * known.cell_m, known.east_min_m + columns * known.cell_m
    least, where = math.inf, 0.0
    for t_s, latitude, longitude, up in on_the_way(run_dir):
        north, east = frame.to_local_m(latitude, longitude)
        aside = np.hypot(
            np.clip(north, south, south + known.cell_m) - north,
            np.clip(east, west, west + known.cell_m) - east,
        )
        over = np.maximum(up - known.upper_m[rows, columns], 0.0)
        gaps = np.hypot(np.maximum(aside - known.registration_m, 0.0), over)
        if gaps.min() < least:
            least, where = gaps.min(), t_s
    assert facts.nearest is not None
    assert not facts.nearest.is_bound
    assert facts.nearest.distance_m == pytest.approx(least, abs=1e-6)
    assert facts.nearest.time_s == pytest.approx(where, abs=1e-6)


@pytest.mark.usefixtures("undrawn")
def test_far_from_all_terrain_the_clearance_is_a_bound(copy: Path) -> None:
    known = hill(copy)
    low = np.where(known.seen, -9000.0, np.inf)
    (copy / "known.npz").write_bytes(packed_map(replace(known, upper_m=low)))
    facts = facts_of(copy)
    assert facts.nearest is not None
    assert facts.nearest.is_bound
    assert "more than" in words_of(report_of(copy))


def test_the_exposure_is_that_of_the_positions_within_the_range(
    run_dir: Path, facts: FlightFacts
) -> None:
    frame, inside_s, inside_m, nearest = facts.flight.mission.frame, 0.0, 0.0, math.inf
    rows = on_the_way(run_dir)
    points = [(*frame.to_local_m(lat, lon), up) for _, lat, lon, up in rows]
    for (t_s, *_), (next_s, *_), here, there in zip(
        rows, rows[1:], points, points[1:], strict=False
    ):
        away = math.dist(here, (2000.0, 1500.0, 3000.0))
        nearest = min(nearest, away)
        if away <= 900.0:
            inside_s += next_s - t_s
            inside_m += math.dist(here, there)
    exposure = facts.exposure
    assert inside_s > 5.0
    assert exposure.duration_s == pytest.approx(inside_s, abs=0.2)
    assert exposure.length_m == pytest.approx(inside_m, rel=0.02)
    assert exposure.detection == pytest.approx(900.0**4 / (900.0**4 + nearest**4), rel=1e-6)
    assert exposure.radar == "near <&>"


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


@pytest.mark.usefixtures("undrawn")
def test_plans_that_time_has_cut_are_told_with_the_remedy(copy: Path) -> None:
    said = entries(copy)
    refused = {"kind": "plan refused", "plan_id": 9, "reason": "OUT_OF_TIME", "broken": []}
    refused |= {"t_s": said[-1]["t_s"], "evaluations": 341, "out_of_time": True}
    found = [e | {"out_of_time": True} if e["kind"] == "plan ready" else e for e in said]
    header, *_ = (copy / "journal.jsonl").read_text(encoding="utf-8").splitlines()
    lines = [header, *map(json.dumps, [*found, refused])]
    (copy / "journal.jsonl").write_text("\n".join(lines) + "\n", encoding="utf-8")
    words = words_of(report_of(copy))
    many = 1 + sum(e["kind"] == "plan ready" for e in said)
    assert f"; of {many} the search was cut as time was up: raise planner.planning_time_s" in words
    assert "plan 9 refused: OUT_OF_TIME; time was up after 341 candidates" in words


def write_log(run: Path, records: list[tuple[int, bytes]]) -> None:
    log = b"".join(struct.pack(">Q", stamp_us) + frame for stamp_us, frame in records)
    (run / "flight.tlog").write_bytes(log)


def test_missing_frames_and_silences_are_counted(copy: Path, facts: FlightFacts) -> None:
    records = records_of(copy)
    of_autopilot = [k for k, each in enumerate(records) if each[1][6] == 1]
    dropped = set(of_autopilot[500:520]) | {of_autopilot[700]}
    write_log(copy, [each for k, each in enumerate(records) if k not in dropped])
    found = facts_of(copy)
    assert found.lost - facts.lost == len(dropped)
    assert found.heard == len(of_autopilot) - len(dropped)
    left = np.array([records[k][0] for k in of_autopilot if k not in dropped])
    assert found.silence_s == pytest.approx(1e-6 * np.diff(left).max())


def test_times_without_a_fix_and_gaps_of_setpoints_are_those_of_the_log(copy: Path) -> None:
    parser, changed, sent_us = wire.MAVLink(None, srcSystem=1, srcComponent=1), [], list[int]()
    for stamp_us, frame in records_of(copy):
        message: Any = parser.decode(bytearray(frame))
        time_s = (stamp_us - EPOCH_US) * 1e-6
        if message.get_type() == "GPS_RAW_INT":
            message.satellites_visible = 9
            if 60.0 <= time_s < 70.0:
                message.fix_type, message.satellites_visible = 1, 2
            parser.seq = frame[4]
            frame = message.pack(parser)
        if (
            message.get_type() == "SET_POSITION_TARGET_GLOBAL_INT"
            and message.get_srcComponent() == 195
        ):
            if 50.0 <= time_s < 51.5:
                continue
            sent_us.append(stamp_us)
        changed.append((stamp_us, frame))
    write_log(copy, changed)
    facts, sent_s = facts_of(copy), (np.array(sent_us) - EPOCH_US) * 1e-6
    assert facts.without_fix_s == pytest.approx(10.0, abs=1.0)
    assert facts.fewest_satellites == 2.0
    assert facts.setpoint_gap_s == pytest.approx(np.diff(sent_s[sent_s > 45.0]).max(), abs=1e-6)
    assert facts.setpoint_gap_s > 1.5


# --- the page


class Page(html.parser.HTMLParser):
    """The elements of a page, and whether they are closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: set[str] = set()
        self.ids: list[str] = []
        self.links: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        for name, value in attrs:
            assert not name.startswith("on"), name
            if name == "id":
                self.ids.append(value or "")
            if name in ("src", "href", "xlink:href", "action", "srcset", "data", "poster"):
                self.links.append(value or "")
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_the_page_is_whole_and_loads_nothing(page: str) -> None:
    read = Page(page)
    assert not read.open
    assert not read.tags & {"script", "link", "iframe", "object", "embed", "base", "form", "img"}
    assert all(link.startswith(("#", "data:image/png;base64,")) for link in read.links)
    styles = re.findall(r"<style.*?</style>", page, flags=re.DOTALL)
    assert not any("@import" in style or "url(" in style for style in styles[:1])
    assert all(url.startswith("#") for url in re.findall(r"url\(([^)]*)\)", page))
    assert "default-src 'none'" in page
    assert len(read.ids) == len(set(read.ids))


def test_each_figure_is_valid_xml_and_holds_what_it_refers_to(page: str) -> None:
    figures = re.findall(r"<svg.*?</svg>", page, flags=re.DOTALL)
    assert len(figures) == 2
    for figure in figures:
        root = lxml.etree.fromstring(figure.encode())
        assert root.tag == "{http://www.w3.org/2000/svg}svg"
        ids = set(root.xpath("//@id"))
        wanted = set(re.findall(r'(?:href="#|url\(#)([^")]*)', figure))
        assert wanted <= ids


def test_what_comes_from_the_flight_is_text_and_no_markup(copy: Path) -> None:
    mission = (copy / "mission.toml").read_text(encoding="utf-8")
    mission += f"# {EVIL}\n" + RADAR.format(EVIL, 3000.0, 3000.0, 3000.0, 2000.0)
    (copy / "mission.toml").write_text(mission, encoding="utf-8")
    evil = [
        {"t_s": 50.0, "kind": "vehicle says", "text": EVIL},
        {"t_s": 51.0, "kind": "part died", "error": EVIL},
        {"t_s": 52.0, "kind": "end", "outcome": "failed", "reason": EVIL},
    ]
    with (copy / "journal.jsonl").open("a") as file:
        file.writelines(json.dumps(each) + "\n" for each in evil)
    (copy / "run.json").write_text(json.dumps({"companion": EVIL, "began": EVIL}))
    page = report_of(copy)
    read = Page(page)
    assert not read.open
    assert "script" not in read.tags
    assert words_of(page).count(EVIL) >= 5
    assert f"✘ Failed: {EVIL}" in words_of(page)  # by the last end
    for figure in re.findall(r"<svg.*?</svg>", page, flags=re.DOTALL):
        lxml.etree.fromstring(figure.encode())


def test_the_same_flight_gives_the_same_page(run_dir: Path, page: str, tmp_path: Path) -> None:
    write_report(run_dir, tmp_path / "again.html")
    assert (tmp_path / "again.html").read_text(encoding="utf-8") == page


# --- what is not there


def test_without_a_map_it_says_so(copy: Path) -> None:
    (copy / "known.npz").unlink()
    (copy / "inputs.msgpack").unlink()
    words = words_of(report_of(copy))
    assert "the known map was not recorded" in words
    assert "Nearest to known terrain" not in words


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


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("name", ["run.json", "known.npz"])
def test_damaged_files_beside_the_record_are_named(copy: Path, name: str) -> None:
    (copy / name).write_bytes(b"\x00{")
    assert f"{name}: " in words_of(report_of(copy))


@pytest.mark.usefixtures("undrawn")
def test_a_run_json_with_other_values_than_ours_is_told_without_them(copy: Path) -> None:
    odd = {"planning_s": ["x", None], "began": 5, "times_real_time": "fast", "companion": [1]}
    (copy / "run.json").write_text(json.dumps(odd))
    assert "Planning time, median not recorded" in words_of(report_of(copy))


@pytest.mark.sample(2)
@pytest.mark.parametrize("share", [0.0, 0.02, 0.3, 0.7, 0.97])
def test_a_flight_that_was_cut_off_is_told_as_far_as_it_goes(copy: Path, share: float) -> None:
    for name in ("journal.jsonl", "flight.tlog"):
        data = (copy / name).read_bytes()
        (copy / name).write_bytes(data[: int(share * len(data))])
    words = words_of(report_of(copy))
    assert "Not ended" in words
    planned = b'"kind":"plan ready"' in (copy / "journal.jsonl").read_bytes()
    assert ("None was planned" in words) is not planned


@pytest.mark.usefixtures("undrawn")
def test_a_failed_flight_says_why_and_what_led_to_it(copy: Path) -> None:
    text = (copy / "journal.jsonl").read_text()
    end = '"outcome":"arrived","reason":"target reached"'
    assert end in text
    failed = '"outcome":"failed","reason":"the vehicle disarmed"'
    (copy / "journal.jsonl").write_text(text.replace(end, failed))
    words = words_of(report_of(copy))
    assert "✘ Failed: the vehicle disarmed" in words
    assert re.search(r"Held before: paused by a person \(\d+ s\)\.", words)
    assert "What to do: See its messages for the reason." in words
    assert "from the last target at the end" in words


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("mission.toml", "it holds no mission.toml"),
        ("flight.tlog", "it holds no flight.tlog"),
        ("journal.jsonl", "No such file"),
    ],
)
def test_without_the_record_itself_it_is_one_line_and_exit_code_2(
    copy: Path, name: str, words: str
) -> None:
    (copy / name).unlink()
    code, _, said = answered("report", copy)
    assert code == 2
    assert words in said
    assert len(said.splitlines()) == 1
    assert not (copy / "report.html").exists()


@pytest.mark.usefixtures("undrawn")
def test_the_command_writes_beside_the_flight_and_never_over_it(copy: Path) -> None:
    assert answered("report", copy)[::2] == (0, "")
    assert (copy / "report.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    code, _, said = answered("report", copy, "--out", copy / "flight.tlog")
    assert code == 2
    assert "that is what the flight was recorded in" in said
    assert answered("report", copy, "--out", copy / "none" / "x.html")[0] == 2
    assert "not written" in answered("report", copy, "--out", "/dev/full")[2]
