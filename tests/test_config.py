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
    """The message of the error: one line that ends with a sentence."""
    with pytest.raises(InputError) as caught:
        load(file, text)
    message = str(caught.value)
    assert len(message.splitlines()) == 1
    # field = value: rule. Remedy.
    assert re.fullmatch(r"(?P<field>\S.*?) = .+: .+\. [A-Z].*[.?]", message), message
    return message


def with_value(key: str, value: str) -> str:
    """The text with the first value of a key replaced."""
    after, count = re.subn(rf"^{key} = [^#\n]*", f"{key} = {value} ", TEXT, count=1, flags=re.M)
    assert count == 1, key
    return after


def renamed(key: str, name: str) -> str:
    after, count = re.subn(rf"^{key} =", f"{name} =", TEXT, count=1, flags=re.M)
    assert count == 1, key
    return after


# --- what is right


@pytest.mark.parametrize("name", bundled())
def test_bundled_missions_and_worlds_load_as_they_are_written(name: str) -> None:
    mission = load_mission(name)
    table = tomllib.loads(mission_text(name))
    assert mission.name == table["name"] == load_world(name).name
    assert [list(t) for t in mission.targets_ne_m] == [
        [t["north_m"], t["east_m"]] for t in table["targets"]
    ]
    assert mission.task.limits.speed_m_s == table["vehicle"]["speed_m_s"]
    assert mission.task.settings.scan_range_m == table["planner"]["scan_range_m"]
    assert mission.end_action is EndAction(table["end"]["action"])
    assert len(mission.task.radars) == len(table.get("radars", []))


def test_the_bundled_names_are_the_folders() -> None:
    assert {"environment-1", "environment-2"} <= set(bundled())
    assert all((ENVIRONMENTS / name / "world.toml").is_file() for name in bundled())


def test_a_file_and_a_bundled_name_are_the_same_mission(file: Path) -> None:
    assert load(file, TEXT) == load_mission("environment-1")


def test_a_profile_that_is_asked_for_overrides_the_files(file: Path) -> None:
    file.write_text(TEXT, encoding="utf-8")
    assert load_mission(str(file)).task.settings.profile.verified
    assert not load_mission(str(file), "paper").task.settings.profile.verified


def vehicle(text: str) -> str:
    """The mission with more keys of its vehicle."""
    return TEXT.replace("tracking_error_m", f"{text}\ntracking_error_m", 1)


@given(tracking_m=st.floats(0.2, 40.0), navigation_m=st.floats(0.0, 40.0))
def test_the_take_off_ends_where_paths_may_begin(
    file: Path, tracking_m: float, navigation_m: float
) -> None:
    """However the errors compare: a vehicle hovering there is within the band of a certificate."""
    text = with_value("tracking_error_m", f"{tracking_m}")
    text = text.replace(
        "tracking_error_m", f"navigation_error_m = {navigation_m}\ntracking_error_m"
    )
    mission = load(file, text)
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
    assert limits.dead_man_s == 2.0
    assert flown_on_m(task.envelope, 100.0) == pytest.approx(2.0 * 100.0 + 100.0**2 / (2.0 * 5.0))
    unsaid = load(file, TEXT).task.limits
    assert (unsaid.navigation_error_m, unsaid.dead_man_s) == (5.0, 3.5)
    for key in ("navigation_error_m", "dead_man_s"):
        load(file, vehicle(f"{key} = 0.0"))
        rule = f"vehicle.{key} = -0.1: .*greater than or equal to 0"
        assert re.search(rule, refused(file, vehicle(f"{key} = -0.1")))


@pytest.mark.parametrize("name", sorted(OPTIMISERS))
def test_the_optimiser_is_the_profiles_unless_the_mission_names_one(file: Path, name: str) -> None:
    def naming(name: str) -> str:
        return TEXT.replace("overlap_m", f'optimiser = "{name}"\noverlap_m', 1)

    assert load(file, naming(name)).task.settings.optimiser == name
    assert load(file, TEXT).task.settings.optimiser is None
    message = refused(file, naming("magic"))
    assert "planner.optimiser = 'magic'" in message
    assert name in message


# --- files


def test_what_is_no_file_is_told(tmp_path: Path) -> None:
    """Files of another kind: `tests/sources/test_files.py`."""
    names = r"'nowhere'.*no such file.*environment-1, environment-2"
    folder = r"it is a folder\. Give a mission\.toml"
    for name, words in (("nowhere", names), (str(tmp_path), folder), ("x" * 5000, "xxx")):
        with pytest.raises(InputError, match=words):
            load_mission(name)


