"""A campaign's data set is the same however it is flown, and whatever dies meanwhile."""

import errno
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
import typer
from distributed import LocalCluster
from flights import one_target

from companion.campaign import bundled_campaigns
from companion.campaign.execute import fly
from companion.campaign.file import Run, load_campaign, runs_of
from companion.campaign.report import read_campaign, replay_command
from companion.campaign.run import fly_run
from companion.campaign.store import TIMING, Row, Store
from companion.cli import app
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
WORLD_ALONE = 'world = "sitl-arducopter"\nmission = "mission.toml"'
PX4, COPTERS = 'vehicle = "px4-copter"\n', 'vehicle = ["ardupilot-copter"]'
WORLD, DENSE = 'world = "sitl-arducopter"', 'family = "dense"\n'
COMMAND = [sys.executable, "-c", "from companion.cli import main; main()", "campaign", "run"]
PATIENCE_S = 120.0


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
    plain = [asdict(row) if isinstance(row, Row) else row for row in rows]
    plain = [{k: v for k, v in row.items() if k not in TIMING} for row in plain]
    return sorted(plain, key=lambda row: row["run"])


def campaign_command(*words: str) -> None:
    """`companion campaign` in this process."""
    typer.main.get_command(app)(["campaign", *words], standalone_mode=False)


def fly_in_this_process(runs: list[Run], out: Path, *_: object) -> Iterator[Row]:
    yield from (fly_run(run, out) for run in runs)


def wait_until(so: Callable[[], Any]) -> Any:
    until_s = time.monotonic() + PATIENCE_S
    while not (found := so()):
        assert time.monotonic() < until_s
        time.sleep(0.01)
    return found


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """What comes of it, one run after the other."""
    folder = tmp_path_factory.mktemp("planned")
    return same(fly_run(run, folder) for run in runs(folder, PLANNED))


@pytest.fixture
def cluster() -> Iterator[LocalCluster]:
    """Two workers and who gives them work, in processes of their own."""
    with LocalCluster(2, threads_per_worker=1, dashboard_address=":0") as made:
        yield made


@pytest.mark.parametrize("place", ["here", "a cluster"])
def test_a_worker_that_is_killed_takes_no_run_with_it(
    planned: Any, tmp_path: Path, place: str, request: pytest.FixtureRequest
) -> None:
    scheduler = None
    if place == "a cluster":
        scheduler = request.getfixturevalue("cluster").scheduler_address
    flying = fly(runs(tmp_path, PLANNED), tmp_path, scheduler=scheduler, jobs=1)
    rows = [next(flying)]
    os.kill(int(rows[0].worker.rpartition("/")[2]), signal.SIGKILL)
    rows += flying
    assert same(rows) == planned
    assert len({row.worker for row in rows}) > 1
    assert all(row.arrived and row.violations == 0 for row in rows)


@pytest.mark.nightly
def test_a_run_that_kills_each_worker_becomes_a_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("companion.campaign.execute.fly_run", lambda *_, **__: os._exit(1))
    [row] = fly(runs(tmp_path, PLANNED)[:1], tmp_path, scheduler=None, jobs=1)
    assert (row.outcome, row.error) == ("error", "its worker died 3 times and more")


def test_killed_and_started_again_it_is_as_if_it_had_not_been(
    planned: Any,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    out = tmp_path / "out"
    command = [*COMMAND, str(campaign_file(tmp_path, PLANNED)), "--out", str(out), "--jobs", "1"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as first:
        wait_until(lambda: list((out / "rows").glob("part-*.parquet")))
        first.kill()
    there = len(read_campaign(out).rows)
    monkeypatch.setattr("companion.campaign.execute.fly", fly_in_this_process)
    campaign_command(*command[4:])
    if there < len(planned):
        assert f"{there} of {len(planned)} runs are there already" in capsys.readouterr().out
    assert same(read_campaign(out).rows) == planned
    campaign_command(*command[4:])
    assert "0 runs" in capsys.readouterr().out
    campaign = read_campaign(out)
    asked = shlex.split(replay_command(campaign, campaign.rows[3]))[2:]
    campaign_command(*asked)
    [row] = read_campaign(Path(asked[asked.index("--out") + 1])).rows
    assert same([replace(row, folder="")]) == planned[3:4]


@pytest.fixture(scope="module")
def flown_here(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Row]]:
    """The folder of the campaign, and what came of it: one arrives, and one does not."""
    folder = tmp_path_factory.mktemp("here")
    return folder, [fly_run(run, folder) for run in runs(folder, FLOWN)]


def test_what_arrives_is_judged_and_only_files_of_what_does_not_are_kept(flown_here: Any) -> None:
    folder, [arrived, failed] = flown_here
    assert arrived.arrived
    assert arrived.violations == 0
    assert arrived.subpaths_checked
    assert arrived.folder == ""
    assert not failed.arrived
    names = {"journal.jsonl", "flight.tlog", "mission.toml", "world.toml", "truth.jsonl"}
    assert names <= {path.name for path in (folder / failed.folder).iterdir()}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.nightly] if name == "table-1" else [])
        for name in bundled_campaigns()
    ],
)
def test_the_first_run_of_a_bundled_campaign_flies(name: str, tmp_path: Path) -> None:
    table, _, base = load_campaign(name, {"keep": "none"})
    first = runs_of(table, base)[0]
    row = fly_run(first, tmp_path)
    assert row.error is None
    assert row.arrived or row.ending, row.reason  # faults may end a flight
    assert row.violations == 0


