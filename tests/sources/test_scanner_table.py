"""The table [scanner] of a mission: what looks about, and what is refused of it, in one line."""

import math
from pathlib import Path

import pytest
from spoiled import refusal

from companion.config import load_mission, mission_text
from companion.mavlink.near_scanner import messages_of, streams_hz
from companion.mission.mission import Mission
from companion.sources.files import toml_text

BEFORE, _REST = mission_text("forest").split("[scanner]")
AFTER = "[planner]" + _REST.split("[planner]")[1]
WIDE = "speaks_for_m = 4.0\n"
OBSTACLE = f'kind = "obstacle_distance"\n{WIDE}'
SECTORS = f'kind = "distance_sensor"\n{WIDE}'
STATED = "[terrain]\nhighest_amsl_m = 400.5"
PLANE = 'kind = "plane"\nloiter_radius_m = 30.0'


def load(folder: Path, scanner: str, *changes: tuple[str, str]) -> Mission:
    text = f"{BEFORE}[scanner]\n{scanner}\n{AFTER}"
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    path = folder / "mission.toml"
    path.write_text(text, encoding="utf-8")
    return load_mission(str(path))


@pytest.mark.parametrize(
    ("scanner", "kind", "component", "of_autopilot"),
    [
        (OBSTACLE, "obstacle_distance", 196, False),
        (SECTORS, "distance_sensor", 1, True),
        (f"{SECTORS}component = 158", "distance_sensor", 158, False),
    ],
)
def test_each_kind_says_what_is_listened_to_and_of_whom(
    tmp_path: Path, scanner: str, kind: str, component: int, of_autopilot: bool
) -> None:
    mission = load(tmp_path, scanner)
    assert (mission.near.kind, mission.near.component_id) == (kind, component)
    assert mission.scanner_component_id is None
    number = {"obstacle_distance": 330, "distance_sensor": 132}[kind]
    assert messages_of(mission) == {30, number}
    assert set(streams_hz(mission)) == ({30, number} if of_autopilot else {30})


ERRORS = {"forward_m": 0.1, "right_m": -0.2, "blind_m": 0.4, "latency_s": 0.01}
ERRORS |= {"latency_error_s": 0.02, "range_error_m": 0.3}
ERRORS |= {"position_error_m": 0.06, "drift_m_s": 0.01}


def test_all_that_is_said_of_it_is_taken_and_the_vehicle_stays_what_it_is(tmp_path: Path) -> None:
    angles = "component = 50\nyaw_deg = 90.0\nbearing_error_deg = 2.0\n"
    mission = load(tmp_path, OBSTACLE + angles + toml_text(ERRORS))
    near = mission.near
    assert (mission.kind, near.component_id, near.speaks_for_m) == ("copter", 50, 4.0)
    assert near.yaw_rad == pytest.approx(0.5 * math.pi)
    assert near.bearing_error_rad == pytest.approx(math.radians(2.0))
    assert {name: getattr(near, name) for name in ERRORS} == ERRORS
    assert near.range_m == mission.task.settings.scan_range_m
    assert (mission.known.guess_m == 400.5).all()  # of the ground; of what stands on it nothing
    assert not mission.known.surveyed.any()


KIND = 'kind = "copter"'
REFUSED: list[tuple[str, str, str, tuple[tuple[str, str], ...]]] = [
    ('kind = "radar"', "scanner.kind", "terrain_radar", ()),
    ("component = 196", "scanner.component = 196", "it is of the other kinds", ()),
    (f"{OBSTACLE}complete = true", "scanner.complete = True", "it is a radar's", ()),
    (
        *(OBSTACLE, "vehicle.scanner_component_id = 100", "Write scanner.component."),
        ((KIND, f"{KIND}\nscanner_component_id = 100"),),
    ),
    (OBSTACLE, "scanner.kind = 'obstacle_distance'", "can stop", ((KIND, PLANE),)),
    ('kind = "obstacle_distance"', "scanner.speaks_for_m", "band is 4 m high", ()),
    (OBSTACLE, "terrain", "does not see the ground", ((STATED, ""),)),
    (SECTORS, "scanner = ", "Remove one of them.", ((KIND, f"{KIND}\nscanner = false"),)),
    (f"{OBSTACLE}component = 195", "scanner.component = 195", "the companion itself", ()),
    (f"{OBSTACLE}bearing_error_deg = 46.0", "bearing_error_deg = 46.0", "less than", ()),
    (f"{OBSTACLE}latency_s = -0.1", "scanner.latency_s = -0.1", "greater than", ()),
    (f"{OBSTACLE}range_error_m = nan", "scanner.range_error_m = nan", "finite", ()),
    (
        *(OBSTACLE, "terrain.trust = 'guidance'", "a sensor of near things does"),
        ((STATED, '[terrain]\nfile = "x"\nvertical_datum = "EGM96"\ntrust = "guidance"'),),
    ),
]


@pytest.mark.parametrize(("scanner", "field", "words", "changes"), REFUSED)
def test_what_breaks_a_rule_is_refused_in_one_line(
    tmp_path: Path, scanner: str, field: str, words: str, changes: tuple[tuple[str, str], ...]
) -> None:
    message = refusal(lambda folder, _: load(folder, scanner, *changes), tmp_path, None)
    assert field in message
    assert words in message
