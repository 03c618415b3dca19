"""A campaign's data set is the same however it is flown, and whatever dies meanwhile."""

import errno
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from answers import answered
from distributed import LocalCluster
from flights import one_target

from companion.campaign import bundled_campaigns
from companion.campaign.execute import fly
from companion.campaign.file import Run, load_campaign, runs_of
from companion.campaign.report import read_campaign, replay_command
from companion.campaign.run import fly_run
from companion.campaign.store import COLUMNS, TIMING, Facts, Row, Store, table
from companion.errors import InputError

pytestmark = [pytest.mark.closed_loop, pytest.mark.xdist_group("campaign")]

PLANNED = """
schema = 1
name = "planned"
over = "planner"
keep = "none"
seeds = 2
[[places]]
world = "sitl-arducopter"
[factors]
budget = [200, 400]
"""
FLOWN = """
schema = 1
name = "flown"
keep = "failures"
[[places]]
world = "sitl-arducopter"
mission = "mission.toml"
[factors]
faults = ["none", "dead"]
[[choices]]
name = "dead"
faults = "at 45 s: battery 1 %"
"""
WHEN = {"table-1": pytest.mark.nightly}
COMMAND = [sys.executable, "-c", "from companion.cli import main; main()", "campaign"]


def campaign_file(folder: Path, text: str) -> Path:
    (folder / "mission.toml").write_text(one_target(), encoding="utf-8")
    path = folder / "campaign.toml"
    path.write_text(text, encoding="utf-8")
    return path


def runs(folder: Path, text: str) -> list[Run]:
    table, _, base = load_campaign(str(campaign_file(folder, text)))
    return runs_of(table, base)


def same(rows: Any) -> list[dict[str, Any]]:
    """Rows by their numbers, without what differs from machine to machine."""
    return table([*rows]).drop(TIMING).sort("run").to_dicts()


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Campaigns are flown in this process."""

    def fly_here(runs: list[Run], out: Path, *_: object) -> Iterator[Row]:
        yield from (fly_run(run, out) for run in runs)

    monkeypatch.setattr("companion.campaign.execute.fly", fly_here)


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """What comes of it, one run after the other."""
    folder = tmp_path_factory.mktemp("planned")
    return same(fly_run(run, folder) for run in runs(folder, PLANNED))


@pytest.mark.parametrize("place", [pytest.param("here", marks=pytest.mark.nightly), "a cluster"])
def test_a_worker_that_is_killed_takes_no_run_with_it(
    planned: Any, tmp_path: Path, place: str
) -> None:
    """Of a cluster: two workers and who gives them work, in processes of their own."""
    with ExitStack() as stack:
        scheduler = None
        if place == "a cluster":
            cluster = LocalCluster(2, threads_per_worker=1, dashboard_address=":0")
            scheduler = stack.enter_context(cluster).scheduler_address
        flying = fly(runs(tmp_path, PLANNED), tmp_path, scheduler=scheduler, jobs=1)
        rows = [next(flying)]
        os.kill(int(rows[0]["worker"].rpartition("/")[2]), signal.SIGKILL)
        rows += flying
    assert same(rows) == planned
    assert len({row["worker"] for row in rows}) > 1
    assert all(row["arrived"] and row["violations"] == 0 for row in rows)


@pytest.mark.nightly
def test_a_run_that_kills_each_worker_becomes_a_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("companion.campaign.execute.fly_run", lambda *_, **__: os._exit(1))
    [row] = fly(runs(tmp_path, PLANNED)[:1], tmp_path, scheduler=None, jobs=1)
    assert (row["outcome"], row["error"]) == ("error", "its worker died 3 times and more")


@pytest.mark.usefixtures("here")
def test_killed_and_started_again_it_is_as_if_it_had_not_been(planned: Any, tmp_path: Path) -> None:
    out = tmp_path / "out"
    asked = ["run", str(campaign_file(tmp_path, PLANNED)), "--out", str(out), "--jobs", "1"]
    with subprocess.Popen([*COMMAND, *asked], stdout=subprocess.DEVNULL) as first:
        until_s = time.monotonic() + 120.0
        while not list((out / "rows").glob("part-*.parquet")):
            assert time.monotonic() < until_s
            time.sleep(0.01)
        first.kill()
    assert (out / "campaign.toml").read_text() == PLANNED
    there = len(read_campaign(out).rows)
    _, shown, _ = answered("campaign", *asked)
    if there < len(planned):
        assert f"{there} of {len(planned)} runs are there already" in shown
    assert same(read_campaign(out).rows.to_dicts()) == planned
    assert "0 runs" in answered("campaign", *asked)[1]
    campaign = read_campaign(out)
    again = shlex.split(replay_command(campaign, campaign.rows.row(3, named=True)))[1:]
    answered(*again)
    [row] = read_campaign(Path(again[again.index("--out") + 1])).rows.to_dicts()
    assert same([row | {"folder": ""}]) == planned[3:4]


def test_what_arrives_is_judged_and_only_files_of_what_does_not_are_kept(tmp_path: Path) -> None:
    arrived, failed = (fly_run(run, tmp_path) for run in runs(tmp_path, FLOWN))
    assert (arrived["arrived"], arrived["violations"], arrived["folder"]) == (True, 0, "")
    assert arrived["subpaths_checked"]
    assert not failed["arrived"]
    names = {"journal.jsonl", "flight.tlog", "mission.toml", "world.toml", "truth.jsonl"}
    assert names <= {path.name for path in (tmp_path / failed["folder"]).iterdir()}


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=WHEN.get(n, ())) for n in bundled_campaigns()]
)
def test_the_first_run_of_a_bundled_campaign_flies(name: str, tmp_path: Path) -> None:
    """With few candidates to a plan."""
    table, _, base = load_campaign(name)
    assert runs_of(table, base)
    quick, _, _ = load_campaign(name, {"keep": "none", "factors": {"budget": [200]}})
    row = fly_run(runs_of(quick, base)[0], tmp_path)
    assert "error" not in row
    assert row["arrived"] or row["ending"], row["reason"]  # faults may end a flight
    assert row["violations"] == 0
    assert row.keys() <= COLUMNS.keys()


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("place", ["run._flown", "store.Store._write"])
def test_a_full_disk_is_one_line_and_no_result(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither of a run, nor of the campaign: it is gone on with when there is room."""

    def full(*_: object) -> Any:
        raise OSError(errno.ENOSPC, "No space left on device")

    file = campaign_file(tmp_path, PLANNED)
    asked = "campaign", "run", file, "--out", tmp_path / "out", "--only", "0"
    with monkeypatch.context() as filled:
        filled.setattr(f"companion.campaign.{place}", full)
        code, _, said = answered(*asked)
    assert (code, said.count("\n")) == (2, 1)
    assert re.search("No space left.*goes on from 0 of 1 runs", said)
    assert answered(*asked)[0] == 0
    assert [*read_campaign(tmp_path / "out").rows["error"]] == [None]


