import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MODULES = sorted(
    path for package in ("companion", "vehicle_sim") for path in (ROOT / package).rglob("*.py")
)


@pytest.mark.parametrize("module", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_module_has_at_most_500_lines_and_its_functions_60(module: Path) -> None:
    text = module.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 500
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef):
            assert node.end_lineno is not None
            assert node.end_lineno - node.lineno < 60, node.name


def test_the_page_of_mission_states_is_that_of_the_table() -> None:
    from companion.views.states import mission_states_markdown

    page = (ROOT / "docs" / "mission-states.md").read_text(encoding="utf-8")
    assert page == mission_states_markdown(), "run scripts/docs"


def test_the_page_of_faults_is_that_of_the_catalogue() -> None:
    from vehicle_sim.faults import faults_page

    page = (ROOT / "docs" / "faults.md").read_text(encoding="utf-8")
    assert page == faults_page(), "run scripts/docs"
