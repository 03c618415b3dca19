"""`companion export` at the door: what it refuses, and what it makes of a flight cut off."""

import json
import random
import shutil
from pathlib import Path
from typing import Any, get_args

import pytest
from recorded import run_folder

from companion.errors import InputError
from companion.replay.command import Format, export
from companion.replay.exporting import recorded, write

ALL = pytest.mark.parametrize("to", get_args(Format))


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run_folder(tmp_path_factory.mktemp("recorded"))


@pytest.fixture
def copy(run_dir: Path, tmp_path: Path) -> Path:
    """The same run folder, to be spoiled."""
    return Path(shutil.copytree(run_dir, tmp_path / "run"))


def refused(*arguments: Any, **options: Any) -> str:
    with pytest.raises(InputError) as caught:
        export(*arguments, **options)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 2
    return str(caught.value)


@ALL
def test_it_writes_beside_the_flight_by_default_and_says_so(
    copy: Path, to: Format, capsys: pytest.CaptureFixture[str]
) -> None:
    export(copy, to)
    file = copy / f"flight.{to}"
    assert file.stat().st_size > 1000
    said = capsys.readouterr().out.splitlines()
    assert said[-1] == f"1110 positions, 2 subpaths, 2 holds and events: {file}"


def test_it_writes_where_it_is_told_to_and_nothing_else(copy: Path, tmp_path: Path) -> None:
    before = {file: file.read_bytes() for file in copy.iterdir()}
    export(copy, "kml", tmp_path / "my flight.kml")
    assert (tmp_path / "my flight.kml").is_file()
    assert {file: file.read_bytes() for file in copy.iterdir()} == before


# --- what is wrong


def test_what_is_no_run_folder_is_refused(tmp_path: Path, copy: Path) -> None:
    words = refused(tmp_path / "none", "kml")
    assert words.startswith("RUN_DIR = ")
    (tmp_path / "empty").mkdir()
    assert "it holds no mission.toml" in refused(tmp_path / "empty", "kml")
    assert "RUN_DIR" in refused(copy / "flight.tlog", "kml")
    (copy / "flight.tlog").unlink()
    assert "it holds no flight.tlog" in refused(copy, "kml")


def test_a_journal_that_is_wrong_is_said_with_its_line(copy: Path) -> None:
    journal = copy / "journal.jsonl"
    lines = len(journal.read_bytes().splitlines())
    with journal.open("ab") as out:
        out.write(b'{"t_s":"x","kind":"arm"}\n')
    assert f"line {lines + 1}: t_s = 'x'" in refused(copy, "csv")


@pytest.mark.parametrize("name", ["flight.tlog", "journal.jsonl", "mission.toml", "run.json"])
def test_what_was_recorded_is_not_written_over(copy: Path, name: str) -> None:
    before = (copy / name).read_bytes()
    assert "recorded" in refused(copy, "csv", copy / name)
    assert "recorded" in refused(copy, "csv", copy / ".." / "run" / name)
    assert (copy / name).read_bytes() == before


@ALL
def test_a_place_that_cannot_be_written_to_is_refused(copy: Path, to: Format) -> None:
    assert "--out" in refused(copy, to, copy)
    assert "--out" in refused(copy, to, copy / "none" / "file")


@ALL
def test_a_disk_that_is_full_is_said(copy: Path, to: Format) -> None:
    words = refused(copy, to, Path("/dev/full"))
    assert words.startswith("--out = '/dev/full': not written (No space left on device)")


# --- what is not whole


@ALL
def test_a_flight_that_was_cut_off_anywhere_is_exported_as_far_as_it_goes(
    run_dir: Path, tmp_path: Path, to: Format
) -> None:
    rng = random.Random(to)
    journal = (run_dir / "journal.jsonl").read_bytes()
    log = (run_dir / "flight.tlog").read_bytes()
    whole, _ = recorded(run_dir)
    for share in [0.0, 0.002, *(rng.random() for _ in range(4)), 0.999]:
        copy = Path(shutil.copytree(run_dir, tmp_path / f"{share}"))
        kept = journal[: int(share * len(journal))]
        (copy / "journal.jsonl").write_bytes(kept)
        (copy / "flight.tlog").write_bytes(log[: int(share * len(log))])
        flight, notes = recorded(copy)
        assert len(flight.track) <= len(whole.track)
        assert not notes or all("\n" not in note for note in notes)
        write(flight, to, copy / f"flight.{to}")
        assert (copy / f"flight.{to}").is_file()
        if share > 0.5:
            assert len(flight.track) > 0.3 * len(whole.track)
            torn = any("last line is not whole" in note for note in notes)
            assert torn is not kept.endswith(b"\n")


def test_the_elevation_file_of_the_mission_may_be_on_another_computer(copy: Path) -> None:
    text = (copy / "mission.toml").read_text(encoding="utf-8")
    terrain = '[terrain]\nfile = "/elsewhere/dem.tif"\nvertical_datum = "EGM96"\n'
    (copy / "mission.toml").write_text(text + terrain, encoding="utf-8")
    export(copy, "geojson")
    found = json.loads((copy / "flight.geojson").read_text(encoding="utf-8"))
    assert found["altitude_datum"] == "AMSL"
