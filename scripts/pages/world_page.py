"""docs/reference/world.md, made from the declarations of the world file by `scripts/docs`."""

from typing import Any, Final

from pages.journal_page import words_of
from pydantic import TypeAdapter

from vehicle_sim import world
from vehicle_sim.world import World

_HEAD: Final = """# The world file

Made from `vehicle_sim/world.py` by `scripts/docs`; do not edit.

What `vehicle-sim` flies in: TOML. Units are part of the names; `north_m` and `east_m` are of the
origin's local frame; heights of trees, buildings, walls and wires are above the ground. `[table]`
stands once, `[[table]]` may stand several times. Unknown keys are refused.
"""
_UNITS: Final = {
    "amsl_m": "m AMSL",
    "ne_m": "m",
    "m_s2": "m/s2",
    "m_s": "m/s",
    "1_s": "1/s",
    "deg": "degree",
    "hz": "Hz",
    "m": "m",
    "s": "s",
}
"""By the ends of keys, the longest first."""
_WORDS: Final = {"string": "text", "object": "a table"}


def world_page() -> str:
    """Every table of a world file with the unit, range and default of its keys."""
    schema = TypeAdapter(World).json_schema()
    tables = schema["$defs"]
    parts, places = [_HEAD], _places(schema, tables)
    parts.append(_table("The file itself", schema, World.__doc__ or "", words_of(World)))
    for name, place in places.items():
        kind = getattr(world, name)
        parts.append(_table(f"`{place}`", tables[name], kind.__doc__ or "", words_of(kind)))
    return "\n".join(parts)


def _places(schema: dict[str, Any], tables: dict[str, Any], of: str = "") -> dict[str, str]:
    """Each class of a table, and how its header is written, in the order of the file."""
    found: dict[str, str] = {}
    for key, value in schema["properties"].items():
        many = "items" in value
        for each in _alternatives(value.get("items", value)):
            if (name := each.get("$ref", "").rpartition("/")[2]) in tables:
                path = f"{of}{key}"
                header = f"[[{path}]]" if many else f"[{path}]"
                found[name] = f"{found[name]}`, `{header}" if name in found else header
                found |= _places(tables[name], tables, f"{path}.")
    return found


def _alternatives(value: dict[str, Any]) -> list[dict[str, Any]]:
    return [each for each in value.get("anyOf", [value]) if each.get("type") != "null"]


def _table(title: str, schema: dict[str, Any], about: str, meanings: dict[str, str]) -> str:
    rows = [f"## {title}\n", " ".join(about.split()) + "\n"]
    rows += ["| key | unit | range | default | what it is |", "|---|---|---|---|---|"]
    needed = schema.get("required", [])
    for key, value in schema["properties"].items():
        if any("$ref" in each for each in _alternatives(value.get("items", value))):
            continue  # a table of its own
        unit = next((unit for end, unit in _UNITS.items() if key.endswith(f"_{end}")), "")
        default = "needed" if key in needed else _shown(value.get("default"))
        cells = (f"`{key}`", unit, _range(value), default, meanings.get(key, ""))
        rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows) + "\n"


def _range(value: dict[str, Any]) -> str:
    """What may be written there."""
    said = []
    for each in _alternatives(value):
        if values := each.get("enum", [each["const"]] if "const" in each else []):
            said.append(", ".join(f"`{_shown(one)}`" for one in values))
        elif each.get("type") == "array":
            inner = each.get("prefixItems", [each.get("items")])[0]
            if inner.get("type") == "array":
                said.append(f"{each['minItems']}{'' if 'maxItems' in each else ' or more'} places")
            else:
                which = "least and most" if "prefixItems" in each else "numbers"
                said.append(f"{which}, each {_interval(inner)}")
        else:
            said.append(each.get("pattern", "") or _interval(each) or _WORDS.get(each["type"], ""))
    return " or ".join(said)


def _interval(value: dict[str, Any]) -> str:
    low, high = value.get("minimum"), value.get("maximum")
    if (above := value.get("exclusiveMinimum")) is not None:
        return f"> {_shown(above)}" + ("" if high is None else f", up to {_shown(high)}")
    if high is None:
        return "" if low is None else f"{_shown(low)} or more"
    return f"{_shown(low)} to {_shown(high)}"


def _shown(value: object) -> str:
    if value is None or value == []:
        return ""
    return f"{value:g}" if isinstance(value, float) else str(value).replace("|", "\\|")