def test_a_run_that_raises_is_a_row(tmp_path: Path) -> None:
    [run, *_] = runs(tmp_path, FLOWN.replace("[factors]", '[factors]\nvehicle = ["px4-plane"]'))
    row = fly_run(run, tmp_path)
    assert row.outcome == "error"
    assert row.error
    assert "\n" not in row.error


@pytest.mark.parametrize(
    "place", ["companion.campaign.run._flown", "companion.campaign.store.Store.add"]
)
def test_a_full_disk_is_one_line_and_no_result(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither of a run, nor of the campaign: it is gone on with when there is room."""

    def full(*_: object) -> Any:
        raise OSError(errno.ENOSPC, "No space left on device")

    file = campaign_file(tmp_path, PLANNED)
    command = ["run", str(file), "--out", str(tmp_path / "out"), "--only", "0"]
    monkeypatch.setattr("companion.campaign.execute.fly", fly_in_this_process)
    with monkeypatch.context() as filled:
        filled.setattr(place, full)
        with pytest.raises(InputError, match=r"No space left.*goes on from 0 of 1 runs") as refused:
            campaign_command(*command)
    assert "\n" not in str(refused.value)
    campaign_command(*command)
    assert {row.error for row in read_campaign(tmp_path / "out").rows} == {None}


NO_EFFECT = "it has no effect"
REFUSED = {
    FLOWN: [
        ("schema = 1", "", "schema"),
        (WORLD, "", "either a world or a family"),
        (WORLD, 'family = "hills"', "places[0].family"),
        ("battery 1 %", "battery much", "battery"),
        ('keep = "failures"', 'over = "udp"', "over"),
        ("[factors]", "[factors]\nbudget = [1]", "budget"),
        ("[factors]", 'over = "planner"\n[factors]', "places[0].over"),
        ("[factors]", '[factors]\nknowledge = ["full"]', "of the planner alone"),
        ("[factors]", "seed = 3\n[factors]", f"places[0].seed = 3: {NO_EFFECT}"),
        (WORLD, DENSE, f"places[0].mission = 'mission.toml': {NO_EFFECT}"),
        (WORLD_ALONE, f"{DENSE}count = 3\nindices = [1]", f"places[0].count = 3: {NO_EFFECT}"),
        ("[factors]", f"{PX4}[factors]\n{COPTERS}", "places[0].vehicle = 'px4-copter': the factor"),
        ('faults = ["none", "dead"]', "", "choices[0].name = 'dead': no factor"),
        ("[[choices]]", '[[choices]]\nname = "dead"\n[[choices]]', "stands for another already"),
        ('keep = "failures"', 'over = "planner"', "factors.faults = ['none', 'dead']: the planner"),
    ],
    PLANNED: [
        ("[factors]", f"{PX4}[factors]", "places[0].vehicle = 'px4-copter': the planner alone has"),
        ("seeds = 2", "limit_s = 60", "limit_s = 60.0: the planner alone has no vehicle"),
        ("[factors]", '[factors]\nplanner = ["a-stra"]', "Did you mean a-star?"),
    ],
}
OPTIONS = {
    "--most = 1: --only says which runs": ["--only", "0", "--most", "1"],
    "--jobs = 2": ["--jobs", "2", "--scheduler", "tcp://127.0.0.1:1"],
    "keep = 'some': it must be": ["--keep", "some"],
}


def refused(folder: Path, text: str, *options: str) -> str:
    """What is said of a campaign, in one line, before anything is written."""
    path = campaign_file(folder, text)
    with pytest.raises(InputError) as error:
        campaign_command("run", str(path), "--out", str(folder / "out"), *options)
    assert "\n" not in str(error.value)
    assert not (folder / "out").exists()
    return str(error.value)


@pytest.mark.parametrize("text", REFUSED, ids=["flown", "planned"])
def test_what_is_wrong_with_a_file_is_said_in_one_line(text: str, tmp_path: Path) -> None:
    for was, now, says in REFUSED[text]:
        assert was in text
        assert says in refused(tmp_path, text.replace(was, now))


@pytest.mark.parametrize("says", OPTIONS)
def test_options_that_have_no_effect_or_make_no_campaign_are_refused(
    says: str, tmp_path: Path
) -> None:
    assert says in refused(tmp_path, PLANNED, *OPTIONS[says])


def test_a_folder_of_something_else_and_a_busy_one_are_refused(tmp_path: Path) -> None:
    busy, again = (
        lambda: Store(tmp_path, text="", digest="a", count=1, source=[]) for _ in range(2)
    )
    with busy(), pytest.raises(InputError, match="another process"):
        again()
    with pytest.raises(InputError, match="another campaign"):
        Store(tmp_path, text="", digest="b", count=1, source=[])
    (tmp_path / "runs.json").write_text('{"digest": "a', encoding="utf-8")
    with pytest.raises(InputError, match="another campaign"):
        again()
