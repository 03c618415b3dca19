import json
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console
from runs import run, table
from typer.testing import CliRunner

from companion.errors import InputError
from companion.paper.compare import figures, routes, table_1
from companion.paper.compare.command import compare_app

PNG = b"\x89PNG\r\n\x1a\n"


def called(*words: str) -> str:
    """What a command prints."""
    result = CliRunner(env={"COLUMNS": "120"}).invoke(
        compare_app, list(words), standalone_mode=False
    )
    if result.exception is not None:
        raise result.exception
    return result.stdout


def test_figure_4_prints_a_table_and_writes_a_picture_and_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(figures, "_EVALUATIONS", 200)
    picture, numbers = tmp_path / "figure.pdf", tmp_path / "figure.json"
    words = ["figure-4", "--runs", "1", "--jobs", "1", "--seed", "3"]
    shown = called(*words, "--figure", str(picture), "--json", str(numbers))
    assert "otherwise it may traverse" in shown
    assert picture.read_bytes().startswith(b"%PDF-")
    written = json.loads(numbers.read_text())
    assert (written["runs"], written["seed"]) == (1, 3)
    for each in written["results"]:
        assert each["ways"] in (["goes round"], ["flies between"])
        way = each["papers_way"]
        assert f"{way}: {each['ways'].count(way)}/1" in shown


def test_table_1_prints_our_numbers_beside_the_papers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # the whole way, but for one row and with so few evaluations that it is quick
    monkeypatch.setattr(table_1, "ENVIRONMENTS", ("environment-1",))
    monkeypatch.setattr(table_1, "PLANNING_TIMES_S", (3.0,))
    picture, numbers = tmp_path / "table.png", tmp_path / "table.json"
    words = ["table-1", "--runs", "1", "--jobs", "1", "--per-second", "200"]
    shown = called(*words, "--figure", str(picture), "--json", str(numbers))
    assert "88.3 ± 4.9" in shown
    assert "classical DE" in shown
    assert "T = 3 s is 600 evaluations" in shown
    assert "seen by radars" in shown
    assert picture.read_bytes().startswith(PNG)
    results = json.loads(numbers.read_text())["results"]
    assert [each["evaluations"] for each in results] == [600] * 4


@pytest.mark.parametrize("columns", ["80", "120"])
def test_no_cell_of_a_table_is_cut(columns: str) -> None:
    found = table((run(208.55), run(596.96)))
    with (console := Console(width=int(columns), file=StringIO())).capture() as said:
        for each in table_1.tables(found):
            console.print(each)
    assert "…" not in said.get()
    for cell in ("environment-2, 5 s", "classical DE", "402.75 ± 274.65", "150.0 km"):
        assert cell in said.get()


def test_routes_flies_whoever_is_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(routes, "ENVIRONMENTS", ("environment-1",))
    words = ["routes", "--jobs", "1", "--planner", "paper", "--planner", "a-star"]
    shown = called(*words, "--json", str(tmp_path / "routes.json"))
    results = json.loads((tmp_path / "routes.json").read_text())["results"]
    assert [each["label"] for each in results] == ["paper", "a-star"]
    for each in results:
        assert each["arrived"] == [True]
        assert f"{each['j'][0]:.2f}" in shown
    with pytest.raises(InputError, match=r"--planner = 'magic': there is no such planner"):
        called("routes", "--planner", "magic")


@pytest.mark.parametrize("command", ["table-1", "figure-3", "figure-4"])
@pytest.mark.parametrize("option", ["--figure", "--json"])
def test_a_file_that_cannot_be_written_is_refused_before_anything_is_flown(
    command: str, option: str, tmp_path: Path
) -> None:
    for path in (tmp_path, tmp_path / "nowhere" / "file.png"):
        with pytest.raises(InputError, match=f"{option} = .*{path.name}"):
            called(command, option, str(path))


@pytest.mark.parametrize("command", ["table-1", "figure-3", "figure-4"])
def test_a_picture_of_another_kind_is_refused_with_the_choices(command: str) -> None:
    with pytest.raises(InputError, match=r"--figure = 'x.jpg': .* \.png, \.svg or \.pdf"):
        called(command, "--figure", "x.jpg")


def test_numbers_and_picture_do_not_go_into_one_file(tmp_path: Path) -> None:
    same = str(tmp_path / "figure.png")
    with pytest.raises(InputError, match=r"--json = .*the picture goes there"):
        called("figure-4", "--runs", "1", "--figure", same, "--json", same)
    assert list(tmp_path.iterdir()) == []
