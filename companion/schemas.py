"""JSON schemas of what people write, and of what they read with programs of their own."""

from typing import Any, Literal

import msgspec

from companion.mission.journal import KINDS, Header
from companion.sources.mission_file import MissionTable, ThreatsTable
from companion.telemetry.flight_status import LINES

_DRAFT = "https://json-schema.org/draft/2020-12/schema"
Document = Literal["mission", "journal", "status"]


def schema_of(document: Document) -> dict[str, Any]:
    """The schema of mission.toml, of a line of journal.jsonl, or of a line of `fly --json`."""
    if document == "mission":
        schema = _of_missions()
    else:
        schema = _of_lines((Header, *KINDS.values()) if document == "journal" else LINES)
    return {**schema, "$schema": _DRAFT}


def _of_missions() -> dict[str, Any]:
    schema = MissionTable.model_json_schema()
    schema["properties"]["threats"]["anyOf"].append(ThreatsTable.model_json_schema())
    for table in (schema, *schema["$defs"].values()):
        table.pop("required", None)  # a plan that is named may hold it: `check` says what lacks
    return schema


def _of_lines(kinds: tuple[Any, ...]) -> dict[str, Any]:
    any_of, definitions = msgspec.json.schema_components(
        kinds, schema_hook=lambda _: {"type": "object"}
    )
    for value in definitions.get("Certificate", {}).get("properties", {}).values():
        if value["type"] == "number":
            value["type"] = ["number", "null"]  # JSON has no infinite distances
    return {"anyOf": any_of, "$defs": definitions}
