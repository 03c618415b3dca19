"""Bundled missions and worlds load as written; keys and values of a mission file are held to."""

import functools
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.config import bundled, load_mission, load_world, mission_text
from companion.errors import InputError
from companion.mission.mission import EndAction, Mission
from companion.optimise.registry import OPTIMISERS
from companion.path.envelope import flown_on_m

ENVIRONMENTS = Path(__file__).parents[1] / "companion" / "environments"
TEXT = (ENVIRONMENTS / "environment-1" / "mission.toml").read_text(encoding="utf-8")
WORLD_TEXT = (ENVIRONMENTS / "environment-1" / "world.toml").read_text(encoding="utf-8")
OPTIONAL = {"autopilot", "overlap_m", "tracking_error_m"}  # the keys of TEXT that may be left out


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("config") / "mission.toml"


def load(file: Path, text: str) -> Mission:
    file.write_text(text, encoding="utf-8")
    return load_mission(str(file))


def refused(file: Path, text: str) -> str:
    """The message of the error: one line, field = value: rule. Remedy."""
    with pytest.raises(InputError) as caught:
        load(file, text)
    message = str(caught.value)
    assert re.fullmatch(r"\S[^\n]*? = [^\n]+: [^\n]+\. [A-Z][^\n]*[.?]", message), message
    return message


def with_line(key: str, line: str) -> str:
    """The text with another line in place of the first with that key."""
    after, count = re.subn(rf"^{key} = [^#\n]*", line + " ", TEXT, count=1, flags=re.M)
    assert count == 1, key
    return after


def vehicle(text: str) -> str:
    """The mission with more keys of its vehicle."""
    return TEXT.replace("tracking_error_m", f"{text}\ntracking_error_m", 1)


@pytest.mark.parametrize("name", bundled())
def test_bundled_missions_and_worlds_load_as_they_are_written(name: str) -> None:
    mission = load_mission(name)
    table = tomllib.loads(mission_text(name))
    assert mission.name == table["name"] == load_world(name).name
    places = [(target["north_m"], target["east_m"]) for target in table["targets"]]
    assert [*mission.targets_ne_m] == places
    assert mission.task.limits.speed_m_s == table["vehicle"]["speed_m_s"]
    assert mission.task.settings.scan_range_m == table["planner"]["scan_range_m"]
    assert mission.end_action is EndAction(table["end"]["action"])
    assert len(mission.task.radars) == len(table.get("radars", []))


def test_a_world_starts_where_its_vehicle_stands_and_has_its_peaks(file: Path) -> None:
    table: dict[str, Any] = tomllib.loads(WORLD_TEXT)
    world = load_world("environment-1")
    assert world.start_ne_m == (table["vehicle"]["north_m"], table["vehicle"]["east_m"])
    assert len(world.terrain.peaks) == len(table["terrain"]["peaks"])
    file.write_text(WORLD_TEXT.replace("height_amsl_m", "height_m", 1), encoding="utf-8")
    with pytest.raises(InputError, match=r"terrain\.peaks\[0\]\.height_m = .*height_amsl_m"):
        load_world(str(file))


@given(tracking_m=st.floats(0.2, 40.0), navigation_m=st.floats(0.0, 40.0))
def test_the_take_off_ends_where_paths_may_begin(
    file: Path, tracking_m: float, navigation_m: float
) -> None:
    """However the errors compare: a vehicle hovering there is within the band of a certificate."""
    text = with_line("tracking_error_m", f"tracking_error_m = {tracking_m}")
    more = f"navigation_error_m = {navigation_m}\ntracking_error_m"
    mission = load(file, text.replace("tracking_error_m", more))
    error_m = tracking_m + navigation_m
    assert mission.task.error_m == pytest.approx(error_m)
    low, high = mission.task.band_amsl_m
    assert 3000.0 + error_m <= low <= mission.task.take_off_amsl_m < high <= 5000.0 - error_m


def test_errors_and_the_dead_man_time_of_the_vehicle_are_taken_as_they_are_written(
    file: Path,
) -> None:
    task = load(file, vehicle("navigation_error_m = 7.5\ndead_man_s = 2.0")).task
    limits = task.limits
    assert (limits.tracking_error_m, limits.navigation_error_m) == (15.0, 7.5)
    assert flown_on_m(task.envelope, 100.0) == pytest.approx(2.0 * 100.0 + 100.0**2 / (2.0 * 5.0))
    for key in ("navigation_error_m", "dead_man_s"):
        load(file, vehicle(f"{key} = 0.0"))
        rule = f"vehicle.{key} = -0.1: .*greater than or equal to 0"
        assert re.search(rule, refused(file, vehicle(f"{key} = -0.1")))


