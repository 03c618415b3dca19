import ast
from pathlib import Path

ROOT = Path(__file__).parents[1]
MODULES = sorted(
    path for package in ("companion", "vehicle_sim") for path in (ROOT / package).rglob("*.py")
)


def test_a_function_has_at_most_60_lines() -> None:
    too_long = [
        f"{module.relative_to(ROOT)}: {node.name}"
        for module in MODULES
        for node in ast.walk(ast.parse(module.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef) and (node.end_lineno or 0) - node.lineno >= 60
    ]
    assert not too_long


def test_the_page_of_mission_states_is_that_of_the_table() -> None:
    from companion.views.states import mission_states_markdown

    page = (ROOT / "docs" / "mission-states.md").read_text(encoding="utf-8")
    assert page == mission_states_markdown(), "run scripts/docs"


def test_the_page_of_faults_is_that_of_the_catalogue() -> None:
    from vehicle_sim.faults.timeline import faults_page

    page = (ROOT / "docs" / "faults.md").read_text(encoding="utf-8")
    assert page == faults_page(), "run scripts/docs"
