"""The parameter protocol as a ground station packs it; bounds against those of a mission file."""

import itertools
import math
import struct
from dataclasses import fields, replace
from pathlib import Path
from typing import Annotated, Any

import pytest
from by_hand import (
    OURS,
    PERSON,
    Value,
    any_message,
    param_list,
    param_read,
    param_set,
    param_value,
)
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError
from pymavlink.dialects.v20 import all as wire

from companion.config import load_mission
from companion.errors import InputError
from companion.mavlink.addressing import Reply
from companion.mavlink.parameter_server import ParameterServer
from companion.mission.events import FenceChanged
from companion.objective.scene import Weights
from companion.path.limits import Limits
from companion.planner.adjustable import PARAMETERS, Parameter
from companion.planner.rules import check_task
from companion.planner.settings import PlannerSettings, Task
from companion.sources.mission_schema import MissionVehicleTable, PlannerTable, WeightsTable
from companion.world.threats import CircleZone

MISSION = load_mission("valley")
TASK = MISSION.task
NAMES = [parameter.name for parameter in PARAMETERS]
STRANGER = (42, 1)


def made(task: Task = TASK, **changes: Any) -> ParameterServer:
    return ParameterServer(task, ours=OURS, commanders=((255, 0),), **changes)


def listed(server: ParameterServer, now_s: float) -> list[tuple[float, Value]]:
    """What comes at 50 Hz within two seconds, and when."""
    times = [now_s + 0.02 * step for step in range(100)]
    return [(at_s, param_value(one)) for at_s in times for one in server.on_time(at_s)]


def test_names_are_short_and_different() -> None:
    assert len(set(NAMES)) == len(NAMES)
    assert all(0 < len(name) <= 16 and name.startswith("PLN_") for name in NAMES)


def test_the_table_has_every_weight() -> None:
    weights = {parameter.field for parameter in PARAMETERS if parameter.part is Weights}
    assert weights == {field.name for field in fields(Weights)}


@pytest.mark.parametrize("target", [OURS, (7, 0), (0, 0), (0, 195)])
def test_a_list_comes_whole_and_not_at_once(target: tuple[int, int]) -> None:
    server = made()
    first = server.on_message(param_list(target=target, sender=STRANGER), 5.0).replies
    values = [(5.0, param_value(one)) for one in first] + listed(server, 5.0)
    assert [value.name for _, value in values] == NAMES
    assert [value.index for _, value in values] == list(range(len(NAMES)))
    assert {(value.kind, value.count) for _, value in values} == {(9, len(NAMES))}
    times = [at_s for at_s, _ in values]
    assert all(b - a >= 0.039 for a, b in itertools.pairwise(times))


def test_a_list_asked_for_again_begins_again() -> None:
    server = made()
    server.on_message(param_list(), 5.0)
    server.on_time(5.1)
    first = server.on_message(param_list(), 5.12).replies
    assert [param_value(one).index for one in first] == [0]
    assert [value.index for _, value in listed(server, 5.12)] == list(range(1, len(NAMES)))


def test_a_list_goes_on_when_the_clock_begins_again() -> None:
    server = made()
    server.on_message(param_list(), 500.0)
    assert [value.index for _, value in listed(server, 1.0)] == list(range(1, len(NAMES)))


@pytest.mark.parametrize("index", range(len(PARAMETERS)))
def test_each_is_read_by_name_and_by_index(index: int) -> None:
    by_index = made().on_message(param_read(index=index, target=(7, 0)), 1.0).replies
    by_name = made().on_message(param_read(NAMES[index]), 1.0).replies
    assert [param_value(one) for one in by_index] == [param_value(one) for one in by_name]
    assert param_value(by_name[0]).index == index


