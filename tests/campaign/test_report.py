"""The report of a campaign: whole, empty, of one run, of failures, interrupted, hostile."""

import json
import re
import shlex
from pathlib import Path

import pytest
from answers import answered, assert_it_loads_nothing, words_of
from campaign_rows import paired_rows, row

from companion.campaign.report import figures_csv, read_campaign, report_of
from companion.campaign.store import Row, table

SOURCE = ["a campaign.toml", "--seeds", "3"]
EVIL = "</pre></svg><script>alert('x')</script>"
LOST = {"arrived": False, "outcome": "failed", "reason": "stuck", "cost": None, "length_m": None}
EVILS = dict.fromkeys(("world", "key", "reason", "outcome", "faults", "error"), EVIL)


def campaign(folder: Path, rows: list[Row], expected: int | None = None) -> Path:
    (folder / "rows").mkdir(parents=True)
    for at in range(0, len(rows), 30):
        table(rows[at : at + 30]).write_parquet(folder / "rows" / f"part-{at:06d}.parquet")
    count = len(rows) if expected is None else expected
    facts = {"digest": "x", "runs": count, "source": SOURCE}
    (folder / "runs.json").write_text(json.dumps(facts))
    return folder


def test_the_page_loads_nothing_and_says_what_follows_and_the_terminal_says_it_too(
    tmp_path: Path,
) -> None:
    folder = campaign(tmp_path / "c", paired_rows())
    code, shown, _ = answered("campaign", "report", folder)
    assert code == 0
    page = (folder / "report.html").read_text()
    assert_it_loads_nothing(page)
    said = words_of(page)
    assert re.search(r"refined-de 40 100\.0 \[91\.2, 100\.0\] 0\.0 \[0\.0, 8\.8\]", said)
    assert re.search(r"l-shade 40 92\.5 \[80\.1, 97\.4\]", said)
    assert re.search(r"l-shade refined-de cost J 37 -\S+ \[\S+ -\S+\] % 28 0 9 ", said)
    assert "Not finished" not in said
    figures = report_of(read_campaign(folder)).figures
    header, first, *others = figures_csv(report_of(read_campaign(folder))).splitlines()
    assert header.startswith("by,group,against,measure,n,value,low,high,wins")
    assert first.startswith(",all,,arrived,80,0.9625,")
    assert len(others) == len(figures) - 1
    for words in ("By optimiser", "In pairs", "Not arrived, first: hill/1: failed: stuck (3 runs)"):
        assert words in shown


@pytest.mark.parametrize(
    ("count", "values"),
    [
        *((0, {}), (1, {}), (1, LOST), (30, LOST), (3, LOST | EVILS)),
        (1, {"clearance_least_t_s": float("nan")}),
    ],
    ids=["nothing", "one run", "one failure", "failures", "evil", "at no time"],
)
def test_there_is_a_page_of_any_runs_on_which_their_words_are_text(
    tmp_path: Path, count: int, values: Row
) -> None:
    folder = campaign(tmp_path / "c", [row(n, **values) for n in range(count)], 40)
    assert answered("campaign", "report", folder)[0] == 0
    page = (folder / "report.html").read_text()
    assert_it_loads_nothing(page)
    said = words_of(page)
    assert "nan" not in said
    assert f"Not finished: {40 - count} of 40 runs have no row yet" in said
    assert (EVIL in said) == (values.get("key") == EVIL)


def test_the_worst_runs_are_listed_with_a_command_that_shows_them_again(tmp_path: Path) -> None:
    lost = {"arrived": False, "outcome": "failed"}
    rows = [
        *(row(n, cost=10.0 + n) for n in range(30)),
        row(30, violations=2, violated="leg 3: terrain", folder="runs/000030"),
        row(31, clearance_least_m=-3.0, clearance_least_t_s=12.3),
        *(row(n, **lost, reason="stuck") for n in (32, 33)),
        row(34, **lost, reason="lost"),
        row(35, violations=3, violated="join"),
        row(36, cost=999.0, world="another", clearance_least_m=None),
    ]
    folder = campaign(tmp_path / "a folder", rows)
    sheets = {sheet.title: sheet.rows for sheet in report_of(read_campaign(folder)).worst}
    first = {title: [(run, said) for run, _, said, _ in rows][:2] for title, rows in sheets.items()}
    assert first["Violations"] == [("35", "3: join"), ("30", "2: leg 3: terrain")]
    assert first["Dearest: 10 of 33"][0] == ("29", "1.696 times the median of 33 runs")
    assert first["Least clearance: 10 of 36"][0] == ("31", "-3.0 m at 12 s")
    lost = [("32", "failed: stuck (2 runs)"), ("34", "failed: lost (1 runs)")]
    assert first["Not arrived"] == lost
    replay = shlex.split(sheets["Violations"][1][3])
    assert replay == ["companion", "replay", str(folder / "runs/000030")]
    again = ["companion", "campaign", "run", *SOURCE, "--only", "31"]
    assert shlex.split(sheets["Least clearance: 10 of 36"][0][3])[: len(again)] == again


def test_wrong_input_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    campaign(tmp_path / "c", paired_rows(2))
    damaged = campaign(tmp_path / "damaged", paired_rows(2)) / "rows" / "part-000000.parquet"
    damaged.write_bytes(b"PAR1 not at all PAR1")
    monkeypatch.chdir(tmp_path)
    for words, rule in {
        "nowhere": "it holds no campaign",
        "c --by colour": "no such factor. Choose from: world,",
        "c --html no/such/x.html": "not written",
        "damaged": "cannot be read (part-000000.parquet: ",
    }.items():
        code, _, said = answered("campaign", "report", *words.split())
        assert (code, said.count("\n"), said[:7]) == (2, 1, "error: ")
        assert rule in said
