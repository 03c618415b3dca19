"""The flown track out of frames, and what follows from vehicle times that begin again."""

import csv
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as wire

from companion.config import load_mission
from companion.mission import events
from companion.mission import journal as noted
from companion.mission.journal import Header
from companion.path.subpath import Subpath
from companion.telemetry.export import formats, shapes
from companion.telemetry.export.formats import features_of, write_csv, write_kml
from companion.telemetry.flight import Flight

EPOCH_US = 1_790_000_000_000_000
MISSION = load_mission("environment-1")


def position(
    time_s: float, *, ids: tuple[int, int] = (1, 1), v1: bool = False, **more: int
) -> bytes:
    codec = wire.MAVLink(None, srcSystem=ids[0], srcComponent=ids[1])
    values = {"lat": 470_000_000, "lon": 80_000_000, "alt": 500_000, "relative_alt": 10_000}
    values |= {"vx": 100, "vy": -200, "vz": 300, "hdg": 9000, **more}
    message = wire.MAVLink_global_position_int_message(round(time_s * 1e3), **values)
    return bytes(message.pack(codec, force_mavlink1=v1))


def flight(*frames: bytes, entries: Any = (), system_id: int | None = 1) -> Flight:
    """These frames a tenth of a second apart, and then entries of the journal."""
    found = Flight(MISSION, system_id)
    for k, frame in enumerate(frames):
        found.look(EPOCH_US + 100_000 * k, frame)
    for entry in entries:
        found.take(entry)
    found.settle()
    return found


def at(*times_s: float, entries: Any = ()) -> Flight:
    """Positions at these vehicle times."""
    return flight(*map(position, times_s), entries=entries)


def phase(time_s: float, name: str, reason: str | None = None) -> Any:
    return noted.Phase(time_s=time_s, phase=name, was="", reason=reason, code=None)


def header(**more: Any) -> Header:
    facts = {"version": 1, "mission": "m", "seed": 1, "profile": "flight", "lockstep": True}
    return Header(**{"schema": "companion-journal", **facts, **more})


FIRST = {"t_s": 12.3, "time_us": EPOCH_US, "above_home_m": 10.0, "heading_deg": 90.0}
FIRST |= {"latitude_deg": 47.0, "longitude_deg": 8.0, "altitude_amsl_m": 500.0}
FIRST |= {"north_m_s": 1.0, "east_m_s": -2.0, "up_m_s": -3.0}
ZERO = {"north_m_s": "vx", "east_m_s": "vy", "up_m_s": "vz", "heading_deg": "hdg"}
ZERO |= {"above_home_m": "relative_alt"}  # zeros that MAVLink 2 leaves out


@pytest.mark.parametrize(
    ("told", "expected"),
    [
        ({"v1": True}, {}),
        (dict.fromkeys(ZERO.values(), 0), dict.fromkeys(ZERO, 0.0)),
        ({"hdg": 65535}, {"heading_deg": math.nan}),
    ],
)
def test_units_signs_datums_and_what_is_not_told(
    told: Any, expected: dict[str, float], tmp_path: Path
) -> None:
    """A table of it has no heading that is not known."""
    found = flight(position(12.3, **told), entries=[phase(0.0, "flying")])
    values = {name: getattr(found.track, name)[0] for name in FIRST}
    assert values == pytest.approx(FIRST | expected, nan_ok=True)
    write_csv(found, tmp_path / "a.csv")
    [row] = csv.DictReader((tmp_path / "a.csv").read_text(encoding="utf-8").splitlines())
    assert float(row["heading_deg"] or "nan") == pytest.approx(values["heading_deg"], nan_ok=True)


def test_only_the_autopilot_of_the_vehicle_counts_and_only_with_a_fix() -> None:
    others = [position(1.0, ids=ids) for ids in ((2, 1), (1, 195), (255, 190))]
    assert len(flight(*others, position(2.0)).track) == 1
    assert len(flight(*others, position(2.0), system_id=None).track) == 2
    found = flight(position(1.0, lat=0, lon=0), position(2.0, lat=2_000_000_000), position(3.0))
    assert (found.track.t_s.tolist(), found.left_out) == ([3.0], 2)
    none = flight(entries=[phase(1.0, "holding", "x")])
    assert (len(none.track), none.segments(), none.places_nea_m.shape) == (0, [], (0, 3))
    assert {each.kind for each in features_of(none)} <= {"target", "radar"}


def test_a_clock_that_begins_again_is_a_reboot_and_a_single_fall_is_a_mistake() -> None:
    found = at(100.0, 100.1, 3.0, 100.2, 100.3, 0.5, 0.6, 100.9, 0.7)
    kept = [100.0, 100.1, 100.2, 100.3, 0.5, 0.6, 100.9, 0.7]
    np.testing.assert_allclose(found.track.t_s, kept)
    assert found.track.boot.tolist()[:6] == [0, 0, 0, 0, 1, 1]
    assert found.left_out == 1
    assert at(5.0, 4.5, 5.1).track.boot.tolist() == [0, 0, 0]  # in no order: no reboot


REBOOTED = [
    *(phase(100.0, "flying"), events.Rebooted(time_s=0.4)),
    *(phase(0.4, "preparing"), phase(0.6, "holding", "x")),
]
RESTARTED = [header(), phase(1000.0, "flying"), header(resumed=1), phase(5.0, "preparing")]
IN_ONE = [phase(0.5, "preparing"), phase(3.0, "flying")]
WAITED = [phase(9.0, "preparing"), phase(3.0, "arming")]