def test_values_are_those_of_the_mission() -> None:
    values = {}
    for name in NAMES:
        [one] = made().on_message(param_read(name), 1.0).replies
        values[name] = round(param_value(one).value, 5)
    settings, weights = TASK.settings, TASK.settings.weights
    assert values == {
        "PLN_W_LENGTH": weights.length,
        "PLN_W_HEIGHT": weights.height,
        "PLN_W_GUIDE": weights.guide,
        "PLN_W_CRASH": weights.crash,
        "PLN_W_RADAR": weights.radar,
        "PLN_W_CONSTR": weights.constraints,
        "PLN_SCAN_RANGE": settings.scan_range_m,
        "PLN_SCAN_DIST": 0.0,
        "PLN_SCAN_TIME": settings.scan_time_s,
        "PLN_SAFE_DIST": settings.safety_distance_m,
        "PLN_PLAN_TIME": settings.planning_time_s,
        "PLN_OVERLAP": settings.overlap_m,
        "PLN_EVALS": settings.evaluations,
        "PLN_SPEED": TASK.limits.speed_m_s,
        "PLN_ERR_TRACK": TASK.limits.tracking_error_m,
        "PLN_ERR_NAV": TASK.limits.navigation_error_m,
    }


@pytest.mark.parametrize(
    "message",
    [
        param_read("ARMING_CHECK", target=(7, 0)),
        param_read(index=len(PARAMETERS)),
        param_read("PLN_SPEED", target=(7, 1)),
        param_read("PLN_SPEED", target=(8, 195)),
        param_read("PLN_SPEED", sender=OURS),
        param_list(target=(8, 0)),
        param_list(target=(7, 1)),
    ],
)
def test_what_there_is_not_and_what_is_for_others_is_not_answered(message: Any) -> None:
    server = made()
    assert list(server.on_message(message, 1.0).replies) == []
    assert listed(server, 1.0) == []


# --- setting


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("PLN_W_GUIDE", 0.4),
        ("PLN_W_RADAR", 0.0),
        ("PLN_SCAN_RANGE", 1234.5),
        ("PLN_SCAN_DIST", 400.0),
        ("PLN_SCAN_TIME", 4.2),
        ("PLN_SAFE_DIST", 33.3),
        ("PLN_PLAN_TIME", 2.1),
        ("PLN_OVERLAP", 0.0),
        ("PLN_EVALS", 600.0),
        ("PLN_SPEED", 6.1),
        ("PLN_ERR_TRACK", 4.2),
        ("PLN_ERR_NAV", 0.0),
    ],
)
def test_what_is_set_is_taken_and_told_to_everybody(name: str, value: float) -> None:
    server = made()
    parameter = PARAMETERS[NAMES.index(name)]
    reply = server.on_message(param_set(name, value), 1.0)
    [told] = reply.replies
    [as_float] = struct.unpack("<f", struct.pack("<f", value))
    assert param_value(told) == Value(name, as_float, 9, len(NAMES), NAMES.index(name))
    assert not hasattr(told, "target_system")  # a broadcast
    assert (reply.changed, reply.text) == (f"{name} = {value:g}", "")
    assert reply.task is server.task
    assert parameter.value(server.task) == value  # not 33.29999923706055
    others = [other for other in PARAMETERS if other is not parameter]
    assert [other.value(server.task) for other in others] == [o.value(TASK) for o in others]
    back = server.on_message(param_set(name, parameter.value(TASK)), 2.0)
    assert len(back.replies) == 1
    assert server.task == TASK


def test_the_kinds_of_numbers_stay() -> None:
    server = made()
    server.on_message(param_set("PLN_EVALS", 600.0), 1.0)
    assert isinstance(server.task.settings.evaluations, int)
    server.on_message(param_set("PLN_SCAN_DIST", 400.0), 1.0)
    server.on_message(param_set("PLN_SCAN_DIST", 0.0), 1.0)
    assert server.task.settings.scan_distance_m is None


def test_the_same_value_changes_nothing() -> None:
    server = made()
    reply = server.on_message(param_set("PLN_SPEED", 8.0), 1.0)
    assert (len(reply.replies), reply.task, reply.text) == (1, None, "")


