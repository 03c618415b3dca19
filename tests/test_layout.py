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


def test_the_pages_that_are_made_from_the_code_are_up_to_date() -> None:
    from companion.views.states import mission_states_markdown, troubleshooting_markdown
    from vehicle_sim.faults.timeline import faults_page
    from vehicle_sim.world_page import world_page

    made = {
        "reference/faults.md": faults_page(),
        "reference/world.md": world_page(),
        "reference/mission-states.md": mission_states_markdown(),
        "troubleshooting.md": troubleshooting_markdown(),
    }
    for name, text in made.items():
        page = (ROOT / "docs" / name).read_text(encoding="utf-8")
        assert page == text, f"{name}: run scripts/docs"
