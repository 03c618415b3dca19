import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from companion.errors import InputError
from companion.paper.compare.command import compare_app
from companion.paper.compare.comparisons import PAPERS

every_picture = pytest.mark.parametrize("command", ["table-1", "figure-3", "figure-4"])


def called(*words: str) -> str:
    """What a command prints."""
    result = CliRunner(env={"COLUMNS": "120"}).invoke(
        compare_app, list(words), standalone_mode=False
    )
    if result.exception is not None:
        raise result.exception
    return result.stdout


@pytest.mark.parametrize(
    ("command", "picture", "magic"),
    [("table-1", "p.png", b"\x89PNG\r\n\x1a\n"), ("figure-4", "p.pdf", b"%PDF-")],
)
def test_a_comparison_prints_tables_and_writes_a_picture_and_numbers(
    command: str, picture: str, magic: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # the whole way, but for one row and with so few evaluations that it is quick
    for row in list(PAPERS)[1:]:
        monkeypatch.delitem(PAPERS, row)
    words = [command, "--runs", "1", "--jobs", "1", "--seed", "3", "--per-second", "100"]
    files = tmp_path / picture, tmp_path / "numbers.json"
    shown = called(*words, "--figure", str(files[0]), "--json", str(files[1]))
    assert files[0].read_bytes().startswith(magic)
    written = json.loads(files[1].read_text())
    assert (written["runs"], written["seed"]) == (1, 3)
    assert {each["evaluations"] for each in written["results"]} == {300}
    for each in written["results"]:
        assert each["label"] in shown
        if command == "table-1":
            assert f"{each['paper_mean_cost']:.1f} ± {each['paper_st_dev_cost']:.1f}" in shown
        else:
            way = each["papers_way"]
            assert f"{way}: {each['ways'].count(way)}/1" in shown
    assert ("T = 3 s is 300 evaluations" if command == "table-1" else "may traverse") in shown


def test_routes_flies_whoever_is_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("companion.paper.compare.comparisons.ENVIRONMENTS", ("environment-1",))
    words = ["routes", "--jobs", "1", "--planner", "paper", "--planner", "a-star"]
    shown = called(*words, "--json", str(tmp_path / "routes.json"))
    results = json.loads((tmp_path / "routes.json").read_text())["results"]
    assert [each["label"] for each in results] == ["paper", "a-star"]
    for each in results:
        assert each["arrived"] == [True]
        assert f"{each['j'][0]:.2f}" in shown
    with pytest.raises(InputError, match=r"--planner = 'magic': there is no such planner"):
        called("routes", "--planner", "magic")


@every_picture
def test_a_file_that_cannot_be_written_is_refused_before_anything_is_flown(
    command: str, tmp_path: Path
) -> None:
    for option in ("--figure", "--json"):
        for path in (tmp_path, tmp_path / "nowhere" / "file.png"):
            with pytest.raises(InputError, match=f"{option} = .*{path.name}"):
                called(command, option, str(path))
    with pytest.raises(InputError, match=r"--figure = 'x.jpg': .* \.png, \.svg or \.pdf"):
        called(command, "--figure", "x.jpg")
    same = str(tmp_path / "figure.png")
    with pytest.raises(InputError, match=r"--json = .*the picture goes there"):
        called(command, "--figure", same, "--json", same)
    assert list(tmp_path.iterdir()) == []
