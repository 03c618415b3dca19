"""The parts of pages that are made from the code, and THIRD-PARTY.md, for `scripts/docs`."""

import ast
import inspect
import re
import textwrap
import tomllib
from importlib.metadata import Distribution, distribution
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import grimp
import msgspec
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from pydantic import TypeAdapter

from companion.mission import journal
from companion.mission.phases import By, Phase, Reason, Trigger
from companion.path.certificate import Certificate
from companion.planner.request import Refusal
from companion.telemetry.flight_status import LINES
from companion.world.zones import CircleZone, PolygonZone
from vehicle_sim import world
from vehicle_sim.faults import faults_page

ROOT: Final = Path(__file__).parents[1]
MARK: Final = "<!-- What follows is made from the code by scripts/docs. -->\n"
Schema = dict[str, Any]
_PROJECT: Final = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))

# --- classes as tables, by their JSON schema and the words below each field

_OBJECTS: Final = {"Certificate": Certificate, "Circle": CircleZone, "Polygon": PolygonZone}
_WORLD: Final[Schema] = TypeAdapter(world.World).json_schema()
_DEFINED: Final[Schema] = _WORLD["$defs"] | dict(
    msgspec.json.schema_components(
        [journal.Header, *journal.KINDS.values(), *LINES, *_OBJECTS.values()],
        schema_hook=lambda _: {"type": "object"},  # any zone
    )[1]
)
_TYPES: Final = {
    "number": "number",
    "integer": "whole number",
    "string": "text",
    "boolean": "true or false",
    "null": "null",
    "object": "object: see below",
}

_PLACES: Final = {
    ("number",) * 2: "[north, east]",
    ("number",) * 3: "[north, east, altitude]",
}


def section(title: str, kind: type, schema: Schema | None = None, left_out: str = "") -> str:
    """A class of the journal, of `fly --json` or of a world file, with its fields as a table."""
    schema = schema or _DEFINED[kind.__name__]
    words, needed, rows = words_of(kind), schema.get("required", []), list[str]()
    for key, value in schema["properties"].items():
        if key in left_out.split() or _tables_of(value):
            continue
        value_words, default = _in_words(value), value.get("default")
        if key not in needed and default is None:
            value_words = f"{value_words.removesuffix(' or null')}; may be left out"
        elif key not in needed and not isinstance(default, (list, dict)):
            value_words += f"; {_shown(default) or 'empty'} if left out"
        rows.append(f"| `{key}` | {value_words} | {words.get(key, '')} |\n")
    head = "\n| field | value | |\n|---|---|---|\n" if rows else ""
    return f"{title}\n\n{' '.join((kind.__doc__ or '').split())}\n{head}{''.join(rows)}"


def words_of(kind: type) -> dict[str, str]:
    """What stands below each field of a class."""
    [declared] = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    assert isinstance(declared, ast.ClassDef)
    by_field = dict[str, str]()
    for field, text in pairwise(declared.body):
        match field, text:
            case (
                ast.AnnAssign(target=ast.Name(id=name)),
                ast.Expr(value=ast.Constant(value=str(words))),
            ):
                by_field[name] = " ".join(words.split())
            case _:
                pass
    return by_field


def _tables_of(value: Schema) -> list[str]:
    """The classes of a world file that are tables below a key."""
    names = (
        schema.get("$ref", "").rpartition("/")[2] for schema in _either(value.get("items") or value)
    )
    return [name for name in names if "properties" in _WORLD["$defs"].get(name, ())]


def _either(value: Schema) -> list[Schema]:
    return list(value.get("anyOf", [value]))


def _in_words(value: Schema) -> str:
    """What may stand there: words, or a type and its range."""
    return " or ".join(dict.fromkeys(map(_one, _either(value))))