def test_the_optimiser_is_the_profiles_unless_the_mission_names_one(file: Path) -> None:
    def naming(name: str) -> str:
        return TEXT.replace("overlap_m", f'optimiser = "{name}"\noverlap_m', 1)

    assert load(file, TEXT).task.settings.optimiser is None
    message = refused(file, naming("magic"))
    assert "planner.optimiser = 'magic'" in message
    for name in OPTIMISERS:
        assert load(file, naming(name)).task.settings.optimiser == name
        assert name in message


def test_what_is_no_mission_is_told(file: Path, tmp_path: Path) -> None:
    """Files of another kind: `tests/sources/test_files.py`."""
    names = r"'nowhere'.*no such file.*environment-1, environment-2"
    folder = r"it is a folder\. Give a mission\.toml"
    for name, words in (("nowhere", names), (str(tmp_path), folder), ("x" * 5000, "xxx")):
        with pytest.raises(InputError, match=words):
            load_mission(name)
    assert "this is a world, not a mission" in refused(file, WORLD_TEXT)
    file.write_text(TEXT, encoding="utf-8")
    with pytest.raises(InputError, match=r"this is a mission, not a world. Give its world.toml"):
        load_world(str(file))


@pytest.mark.parametrize(
    ("key", "name"),
    [
        ("speed_m_s", "speed"),
        ("scan_range_m", "scan_range_km"),
        ("turn_radius_m", "turning_radius_m"),
        ("action", "acton"),
        ("floor_amsl_m", "floor_agl_m"),
    ],
)
def test_a_wrong_key_is_named_with_its_value_and_the_nearest_known_one(
    file: Path, key: str, name: str
) -> None:
    value = re.search(rf'^{key} = "?([^#\n" ]*)', TEXT, flags=re.M)
    message = refused(file, re.sub(rf"^{key} =", f"{name} =", TEXT, count=1, flags=re.M))
    assert f"{name} = " in message
    assert value[1] in message
    assert f"Did you mean {key}?" in message
    assert "Known here: " in message


@functools.cache
def keys() -> tuple[tuple[int, str], ...]:
    """Line number and key of every key of the mission."""
    found = [(n, re.match(r"(\w+) = ", line)) for n, line in enumerate(TEXT.splitlines())]
    return tuple((number, match[1]) for number, match in found if match)


@given(which=st.integers(0, len(keys()) - 1), suffix=st.text("abcm_z", min_size=1, max_size=4))
def test_a_key_that_is_deleted_or_renamed_is_an_input_error_and_nothing_else(
    file: Path, which: int, suffix: str
) -> None:
    number, key = keys()[which]
    lines = TEXT.splitlines()
    without = "\n".join(lines[:number] + lines[number + 1 :])
    if key in OPTIONAL:
        load(file, without)
    else:
        message = refused(file, without)
        assert key in message
        assert "it is missing" in message or "a place is given by" in message
    lines[number] = lines[number].replace(f"{key} =", f"{key}{suffix} =", 1)
    assert f"{key}{suffix}" in refused(file, "\n".join(lines))


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
def test_no_number_may_be_infinite_or_none_at_all(file: Path, value: str) -> None:
    numbers = [number for number, key in keys() if re.search(r"_(m|s|s2|deg)$", key)]
    assert len(numbers) > 25
    for number in numbers:
        lines = TEXT.splitlines()
        key = lines[number].split()[0]
        lines[number] = f"{key} = {value}"
        assert f"{key} = {value}" in refused(file, "\n".join(lines))
    assert "planner.weights.radar = " in refused(file, f"{TEXT}\n[planner.weights]\nradar={value}")


@pytest.mark.parametrize(
    ("line", "rule"),
    [
        ('speed_m_s = "fast"', "valid number"),
        ("speed_m_s = 0.0", "greater than 0"),
        ("speed_m_s = true", "valid number"),
        ("climb_angle_deg = 90.0", "less than 90"),
        ("latitude_deg = 86.0", "less than or equal to 85"),
        ("schema = 2", "must be 1"),
        ('kind = "boat"', "'copter' or 'plane'"),
        ('autopilot = "betaflight"', "'ardupilot' or 'px4'"),
        ('action = "loiter"', "'hold', 'land' or 'return'"),
        ("name = 7", "valid string"),
        ("floor_amsl_m = -501.0", "greater than or equal to -500"),
    ],
)
def test_a_value_of_the_wrong_kind_is_told_what_it_must_be(
    file: Path, line: str, rule: str
) -> None:
    key, value = line.split(" = ")
    message = refused(file, with_line(key, line))
    assert f"{key} = " in message
    assert value.strip('"').title() in message.title()
    assert rule in message
