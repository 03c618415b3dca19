"""The report of a campaign: whole, empty, of one run, of failures, interrupted, hostile."""

import csv
import html
import json
import re
import shlex
from dataclasses import asdict, replace
from pathlib import Path

import lxml.etree
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from campaign_rows import paired_rows, row

from companion.campaign.report import read_campaign, report_html, report_lines, report_of
from companion.campaign.row import Row, schema
from companion.cli import main

SOURCE = ["a campaign.toml", "--seeds", "3"]
EVIL = "</pre></svg><script>alert('x')</script>"


def campaign(folder: Path, rows: list[Row], expected: int | None = None) -> Path:
    (folder / "rows").mkdir(parents=True)
    for at in range(0, len(rows), 30):
        table = pa.Table.from_pylist([asdict(each) for each in rows[at : at + 30]], schema())
        pq.write_table(table, folder / "rows" / f"part-{at:06d}.parquet")
    count = len(rows) if expected is None else expected
    facts = {"digest": "x", "runs": count, "source": SOURCE}
    (folder / "runs.json").write_text(json.dumps(facts))
    return folder


def page_of(folder: Path, by: tuple[str, ...] = ()) -> str:
    return report_html(report_of(read_campaign(folder), by))


def words_of(page: str) -> str:
    shown = re.sub(r"<style>.*?</style>|<svg.*?</svg>", "", page, flags=re.DOTALL)
    return " ".join(html.unescape(re.sub(r"<[^>]*>", " ", shown)).split())


def run(*arguments: str, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr("sys.argv", ["companion", "campaign", "report", *arguments])
    with pytest.raises(SystemExit) as end:
        main()
    return int(end.value.code or 0)


def failed(count: int) -> list[Row]:
    return [
        row(n, arrived=False, outcome="failed", reason="stuck", cost=None, length_m=None)
        for n in range(count)
    ]


def test_the_page_is_one_file_that_loads_nothing_and_says_what_follows(tmp_path: Path) -> None:
    page = page_of(campaign(tmp_path / "c", paired_rows()))
    for url in re.findall(r"""(?:src|href|url)\s*[=(]\s*["']?([^"')\s>]+)""", page):
        assert url.startswith("#"), url
    assert "<script" not in page
    for svg in re.findall(r"<svg.*?</svg>", page, flags=re.DOTALL):
        lxml.etree.fromstring(svg)
    said = words_of(page)
    assert "l-shade is better than refined-de" in said
    assert "nothing follows, too few pairs differ (3 of 40)" in said
    assert "up to 3 of 40 pairs are left out" in said


@pytest.mark.parametrize(
    "rows", [[], [row(0)], failed(1), failed(30), [row(0, error="ValueError: no", arrived=False)]]
)
def test_there_is_a_page_of_nothing_of_one_run_and_of_failures(
    tmp_path: Path, rows: list[Row], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = campaign(tmp_path / "c", rows, 40)
    assert run(str(folder), monkeypatch=monkeypatch) == 0
    said = words_of((folder / "report.html").read_text())
    assert "nan" not in said
    assert f"{40 - len(rows)} of 40 runs have no row yet" in said


def test_an_unfinished_campaign_says_so_and_a_finished_one_does_not(tmp_path: Path) -> None:
    rows = paired_rows()
    assert "Not finished" in page_of(campaign(tmp_path / "a", rows[:50], len(rows)))
    assert "Not finished" not in page_of(campaign(tmp_path / "b", rows))


def test_what_comes_from_outside_is_shown_and_not_obeyed(tmp_path: Path) -> None:
    evil = {"world": EVIL, "key": EVIL, "reason": EVIL, "outcome": EVIL, "faults": EVIL}
    rows = [row(n, **evil, arrived=False, cost=None, error=EVIL) for n in range(3)]
    page = page_of(campaign(tmp_path / "c", [*rows, row(7)]))
    assert "<script" not in page
    assert EVIL in words_of(page)


def test_the_worst_runs_are_listed_with_a_command_that_shows_them_again(tmp_path: Path) -> None:
    folder = campaign(
        tmp_path / "a folder",
        [
            *(row(n, cost=10.0 + n) for n in range(30)),
            row(30, violations=2, violated="leg 3: terrain", folder="runs/000030"),
            row(31, clearance_least_m=-3.0),
        ],
    )
    report = report_of(read_campaign(folder))
    worst = {each.kind: each for each in report.worst}
    ((bad, said, command),) = worst["Violations"].shown
    assert (bad.run, said) == (30, "2: leg 3: terrain")
    assert shlex.split(command) == ["companion", "replay", str(folder / "runs/000030")]
    assert worst["Dearest"].shown[0][0].run == 29
    lowest, _, command = worst["Least clearance"].shown[0]
    assert lowest.run == 31
    words = shlex.split(command)
    assert words[:8] == ["companion", "campaign", "run", *SOURCE, "--only", "31"]


def test_a_row_that_is_there_twice_counts_once_and_is_told(tmp_path: Path) -> None:
    rows = paired_rows(4)
    report = report_of(read_campaign(campaign(tmp_path / "c", [*rows, rows[3]])))
    assert report.overall.runs == 8
    assert "1 rows repeat" in " ".join(report_lines(report))


def test_csv_has_every_row_and_every_figure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = paired_rows()
    rows[0] = replace(rows[0], violated='a "quoted", odd\nvalue')
    folder, out = campaign(tmp_path / "c", rows), tmp_path / "all.csv"
    assert run(str(folder), "--csv", str(out), monkeypatch=monkeypatch) == 0
    with (tmp_path / "all-rows.csv").open(newline="") as file:
        read = list(csv.DictReader(file))
    assert [int(each["run"]) for each in read] == [each.run for each in rows]
    assert read[0]["violated"] == rows[0].violated
    with out.open(newline="") as file:
        figures = list(csv.DictReader(file))
    (arrived,) = (f for f in figures if not f["by"] and f["measure"] == "arrived")
    assert float(arrived["value"]) == pytest.approx(77 / 80)
    (cost,) = (f for f in figures if f["kind"] == "pairs" and f["measure"] == "cost")
    assert (cost["group"], cost["against"], cost["n"]) == ("l-shade", "refined-de", "37")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere"], "it holds no campaign"),
        (["c", "--by", "colour"], "no such factor. Choose from: world,"),
        (["c", "--html", "no/such/x.html"], "not written"),
    ],
)
def test_wrong_input_is_one_line(
    arguments: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    campaign(tmp_path / "c", paired_rows(2))
    monkeypatch.chdir(tmp_path)
    assert run(*arguments, monkeypatch=monkeypatch) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith("error: ")
    assert said in line


def test_a_damaged_part_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = campaign(tmp_path / "c", paired_rows(2))
    (folder / "rows" / "part-000000.parquet").write_bytes(b"PAR1 not at all PAR1")
    assert run(str(folder), monkeypatch=monkeypatch) == 2
    assert "cannot be read" in capsys.readouterr().err


def test_factors_are_grouped_together_when_asked_for(tmp_path: Path) -> None:
    folder = campaign(tmp_path / "c", paired_rows())
    (section,) = report_of(read_campaign(folder), ("profile", "optimiser")).sections
    assert [each.label for each in section.groups] == [
        ("flight", "refined-de"),
        ("flight", "l-shade"),
    ]
    assert len(section.comparisons) == 1