def _one(value: Schema) -> str:
    named = _DEFINED.get(value.get("$ref", "").rpartition("/")[2], {})
    value = named if "enum" in named else value
    if words := value.get("enum", [value["const"]] if "const" in value else []):
        return ", ".join(f"`{_shown(choice)}`" for choice in words)
    if value.get("type") == "array" and "prefixItems" in value:
        kinds = tuple(map(_one, value["prefixItems"]))
        return _PLACES.get(kinds) or f"({', '.join(kinds)})"
    if value.get("type") == "array":
        return f"list of {_in_words(value['items'])}"
    if inner := value.get("additionalProperties"):
        return f"object of names: {_in_words(inner)}"
    above, low, high = (value.get(k) for k in ("exclusiveMinimum", "minimum", "maximum"))
    bounds = [f"> {_shown(above)}"] if above is not None else []
    bounds += [f"from {_shown(low)}"] if low is not None and above is None else []
    bounds += [f"to {_shown(high)}"] if high is not None else []
    kind = _TYPES[value.get("type", "object")]
    return _shown(value["pattern"]) if "pattern" in value else " ".join([kind, *bounds])


def _shown(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value).replace("|", r"\|")


# --- the pages


def journal_page() -> str:
    """Every kind of entry with its fields, then the objects in them."""
    parts = [section("## Header", journal.Header)]
    untold = " ".join(("kind", "t_s", *journal.UNTOLD))
    parts += [section(f"## `{name}`", it, None, untold) for name, it in journal.KINDS.items()]
    parts += [section(f"## {name}, in entries", kind) for name, kind in _OBJECTS.items()]
    return "\n".join(parts)


def fly_json_page() -> str:
    """Every kind of line of `fly --json`."""
    return "\n".join(
        section(f"## `{kind.__struct_config__.tag}`", kind, None, "kind") for kind in LINES
    )


def world_page() -> str:
    """Every table of a world file."""
    places = dict[str, list[str]]()

    def visit(schema: Schema, path: str) -> None:
        for key, value in schema["properties"].items():
            for name in _tables_of(value):
                header = f"`[[{path}{key}]]`" if "items" in value else f"`[{path}{key}]`"
                places.setdefault(name, []).append(header)
                visit(_WORLD["$defs"][name], f"{path}{key}.")

    visit(_WORLD, "")
    tables = [
        (f"## {', '.join(headers)}", getattr(world, name)) for name, headers in places.items()
    ]
    first = section("## The file itself", world.World, _WORLD)
    return "\n".join([first, *(section(title, kind) for title, kind in tables)])


def mission_states_page() -> str:
    """The phases as a diagram, what moves them on, and how a vehicle is held."""
    rare = [trigger for trigger in Trigger if len(trigger.origins) <= 3]
    lines = ["```mermaid", "stateDiagram-v2", "    [*] --> waiting"]
    lines += [
        f"    {_id(before)} --> {_id(trigger.after)}: {trigger.name.lower()}"
        for trigger in rare
        for before in trigger.origins
    ]
    lines += ["    done --> [*]", "    faulted --> [*]", "```", ""]
    for trigger in Trigger:  # drawn, they would hide the rest
        if trigger not in rare:
            names = ", ".join(before.value for before in trigger.origins)
            leads = f"`{trigger.name.lower()}` leads from {names} to {trigger.after.value}"
            lines.append(f"Not drawn: {leads}.")
    lines += ["", "## Triggers", "", "| trigger | when |", "|---|---|"]
    lines += [f"| `{trigger.name.lower()}` | {trigger.when} |" for trigger in Trigger]
    lines += ["", "## Holds", "", "How a vehicle is held, in the phase holding, by the reason:", ""]
    lines += ["| by | who holds it | reasons |", "|---|---|---|"]
    for by in By:
        reasons = ", ".join(f"`{reason.name}`" for reason in Reason if reason.by is by)
        reasons = "all others" if by is By.MODE else reasons
        lines.append(f"| {by.name.lower()} | {by.value} | {reasons} |")
    return "\n".join(lines) + "\n"


def _id(phase: Phase) -> str:
    return phase.value.replace(" ", "_")


def troubleshooting_page() -> str:
    """Every reason to hold or to end, with its remedy."""
    lines = ["| message | what to do |", "|---|---|"]
    for reason in Reason:
        lines.append(f"| {reason.text} | {reason.remedy} |")
        refusals = [refusal for refusal in Refusal if refusal is not Refusal.TOO_MANY_LEGS]
        for refusal in refusals if reason is Reason.NO_PLAN else ():
            why, _, remedy = refusal.value.partition("; ")
            why = "it broke BOUND (SETTING), ..." if refusal is Refusal.NOTHING_SAFE else why
            lines.append(f"| ...: {why} | {remedy[:1].upper()}{remedy[1:]}. |")
    return "\n".join(lines) + "\n"