@pytest.mark.parametrize(
    ("name", "value", "word"),
    [
        *((name, value, "finite") for name in NAMES for value in (math.nan, math.inf)),
        *((name, -1.0, "must be") for name in NAMES),
        *((name, 1.1e6, "must be") for name in NAMES),
        ("PLN_EVALS", 100.5, "whole"),
        ("PLN_EVALS", 59.0, "60"),
        ("PLN_SPEED", 0.0, "must be"),
        ("PLN_SPEED", 8.1, "mission's"),
        ("PLN_PLAN_TIME", 80.0, "eq. 4"),
        ("PLN_SCAN_DIST", 10.0, "eq. 4"),
        ("PLN_SCAN_TIME", 1.0, "33 requests"),
        ("PLN_SAFE_DIST", 600.0, "eq. 4"),
        ("PLN_SCAN_RANGE", 220.0, "eq. 4"),
        ("PLN_SCAN_RANGE", 30.0, "= 30: the map has more than"),
        ("PLN_ERR_TRACK", 100.0, "band"),
    ],
)
def test_what_breaks_a_rule_is_refused_with_it(name: str, value: float, word: str) -> None:
    server = made()
    reply = server.on_message(param_set(name, value), 1.0)
    told, error = reply.replies
    assert param_value(told).value == pytest.approx(PARAMETERS[NAMES.index(name)].value(TASK))
    assert (error.param_id, error.error) == (name, wire.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE)
    assert (error.target_system, error.target_component) == PERSON
    assert server.task is TASK
    assert reply.task is None
    assert reply.text.startswith(name)
    assert word in reply.text


def refusal(server: ParameterServer, name: str, value: float) -> str:
    """Why it was not set; "" if it was."""
    reply = server.on_message(param_set(name, value), 1.0)
    assert (reply.task is None) == bool(reply.text)
    return reply.text


def test_a_target_stays_outside_of_zones() -> None:
    zone = CircleZone(name="z", north_m=0.0, east_m=160.0, radius_m=100.0)
    server = made(replace(TASK, zones=(zone,)), targets_ne_m=((0.0, 0.0),))
    assert refusal(server, "PLN_SAFE_DIST", 45.0) == ""
    assert "'z'" in refusal(server, "PLN_SAFE_DIST", 58.0)


SITL = load_mission("sitl-arducopter").task


def test_the_floor_stays_clear_of_the_ground_as_it_is_stated() -> None:
    """As in the mission file, with whose floor and ground 18 m is the most."""
    server = made(SITL)
    why = refusal(server, "PLN_SAFE_DIST", 25.0)
    assert why.startswith("PLN_SAFE_DIST = 25: altitude.floor_amsl_m = 610.0: ")
    assert refusal(server, "PLN_SAFE_DIST", 18.0) == ""


def test_the_band_within_the_vehicles_own_fence_stays_thick_enough() -> None:
    server = made(SITL)
    server.fence = FenceChanged(time_s=0.0, zones=(), ceiling_amsl_m=640.0)
    assert "altitude.ceiling_amsl_m = 640.0" in refusal(server, "PLN_ERR_TRACK", 8.0)


def test_what_is_broken_already_refuses_nothing_else() -> None:
    server = made(SITL, targets_ne_m=((100.0, 0.0),))
    about = CircleZone(name="z", north_m=100.0, east_m=0.0, radius_m=50.0)
    server.fence = FenceChanged(time_s=0.0, zones=(about,), ceiling_amsl_m=630.0)
    assert refusal(server, "PLN_SAFE_DIST", 12.0) == ""


def test_the_scan_range_is_fixed_in_the_air_and_by_terrain_that_is_known_in_advance() -> None:
    charted, airborne = made(), made()
    charted.charted = airborne.airborne = True
    assert "planner.scan_range_m" in refusal(charted, "PLN_SCAN_RANGE", 1600.0)
    why = refusal(airborne, "PLN_SCAN_RANGE", 1600.0)
    assert why == "PLN_SCAN_RANGE = 1600: it can be set on the ground only"
    assert refusal(airborne, "PLN_SAFE_DIST", 45.0) == ""


@pytest.mark.parametrize(
    ("message", "why"),
    [
        (param_set("PLN_SPEED", 5.0, sender=STRANGER), wire.MAV_PARAM_ERROR_PERMISSION_DENIED),
        (param_set("PLN_SPEED", 5.0, sender=(7, 1)), wire.MAV_PARAM_ERROR_PERMISSION_DENIED),
        (param_set("PLN_SPEED", 5.0, kind=6), wire.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE),
    ],
)
def test_strangers_and_other_types_change_nothing_and_see_the_value(message: Any, why: int) -> None:
    server = made()
    reply = server.on_message(message, 1.0)
    told, error = reply.replies
    assert error.error == why
    assert param_value(told).value == 8.0
    assert reply.text
    assert server.task is TASK


