"""The schemas that are printed are those of what is written and read; held by jsonschema."""

import json
import tomllib
from functools import cache
from typing import Any

import msgspec
import pytest
from answers import answered
from golden import GOLDENS, NAMES
from jsonschema import Draft202012Validator
from typer.testing import CliRunner

from companion.config import bundled, folder_of, load_mission
from companion.session import Session
from companion.telemetry.flight_status import flight_status
from companion.telemetry.flight_summary import FlightSummary
from vehicle_sim.cli import app as simulator_app


@cache
def schema_of(what: str) -> Draft202012Validator:
    if what == "world":
        code, printed = 0, CliRunner().invoke(simulator_app, ["--schema"]).stdout
    else:
        code, printed, _ = answered("schema", what)
    assert code == 0
    schema = json.loads(printed)
    Draft202012Validator.check_schema(schema)
    return Draft202012Validator(schema)


def why_not(what: str, values: dict[str, Any]) -> list[str]:
    return [error.message for error in schema_of(what).iter_errors(values)]


def bundled_table(name: str, what: str) -> dict[str, Any]:
    return tomllib.loads((folder_of(name) / f"{what}.toml").read_text(encoding="utf-8"))


@pytest.mark.parametrize("what", ["mission", "world"])
@pytest.mark.parametrize("name", bundled())
def test_bundled_files_are_as_their_schema_says(what: str, name: str) -> None:
    assert why_not(what, bundled_table(name, what)) == []


@pytest.mark.parametrize(
    "wrong",
    [
        {"origin": {"latitude_deg": 95.0, "longitude_deg": 8.0}},
        {"vehicle": {"speed": 8.0}},
        {"targets": [{"north_m": "1000"}]},
        {"end": {"action": "hover"}},
        {"threats": {"files": "zones.geojson"}},
    ],
    ids=str,
)
def test_a_mission_that_is_refused_breaks_its_schema(wrong: dict[str, Any]) -> None:
    assert len(why_not("mission", bundled_table("environment-1", "mission") | wrong)) == 1


@pytest.mark.parametrize("name", NAMES)
def test_recorded_journals_are_as_their_schema_says(name: str) -> None:
    lines = (GOLDENS / name / "decisions.jsonl").read_text(encoding="utf-8").splitlines()
    entries = [entry for entry in map(json.loads, lines) if "kind" in entry]
    assert len(entries) > 5
    assert {why for entry in entries for why in why_not("journal", entry)} == set()


def test_a_status_is_as_its_schema_says() -> None:
    session = Session(load_mission("environment-1"), seed=1, lockstep=True)
    status = msgspec.to_builtins(flight_status(FlightSummary(session=session)))
    assert why_not("status", status) == []
    assert why_not("status", status | {"armed": "yes"}) != []