NO_EFFECT = "it has no effect"
WORLD, DENSE = 'world = "sitl-arducopter"', 'family = "dense"\n'
WORLD_ALONE = f'{WORLD}\nmission = "mission.toml"'
PX4, COPTERS = 'vehicle = "px4-copter"\n', 'vehicle = ["ardupilot-copter"]'
KEEP, FACTORS = 'keep = "failures"', "[factors]"
REFUSED: list[tuple[str, str, str, str]] = [
    (FLOWN, "schema = 1", "", "schema"),
    (FLOWN, WORLD, "", "either a world or a family"),
    (FLOWN, WORLD, 'family = "hills"', "places[0].family"),
    (FLOWN, "battery 1 %", "battery much", "battery"),
    (FLOWN, FACTORS, "[factors]\nbudget = [1]", "budget"),
    (FLOWN, FACTORS, 'over = "planner"\n[factors]', "places[0].over"),
    (FLOWN, FACTORS, '[factors]\nknowledge = ["full"]', "of the planner alone"),
    (FLOWN, FACTORS, "seed = 3\n[factors]", f"places[0].seed = 3: {NO_EFFECT}"),
    (FLOWN, WORLD, DENSE, f"places[0].mission = 'mission.toml': {NO_EFFECT}"),
    (FLOWN, WORLD_ALONE, f"{DENSE}count = 3\nindices = [1]", f"places[0].count = 3: {NO_EFFECT}"),
    (FLOWN, FACTORS, f"{PX4}[factors]\n{COPTERS}", "places[0].vehicle = 'px4-copter': the factor"),
    (FLOWN, 'faults = ["none", "dead"]', "", "choices[0].name = 'dead': no factor"),
    (FLOWN, "[[choices]]", '[[choices]]\nname = "dead"\n[[choices]]', "stands for another already"),
    (FLOWN, KEEP, 'over = "planner"', "factors.faults = ['none', 'dead']: the planner"),
    (PLANNED, FACTORS, f"{PX4}[factors]", "vehicle = 'px4-copter': the planner alone has"),
    (PLANNED, "seeds = 2", "limit_s = 60", "limit_s = 60.0: the planner alone has no vehicle"),
    (PLANNED, FACTORS, '[factors]\nplanner = ["a-stra"]', "no such planner. One of: a-star"),
    (PLANNED, "", "--only 0 --most 1", "--most = 1: --only says which runs"),
    (PLANNED, "", "--jobs 2 --scheduler tcp://127.0.0.1:1", "--jobs = 2"),
    (PLANNED, "", "--keep some", "keep = 'some': it must be"),
]


def test_what_is_wrong_with_a_campaign_is_said_in_one_line_before_anything_is_written(
    tmp_path: Path,
) -> None:
    """In its file, or its options."""
    for text, was, now, says in REFUSED:
        assert was in text
        path = campaign_file(tmp_path, text.replace(was, now) if was else text)
        options = [] if was else now.split()
        code, _, said = answered("campaign", "run", path, "--out", tmp_path / "out", *options)
        assert (code, said.count("\n")) == (2, 1)
        assert says in said
        assert not (tmp_path / "out").exists()


def test_a_folder_of_something_else_and_a_busy_one_are_refused(tmp_path: Path) -> None:
    def store(digest: str) -> Store:
        return Store(tmp_path, "", Facts(digest=digest, runs=1))

    with store("a"), pytest.raises(InputError, match="another process"):
        store("a")
    with pytest.raises(InputError, match="another campaign"):
        store("b")
    (tmp_path / "runs.json").write_text('{"digest": "a', encoding="utf-8")
    with pytest.raises(InputError, match="another campaign"):
        store("a")


def test_a_run_that_raises_is_a_row(tmp_path: Path) -> None:
    [run, *_] = runs(tmp_path, FLOWN.replace("[factors]", '[factors]\nvehicle = ["px4-plane"]'))
    row = fly_run(run, tmp_path)
    assert row["outcome"] == "error"
    assert row["error"]
    assert "\n" not in row["error"]