@pytest.mark.parametrize("target", [(7, 0), (0, 0), (0, 195), (7, 1), (8, 195)])
def test_what_is_set_for_everybody_is_not_for_us(target: tuple[int, int]) -> None:
    server = made()
    assert server.on_message(param_set("PLN_SPEED", 5.0, target=target), 1.0) == Reply()
    assert server.task is TASK


def test_a_parameter_that_there_is_not_is_refused() -> None:
    server = made()
    reply = server.on_message(param_set("WPNAV_SPEED", 5.0), 1.0)
    [error] = reply.replies
    assert (error.param_index, error.error) == (-1, wire.MAV_PARAM_ERROR_DOES_NOT_EXIST)
    assert reply.text == "'WPNAV_SPEED': there is no such parameter"


# --- the same rules as in a mission file


def rule_of(parameter: Parameter) -> TypeAdapter[Any]:
    tables: dict[type, Any] = {
        PlannerSettings: PlannerTable,
        Weights: WeightsTable,
        Limits: MissionVehicleTable,
    }
    info = tables[parameter.part].model_fields[parameter.field]
    kind = info.annotation
    return TypeAdapter(Annotated[kind, *info.metadata] if info.metadata else kind)


@pytest.mark.parametrize("parameter", PARAMETERS, ids=NAMES)
def test_its_row_of_the_page_has_its_key_and_range(parameter: Parameter) -> None:
    page = Path(__file__).parents[2] / "docs" / "reference" / "parameters.md"
    row = next(r for r in page.read_text("utf-8").splitlines() if f"`{parameter.name}`" in r)
    least = "above" if parameter.above_low else "or more"
    assert f"| `{parameter.key}` |" in row
    assert least in row
    assert f"{parameter.low:g}" in row
    assert ("on the ground only" in row) == parameter.on_ground


@pytest.mark.parametrize("parameter", PARAMETERS, ids=NAMES)
def test_bounds_are_those_of_a_mission_file(parameter: Parameter) -> None:
    edges = (-1.0, 0.0, 1e-9, 1.0, 59.0, 60.0, 61.0, 200_000.0, 200_001.0, 1e6, 1.1e6)
    for value in edges:
        if parameter.unset and value == 0.0:
            continue  # the file leaves it out
        try:
            rule_of(parameter).validate_python(value)
            allowed = True
        except ValidationError:
            allowed = False
        assert (parameter.refusal(value) == "") == allowed, value


VALUES = st.floats(width=32) | st.floats(0.0, 5_000.0, width=32)


@given(st.lists(st.tuples(st.sampled_from(NAMES), VALUES, st.booleans()), max_size=12))
def test_the_task_obeys_the_rules_whatever_is_set(asked: list[tuple[str, float, bool]]) -> None:
    server = made()
    for name, value, airborne in asked:
        server.airborne = airborne
        before = server.task
        reply = server.on_message(param_set(name, value), 1.0)
        told, *errors = reply.replies
        assert param_value(told).name == name
        assert bool(errors) == bool(reply.text)
        assert math.isfinite(param_value(told).value)
        assert (reply.task is not None) == (server.task != before)
        if reply.task is None and not math.isnan(value):
            assert reply.text or param_value(told).value == value
        try:
            check_task(server.task)
        except InputError as error:
            pytest.fail(str(error))
        assert server.task.limits.speed_m_s <= TASK.limits.speed_m_s


@given(
    st.sampled_from(sorted(wire.mavlink_map)),
    st.binary(max_size=255),
    st.sampled_from([PERSON, STRANGER, OURS]),
)
def test_no_message_whatever_breaks_it(
    number: int, payload: bytes, sender: tuple[int, int]
) -> None:
    reply = made().on_message(any_message(number, payload, sender), 1.0)
    if number not in (20, 21, 23):
        assert reply == Reply()
