"""Pages about the mission, made from its transition table and its reasons by `scripts/docs`."""

from companion.mission.state import MOVES, Phase, Reason, Trigger


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
    shared = _shared_moves()
    lines += [
        f"    {_id(before)} --> {_id(after)}: {trigger.name.lower()}"
        for (before, trigger), after in MOVES.items()
        if trigger not in shared
    ]
    lines += ["    done --> [*]", "    faulted --> [*]", "```", ""]
    for trigger, (origins, after) in shared.items():
        names = ", ".join(before.value for before in origins)
        lines.append(f"Not drawn: `{trigger.name.lower()}` leads from {names} to {after.value}.")
    unreached = [phase.value for phase in Phase if phase not in _reached()]
    if unreached:
        lines += ["", f"Reserved, not entered yet: {', '.join(unreached)}."]
    lines += ["", "## Triggers", ""]
    lines += ["| trigger | when |", "|---|---|"]
    lines += [f"| `{trigger.name.lower()}` | {trigger.value} |" for trigger in Trigger]
    return "\n".join(lines) + "\n"


def troubleshooting_markdown() -> str:
    """docs/troubleshooting.md: every reason to hold or to end, with its remedy."""
    lines = [_TROUBLESHOOTING, "| message | what to do |", "|---|---|"]
    lines += [f"| {reason.text} | {reason.remedy} |" for reason in Reason]
    return "\n".join(lines) + "\n"


_TROUBLESHOOTING = """# Troubleshooting

Made from `companion/mission/state.py` by `scripts/docs`; do not edit.

`companion preflight MISSION --connect ADDRESS` names what is wrong before a flight. In flight each
reason to hold or to end is sent as a STATUSTEXT, and stands in `journal.jsonl`;
`companion replay RUN_DIR` shows what led to it.
"""


def _shared_moves() -> dict[Trigger, tuple[list[Phase], Phase]]:
    """Triggers that lead from many phases to one: drawn, they would hide the rest."""
    shared = {}
    for trigger in Trigger:
        origins = [before for before, on in MOVES if on is trigger]
        afters = {MOVES[before, trigger] for before in origins}
        if len(origins) > 3 and len(afters) == 1:
            shared[trigger] = (origins, afters.pop())
    return shared


def _reached() -> set[Phase]:
    return {Phase.WAITING, *MOVES.values()}


def _id(phase: Phase) -> str:
    return phase.value.replace(" ", "_")