@pytest.mark.parametrize(
    ("times_s", "entries", "expected"),
    [
        # each phase begins at the position of its time
        ((1.0, 2.0, 3.0, 4.0), IN_ONE, "preparing preparing flying flying"),
        # after a reboot times count from the new boot
        ((99.0, 100.0, 101.0, 0.5, 0.6), REBOOTED, "waiting flying flying preparing holding"),
        # one while no companion ran is seen by the clock
        ((1000.0, 1001.0, 5.0), RESTARTED, "flying flying preparing"),
        # what it did before it knew the clock counts from the first position: it waited nine
        # seconds for a vehicle that had been on for two
        ((2.0, 3.0), WAITED, "waiting arming"),
    ],
    ids=["in one boot", "rebooted", "restarted", "waited"],
)
def test_phases_are_those_of_their_times(times_s: Any, entries: list[Any], expected: str) -> None:
    found = at(*times_s, entries=entries)
    assert [each.phase for each in found.decided_at(found.times_s)] == expected.split()


def test_moments_and_segments_are_those_of_their_boots() -> None:
    found = at(99.0, 100.0, 101.0, 0.5, 0.6, entries=REBOOTED)
    rows = [(m.what, found.row_at(m.time_s)) for m in found.moments]
    assert rows == [("reboot", 2), ("hold", 4)]
    assert [found.row_at(found.time_of(boot, 0.6)) for boot in (1, 0)] == [4, 0]
    expected = [("waiting", 0, 1), ("flying", 1, 3), ("preparing", 3, 4), ("holding", 4, 5)]
    assert [(name, part.start, part.stop) for name, part in found.segments()] == expected


def test_the_newest_targets_count_and_the_fence_is_there_once() -> None:
    circle = {"name": "a", "north_m": 1.0, "east_m": 2.0, "radius_m": 3.0, "keep_in": True}
    fence = {"kind": "fence", "t_s": 1.0, "floor_amsl_m": None, "ceiling_amsl_m": None}
    order = {"t_s": 3.0, "kind": "order", "sender": "255/190", "speed_m_s": None}
    fences = [noted.entry_of({**fence, "zones": [circle] * count}) for count in (2, 1)]
    targets = events.TargetsChanged(time_s=1.0, targets_ne_m=((5.0, 6.0), (7.0, 8.0)))
    found = at(1.0, entries=[*fences, targets])
    assert found.decided.targets_ne_m == ((5.0, 6.0), (7.0, 8.0))
    assert len(found.zones_of(found.decided)) == 1
    there = noted.entry_of({**order, "order": "REPOSITION", "target_ne_m": [9.0, 10.0]})
    pause = noted.entry_of({**order, "order": "PAUSE", "target_ne_m": None})
    assert at(1.0, entries=[there, pause]).decided.targets_ne_m == ((9.0, 10.0),)


def test_a_long_track_is_thinned_evenly_and_keeps_its_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(formats, "MAX_POINTS", 500)
    frames = [position(0.1 * k, lat=470_000_000 + 10 * k) for k in range(1493)]
    found = flight(*frames, entries=[phase(0.0, "flying")])
    [track] = [each for each in features_of(found) if each.kind == "track"]
    steps = np.diff(track.points[:, 1] * 1e6).round()
    assert len(steps) <= formats.MAX_POINTS
    assert set(steps) == {2.0, 3.0}
    assert track.points[[0, -1], 1] == pytest.approx(found.track.latitude_deg[[0, -1]])
    write_kml(found, tmp_path / "long.kml")
    assert (tmp_path / "long.kml").read_text("utf-8").count("<when>") == len(track.points)


def test_a_place_beside_a_subpath_is_told_how_far_it_is_and_where_it_is_nearest() -> None:
    """Against points of the curve a centimetre apart."""
    corners = [(0.0, 0.0, 100.0), (20.0, 5.0, 101.0), (40.0, 5.0, 103.0), (60.0, 30.0, 103.0)]
    subpath = Subpath(control_nea_m=np.array([*corners, (70.0, 60.0, 104.0)]))
    lengths_m = np.arange(0.0, subpath.length_m, 0.01)
    curve = subpath.points_nea_m(lengths_m)
    for place in np.random.default_rng(1).uniform((0, 0, 95), (75, 65, 110), (50, 3)):
        away_m = np.linalg.norm(curve - place, axis=1)
        off_m, at_m = shapes.SubpathPoints(subpath).nearest(place)
        assert off_m == pytest.approx(away_m.min(), abs=0.03)
        assert at_m == pytest.approx(lengths_m[away_m.argmin()], abs=0.5)


def test_legs_of_the_way_back_are_not_those_of_a_plan() -> None:
    golden = Path(__file__).parents[2] / "replay/goldens/copter-goes-back/decisions.jsonl"
    told = [json.loads(line) for line in golden.read_text(encoding="utf-8").splitlines()]
    entries = [noted.entry_of(each) for each in told if each.get("kind") in ("plan ready", "leg")]
    assert [each.number for each in entries if isinstance(each, noted.LegBegun)] == [1, 2, 3, 4]
    planned = at(50.0, 130.0, entries=[header(), *entries]).planned
    assert [(each.plan.plan_id, each.leg) for each in planned] == [(1, 1), (2, 2)]