@pytest.mark.parametrize("text", ["schema = \n", "[origin\n", "a = 1\na = 2\n"])
def test_what_is_not_toml_is_told_where(file: Path, text: str) -> None:
    message = refused(file, text)
    assert "not TOML" in message
    assert "line" in message
    assert str(file) in message


def test_a_world_is_no_mission_and_a_mission_no_world(file: Path) -> None:
    assert "this is a world, not a mission" in refused(file, WORLD_TEXT)
    file.write_text(TEXT, encoding="utf-8")
    with pytest.raises(InputError, match=r"this is a mission, not a world. Give its world.toml"):
        load_world(str(file))


# --- keys


@pytest.mark.parametrize(
    ("key", "name"),
    [
        ("speed_m_s", "speed_m_per_s"),
        ("speed_m_s", "speed"),
        ("scan_range_m", "scan_range"),
        ("scan_range_m", "scan_range_km"),
        ("turn_radius_m", "turning_radius_m"),
        ("planning_time_s", "planing_time_s"),
        ("latitude_deg", "latitude"),
        ("north_min_m", "north_min"),
        ("action", "acton"),
        ("range_m", "range_km"),
        ("schema", "scheme"),
        *(("floor_amsl_m", f"floor{end}") for end in ("_m", "_agl_m", "_amsl_ft", "", "_ft")),
    ],
)
def test_a_wrong_key_is_named_with_its_value_and_the_nearest_known_one(
    file: Path, key: str, name: str
) -> None:
    message = refused(file, renamed(key, name))
    value = re.search(rf"^{key} = ([^#\n]*)", TEXT, flags=re.M)
    assert f"{name} = " in message
    assert value[1].strip().strip('"') in message
    assert f"Did you mean {key}?" in message
    assert "Known here: " in message


@pytest.mark.parametrize(
    ("extra", "field"),
    [
        ("[wind]\nspeed_m_s = 3.0\n", "wind"),
        ("[planner.weights]\nlongth = 1.0\n", "planner.weights.longth"),
        ('[[keep_outs]]\nname = "x"\nradius = 3.0\n', "keep_outs[0].radius"),
        *(  # a weight is a number that is not negative
            (f"[planner.weights]\n{weight} = {value}\n", f"planner.weights.{weight}")
            for weight in ("length", "height", "guide", "crash", "radar", "constraints")
            for value in ("nan", "inf", "-1.0")
        ),
    ],
)
def test_a_key_and_a_value_are_refused_wherever_they_are(
    file: Path, extra: str, field: str
) -> None:
    assert f"{field} = " in refused(file, f"{TEXT}\n{extra}")


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


@pytest.mark.parametrize(
    ("key", "value", "rule"),
    [
        ("speed_m_s", '"fast"', "valid number"),
        ("speed_m_s", "0.0", "greater than 0"),
        ("speed_m_s", "true", "valid number"),
        ("climb_angle_deg", "90.0", "less than 90"),
        ("latitude_deg", "86.0", "less than or equal to 85"),
        ("schema", "2", "must be 1"),
        ("kind", '"boat"', "'copter' or 'plane'"),
        ("autopilot", '"betaflight"', "'ardupilot' or 'px4'"),
        ("action", '"loiter"', "'hold', 'land' or 'return'"),
        ("name", "7", "valid string"),
        ("floor_amsl_m", "-501.0", "greater than or equal to -500"),
    ],
)
def test_a_value_of_the_wrong_kind_is_told_what_it_must_be(
    file: Path, key: str, value: str, rule: str
) -> None:
    message = refused(file, with_value(key, value))
    assert f"{key} = " in message
    assert value.strip('"').title() in message.title()
    assert rule in message


def test_empty_targets_are_refused(file: Path) -> None:
    text = re.sub(r"\[\[targets\]\]\nnorth_m.*\neast_m.*\n", "", TEXT)
    assert "at least 1 item" in refused(file, text.replace("[origin]", "targets = []\n[origin]"))


# --- worlds


def test_a_world_starts_where_its_vehicle_stands_and_has_its_peaks(file: Path) -> None:
    table: dict[str, Any] = tomllib.loads(WORLD_TEXT)
    world = load_world("environment-1")
    assert world.start_ne_m == (table["vehicle"]["north_m"], table["vehicle"]["east_m"])
    assert len(world.terrain.peaks) == len(table["terrain"]["peaks"])
    file.write_text(WORLD_TEXT.replace("height_amsl_m", "height_m", 1), encoding="utf-8")
    with pytest.raises(InputError, match=r"terrain\.peaks\[0\]\.height_m = .*height_amsl_m"):
        load_world(str(file))