def house() -> str:
    """The packages of the companion, drawn from their imports: of those that others lead to, none.

    Floors are the layers that import-linter holds; what nearly all need is left out.
    """
    contracts = _PROJECT["tool"]["importlinter"]["contracts"]
    floors = next(
        contract["layers"] for contract in contracts if contract.get("containers") == ["companion"]
    )
    names = [name for floor in floors for name in re.split(r" \| ", floor)]
    graph, leads = grimp.build_graph("companion", cache_dir=None), dict[str, set[str]]()
    for module in graph.modules:
        room = _room(module, names)
        for other in graph.find_modules_directly_imported_by(module):
            leads.setdefault(room, set()).add(_room(other, names))
    beyond = dict[str, set[str]]()  # from the lowest floor up: all that each leads to
    lines = list[str]()
    for name in reversed(names):
        imported = leads.get(name, set()) & set(names) - {name} - _CELLAR
        direct = imported - {lower for other in imported for lower in beyond[other]}
        beyond[name] = imported.union(*(beyond[other] for other in imported))
        if name not in _CELLAR:
            lines += [f"    {name} --> {other}" for other in sorted(direct, reverse=True)]
    return "\n".join(["```mermaid", "flowchart TD", *reversed(lines), "```", ""])


_CELLAR: Final = {"errors", "printable", "ranges", "caches", "extras", "entry_points", "profiles"}


def _room(module: str, names: list[str]) -> str:
    """The package that a module is in, of those that have a floor; "": none."""
    inner = module.partition(".")[2]
    return next((name for name in names if f"{inner}.".startswith(f"{name}.")), "")


# --- third-party notices, from the metadata of what is installed


def needed(requirements: list[str]) -> dict[str, Distribution]:
    """What these requirements bring on this machine, by name, with all that they need in turn."""
    needs = dict[str, Distribution]()
    wanted = [Requirement(text) for text in requirements]
    while wanted:
        requirement = wanted.pop()
        name = canonicalize_name(requirement.name)
        extras = requirement.extras or {""}
        if name in needs and extras == {""}:
            continue
        needs[name] = distribution(name)
        for need in map(Requirement, needs[name].requires or ()):
            if need.marker is None or any(need.marker.evaluate({"extra": e}) for e in extras):
                wanted.append(need)
    return needs


def _licence(package: Distribution) -> str:
    """As its authors declare it: by an expression, by a classifier, or by a word."""

    def metadata(field: str) -> str:
        return "\n".join(package.metadata.get_all(field) or ())

    pattern = r"^License :: (?:.* :: )?(?!OSI Approved$)(.+)$"
    classified = re.findall(pattern, metadata("Classifier"), re.MULTILINE)
    words = (metadata("License").strip().splitlines() or ["not stated"])[0]
    return metadata("License-Expression") or ", ".join(classified) or words


def notices() -> str:
    """What is installed with the project, by which extras, and under which licence."""
    project = _PROJECT["project"]
    rows: dict[str, tuple[str, list[str]]] = {}
    for part, wanted in {"": project["dependencies"], **project["optional-dependencies"]}.items():
        for name, package in needed(wanted).items():
            rows.setdefault(name, (_licence(package), []))[1].append(part)
    return "| package | licence | with |\n|---|---|---|\n" + "".join(
        f"| {name} | {terms} | {', '.join(extras) if extras[0] else ''} |\n"
        for name, (terms, extras) in sorted(rows.items())
    )


PAGES: Final = {
    "docs/architecture": house,
    "docs/reference/faults": faults_page,
    "docs/reference/fly-json": fly_json_page,
    "docs/reference/journal": journal_page,
    "docs/reference/mission-states": mission_states_page,
    "docs/reference/world": world_page,
    "docs/reference/troubleshooting": troubleshooting_page,
    "THIRD-PARTY": notices,
}


def page_of(name: str) -> str:
    """A page as it has to be: what people wrote, up to the mark, and what is made."""
    head, mark, _ = (ROOT / f"{name}.md").read_text(encoding="utf-8").partition(MARK)
    return (head + mark if mark else "") + PAGES[name]()


if __name__ == "__main__":
    for page in PAGES:
        (ROOT / f"{page}.md").write_text(page_of(page), encoding="utf-8")
