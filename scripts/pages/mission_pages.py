"""Pages about the mission, made from its transition table and its reasons by `scripts/docs`."""

import ast
from pathlib import Path

from companion.mission import state
from companion.mission.state import Hold, Phase, Reason, Trigger
from companion.planner.request import Refusal


def mission_states_markdown() -> str:
    """docs/reference/mission-states.md: the phases as a diagram, and what moves them on."""
    lines = [
        "# Mission states",
        "",
        "Made from `companion/mission/state.py` by `scripts/docs`; do not edit.",
        "",
        "```mermaid",
        "stateDiagram-v2",
        "    [*] --> waiting",
    ]
    shared = [trigger for trigger in Trigger if len(trigger.origins) > 3]
    lines += [
        f"    {_id(before)} --> {_id(trigger.after)}: {trigger.name.lower()}"
        for trigger in Trigger
        if trigger not in shared
        for before in trigger.origins
    ]
    lines += ["    done --> [*]", "    faulted --> [*]", "```", ""]
    for each in shared:  # drawn, they would hide the rest
        names = ", ".join(before.value for before in each.origins)
        lines.append(f"Not drawn: `{each.name.lower()}` leads from {names} to {each.after.value}.")
    lines += ["", "## Triggers", ""]
    lines += ["| trigger | when | decided in `companion/mission` by |", "|---|---|---|"]
    deciders = _deciders()
    lines += [
        f"| `{trigger.name.lower()}` | {trigger.when} | {', '.join(deciders[trigger.name])} |"
        for trigger in Trigger
    ]
    lines += ["", "## Holds", "", "How a vehicle is held, in the phase holding, by the reason:", ""]
    lines += ["| hold | how | reasons |", "|---|---|---|"]
    for hold in Hold:
        reasons = ", ".join(f"`{each.name}`" for each in Reason if each.hold is hold)
        if hold is Hold.MODE:
            reasons = "all others"
        lines.append(f"| {hold.name.lower()} | {hold.value} | {reasons} |")
    return "\n".join(lines) + "\n"


def troubleshooting_markdown() -> str:
    """docs/troubleshooting.md: every reason to hold or to end, with its remedy."""
    lines = [_TROUBLESHOOTING, "| message | what to do |", "|---|---|"]
    for reason in Reason:
        lines.append(f"| {reason.text} | {reason.remedy} |")
        if reason is Reason.NO_PLAN:
            lines += [_refusal_row(each) for each in Refusal if each is not Refusal.TOO_MANY_LEGS]
    return "\n".join(lines) + "\n"


def _refusal_row(refusal: Refusal) -> str:
    """What follows `NO_PLAN`."""
    why, _, remedy = refusal.value.partition("; ")
    why = "it broke BOUND (SETTING), ..." if refusal is Refusal.NOTHING_SAFE else why
    return f"| ...: {why} | {remedy[:1].upper()}{remedy[1:]}. |"


_TROUBLESHOOTING = """# Troubleshooting

Made from `companion/mission/state.py` by `scripts/docs`; do not edit.

`companion preflight MISSION --connect ADDRESS` names what is wrong before a flight. In flight each
reason to hold or to end is sent as a STATUSTEXT, and stands in `journal.jsonl`;
`companion report RUN_DIR` shows what led to it.

`ready: waits for go` is no trouble: [somebody says go](connecting.md#in-flight).
"""


def _deciders() -> dict[str, list[str]]:
    """The functions that move a mission on, by the name of the trigger that they return."""
    found: dict[str, list[str]] = {}
    for path in sorted(Path(state.__file__).parent.glob("*.py")):
        for function in ast.parse(path.read_text()).body:
            if isinstance(function, ast.FunctionDef):
                for name in sorted(_returned(function)):
                    found.setdefault(name, []).append(f"`{path.stem}.{function.name}`")
    return found


def _returned(tree: ast.AST) -> set[str]:
    """The triggers that stand in a piece of code, but for those that are only compared with."""
    names = set[str]()
    for node in ast.iter_child_nodes(tree):
        match node:
            case ast.Compare():
                pass
            case ast.Attribute(value=ast.Name(id="Trigger"), attr=name):
                names.add(name)
            case _:
                names |= _returned(node)
    return names


def _id(phase: Phase) -> str:
    return phase.value.replace(" ", "_")
