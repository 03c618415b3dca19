"""Somebody else's logs as they are: cut, with gaps, time running backwards, and little in them.

Times are seconds after the first record.
"""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from cut_logs import (
    alone,
    changed,
    mission,
    recorded,
    thinned,
    whole,
    without,
    written,
)
from recordings import recording

from companion.errors import InputError
from companion.mavlink.dialect import Message, wire
from companion.mavlink.frames import number_of
from companion.mission.mission import Mission
from companion.replay.shadow import watch
from companion.replay.shadow_report import Hold
from companion.telemetry.logs import Record

ARDUPILOT, PX4 = "arducopter-gps-loss.tlog", "px4-gps-loss.tlog"
HEALTHY = "px4-offboard-8mps.tlog"
POSITION = wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
GPS = wire.MAVLINK_MSG_ID_GPS_RAW_INT
EKF = wire.MAVLINK_MSG_ID_EKF_STATUS_REPORT


def times(holds: list[Hold]) -> list[tuple[float, float, str]]:
    """When it let go, by the log and by the vehicle, and why."""
    return [(hold.let_go_s, hold.vehicle_s, hold.why[0].code) for hold in holds]


def shifted(records: Iterator[Record], from_s: float, by_s: float) -> Iterator[Record]:
    """The log's clock, not the vehicle's, leaps at a time."""
    first_us = None
    for record in records:
        first_us = record.time_us if first_us is None else first_us
        late = record.time_us - first_us >= from_s * 1e6
        yield Record(record.time_us + round(by_s * 1e6) * late, record.frame)


def test_how_long_positions_came_too_seldom_is_told_with_the_bar_and_not_with_the_slowest(
    tmp_path: Path,
) -> None:
    """At 4 Hz for most of it, and at 1 Hz for some seconds: not 1 Hz for all of it."""
    records, kept, last_s = list(recorded(HEALTHY, until_s=60.0)), [], -1.0
    for record in records:
        at_s = (record.time_us - records[0].time_us) * 1e-6
        if number_of(record.frame) == POSITION:
            if at_s - last_s < (0.95 if 20.0 < at_s < 40.0 else 0.2):
                continue
            last_s = at_s
        kept.append(record)
    report = alone(written(tmp_path / "slow.tlog", kept))
    [told] = [each for each in report.could_not if "in time" in each.what]
    found = re.search(
        r"less than ([\d.]+) Hz for (\d+) s in all .*slowest at ([\d.]+) Hz", str(told)
    )
    assert found is not None, told
    bar_hz, span_s, slowest_hz = map(float, found.groups())
    assert slowest_hz < 1.5 < 4.0 < bar_hz < 6.0
    assert 40.0 < span_s <= 60.0


@pytest.mark.parametrize("kind", ["SUBMARINE", "GROUND_ROVER", "SURFACE_BOAT"])
@pytest.mark.parametrize("located", [True, False])
def test_what_a_log_is_of_is_told_before_what_it_lacks(
    tmp_path: Path, kind: str, located: bool
) -> None:
    def other(message: Message) -> None:
        message.type = getattr(wire, f"MAV_TYPE_{kind}")

    beat = wire.MAVLINK_MSG_ID_HEARTBEAT
    records = changed(recorded(ARDUPILOT, until_s=10.0), beat, other)
    records = records if located else without(records, POSITION)
    with pytest.raises(InputError, match=r"which the companion does not fly. It flies: "):
        alone(written(tmp_path / "other.tlog", records))


# --- cut, gaps, clocks


@pytest.mark.parametrize("until_s", [0.5, 50.0, 90.0, 108.0, 130.0])
def test_of_a_log_that_ends_early_all_is_told_up_to_there(tmp_path: Path, until_s: float) -> None:
    uncut = whole(PX4)
    cut = alone(written(tmp_path / "cut.tlog", recorded(PX4, until_s=until_s)))
    began = [each for each in times(uncut.holds) if each[0] <= until_s]
    assert times(cut.holds) == began
    for hold, same in zip(cut.holds, uncut.holds, strict=False):
        assert same.went_on_s is not None
        assert hold.went_on_s == (same.went_on_s if same.went_on_s <= until_s else None)
    assert cut.length_s == pytest.approx(until_s, abs=0.1)
    assert [each.from_s for each in cut.health] == [
        each.from_s for each in uncut.health if each.from_s <= until_s
    ]


def test_a_part_from_the_middle_tells_the_same_of_its_faults(tmp_path: Path) -> None:
    part = alone(written(tmp_path / "part.tlog", recorded(PX4, from_s=60.0, until_s=120.0)))
    [hold], [uncut] = part.holds, whole(PX4).holds
    assert hold.vehicle_s == uncut.vehicle_s
    assert hold.let_go_s == pytest.approx(uncut.let_go_s - 60.0, abs=0.01)
    assert part.in_air_s == pytest.approx(60.0, abs=1.0)


def test_a_gap_is_a_silence_of_the_link(tmp_path: Path) -> None:
    def with_gap() -> Iterator[Record]:
        yield from recorded(HEALTHY, from_s=60.0, until_s=90.0)
        yield from recorded(HEALTHY, from_s=96.0, until_s=110.0)

    report = alone(written(tmp_path / "gap.tlog", with_gap()))
    [hold] = report.holds
    assert hold.why[0].code == "LINK_LOST"
    assert hold.let_go_s == pytest.approx(33.0, abs=0.1)  # silent for 3 s
    assert hold.trusted_s is not None
    assert 36.0 < hold.trusted_s < 37.2  # once GPS and estimator, silent for 6 s, are heard
    [silence] = [each for each in report.health if each.kind == "silence"]
    assert silence.from_s == pytest.approx(30.0, abs=0.1)
    assert silence.until_s == pytest.approx(36.0, abs=0.1)
    assert silence.in_air


def test_short_pauses_of_the_log_are_no_silence(tmp_path: Path) -> None:
    """Of up to 2 s in which nothing at all was logged."""

    def stutters() -> Iterator[Record]:
        yield from recorded(HEALTHY, from_s=70.0, until_s=90.0)
        yield from recorded(HEALTHY, from_s=92.0, until_s=105.0)

    report = alone(written(tmp_path / "stutters.tlog", stutters()))
    assert not [each for each in report.health if each.kind == "silence"]
    assert "LINK_LOST" not in {why.code for hold in report.holds for why in hold.why}


@pytest.mark.parametrize(("from_s", "by_s"), [(50.0, 700.0), (50.0, 100_000.0)])
def test_after_a_silence_that_nobody_waits_for_it_begins_again(
    tmp_path: Path, from_s: float, by_s: float
) -> None:
    records = shifted(recorded(PX4, until_s=80.0), from_s, by_s)
    report = alone(written(tmp_path / "long.tlog", records))
    lost, fix = report.holds
    assert lost.why[0].code == "LINK_LOST"
    assert lost.let_go_s == pytest.approx(from_s + 3.0, abs=0.1)
    assert lost.went_on_s is not None
    assert from_s + by_s < lost.went_on_s < from_s + by_s + 5.0
    assert fix.why[0].code == "NO_FIX"
    assert fix.let_go_s == pytest.approx(76.36 + by_s, abs=0.02)
    assert any("gave up watching at" in note for note in report.notes)


@pytest.mark.parametrize("blind_s", [0.0, 3.0])
def test_a_reboot_of_the_vehicle_is_told(tmp_path: Path, blind_s: float) -> None:
    """Whether or not the first word after it is a position."""

    def twice() -> Iterator[Record]:
        last_us = first_us = 0
        for record in recorded(HEALTHY, until_s=40.0):
            first_us, last_us = first_us or record.time_us, record.time_us
            yield record
        for record in recorded(HEALTHY, until_s=40.0):
            at_us = record.time_us - first_us
            if record.frame[7] != POSITION or at_us > blind_s * 1e6:
                yield Record(at_us + last_us + 1_000_000, record.frame)

    report = alone(written(tmp_path / "twice.tlog", twice()))
    assert "the autopilot has rebooted" in {each.kind for each in report.health}
    [hold] = report.holds
    assert hold.let_go_s == pytest.approx(41.0, abs=1.5)
    assert hold.went_on_s is not None
    assert hold.went_on_s < 50.0


# --- what is not in it


@pytest.mark.parametrize(
    ("number", "name"),
    [(POSITION, "GLOBAL_POSITION_INT"), (wire.MAVLINK_MSG_ID_HEARTBEAT, "HEARTBEAT")],
)
def test_a_log_without_the_least_names_the_message_and_how_to_record_it(
    tmp_path: Path, number: int, name: str
) -> None:
    records = without(recorded(ARDUPILOT, until_s=80.0), number)
    with pytest.raises(InputError, match=f"it has no {name}") as caught:
        alone(written(tmp_path / "little.tlog", records))
    assert "\n" not in str(caught.value)
    assert "ecord" in str(caught.value)


def test_without_a_word_of_the_estimator_the_rest_is_still_told(tmp_path: Path) -> None:
    report = alone(
        written(tmp_path / "no-ekf.tlog", without(recorded(ARDUPILOT, until_s=195.0), EKF))
    )
    [said] = report.could_not
    assert said.message == "EKF_STATUS_REPORT"
    assert "taken to be good" in said.because
    assert "docs/logs.md" in said.remedy
    assert [each.message for each in report.missing] == ["EKF_STATUS_REPORT"]
    codes = [hold.why[0].code for hold in report.holds]
    # What the estimator would have told at 114.7 s is only seen when the position jumps.
    # By then it is where the vehicle cannot be: it holds until it has jumped back.
    assert codes == ["POSITION_JUMPED", "NO_FIX"]
    assert report.holds[1].let_go_s == pytest.approx(163.51, abs=0.02)


def test_without_a_word_of_the_gps_the_rest_is_still_told(tmp_path: Path) -> None:
    report = alone(
        written(tmp_path / "no-gps.tlog", without(recorded(ARDUPILOT, until_s=195.0), GPS))
    )
    assert [each.message for each in report.could_not] == ["GPS_RAW_INT"]
    assert times(report.holds)[0][0] == pytest.approx(114.67, abs=0.02)
    second = report.holds[1]
    assert second.let_go_s > 170.5  # the fix was lost at 163.5
    assert second.why[0].code == "ESTIMATOR"


@pytest.mark.sample(3)
@pytest.mark.parametrize(("every", "rate_hz"), [(10, 1.0), (5, 2.0), (20, 0.5)])
def test_a_log_with_few_positions_is_not_taken_for_a_fault(
    tmp_path: Path, every: int, rate_hz: float
) -> None:
    """As ground stations ask for them; and it is said."""
    path = written(
        tmp_path / "few.tlog", thinned(recorded(HEALTHY, until_s=120.0), POSITION, every)
    )
    report = alone(path)
    assert report.holds == []
    assert report.position_rate_hz == pytest.approx(rate_hz, rel=0.05)
    [said] = report.could_not
    assert said.message == "GLOBAL_POSITION_INT"
    assert f"{rate_hz:.1f} Hz" in said.because


def test_a_position_that_ends_is_missed_even_where_there_are_few(tmp_path: Path) -> None:
    def ends() -> Iterator[Record]:
        yield from thinned(recorded(HEALTHY, from_s=60.0, until_s=100.0), POSITION, 10)
        yield from without(recorded(HEALTHY, from_s=100.0, until_s=120.0), POSITION)

    report = alone(written(tmp_path / "ends.tlog", ends()))
    [hold] = report.holds
    assert hold.why[0].code == "POSITION_STALE"
    assert 40.0 < hold.let_go_s < 44.5
    assert hold.trusted_s is None


def test_without_a_position_the_clock_goes_on_by_what_tells_it(tmp_path: Path) -> None:
    """10 Hz, and the position ends: half a second, as in flight, and one message more."""

    def ends() -> Iterator[Record]:
        yield from recorded(HEALTHY, from_s=60.0, until_s=100.0)
        yield from without(recorded(HEALTHY, from_s=100.0, until_s=120.0), POSITION)

    report = alone(written(tmp_path / "ends.tlog", ends()))
    [hold] = report.holds
    assert hold.why[0].code == "POSITION_STALE"
    assert 40.4 < hold.let_go_s < 40.7


def test_positions_that_stand_still_are_told(tmp_path: Path) -> None:
    def freeze(message: Message) -> None:
        if message.time_boot_ms > held_ms:
            message.lat, message.lon = 473_977_000, 85_456_000

    first = next(each for each in recorded(HEALTHY) if each.frame[7] == POSITION)
    held_ms = wire.MAVLink(None).decode(bytearray(first.frame)).time_boot_ms + 80_000
    records = changed(recorded(HEALTHY, until_s=95.0), POSITION, freeze)
    report = alone(written(tmp_path / "frozen.tlog", records))
    assert "position stands still" in {each.kind for each in report.health}
    [hold] = report.holds
    assert {"POSITION_FROZEN"} < {why.code for why in hold.why}  # it jumps there first
    assert hold.let_go_s == pytest.approx(80.0, abs=1.5)


# --- missions that do not fit, and that plan nothing


def test_a_mission_somewhere_else_is_refused_in_one_line() -> None:
    with pytest.raises(InputError, match="outside its \\[area\\]") as caught:
        watch(recording(PX4), mission("copter-canberra"))
    text = str(caught.value)
    assert "47.397" in text
    assert "km north" in text
    assert "leave --mission out" in text
    assert "\n" not in text


@pytest.mark.parametrize(
    ("name", "chosen"),
    [
        (PX4, mission("plane-zurich")),
        ("px4-fixedwing-offboard.tlog", mission("copter-zurich")),
        (PX4, replace(mission("copter-zurich"), autopilot="ardupilot")),
    ],
)
def test_a_mission_for_another_vehicle_is_refused(name: str, chosen: Mission) -> None:
    with pytest.raises(InputError, match=r"it is for .*; the log is of PX4"):
        watch(recording(name), chosen)


def test_with_nothing_known_of_the_ground_it_says_so_and_tells_the_rest(tmp_path: Path) -> None:
    path = written(tmp_path / "part.tlog", recorded(PX4, from_s=40.0, until_s=100.0))
    known = mission("copter-zurich")
    unknown = replace(known, known=None, scanner_component_id=100)
    report = watch(path, unknown)
    [said] = report.could_not
    assert said.message == "TERRAIN_DATA"
    assert "[terrain]" in said.remedy
    assert not [asked for asked in report.plans if asked.outcome == "ready"]
    refused = [asked for asked in report.plans if asked.outcome == "refused"]
    assert {asked.reason for asked in refused} <= {"NOTHING_SEEN", "START_NEAR_UNKNOWN"}
    assert times(report.holds) == times(alone(path).holds)


def test_what_is_known_of_the_ground_stands_in_for_a_radar(tmp_path: Path) -> None:
    path = written(tmp_path / "part.tlog", recorded(PX4, from_s=40.0, until_s=60.0))
    chosen = replace(mission("copter-zurich", evaluations=100), scanner_component_id=100)
    report = watch(path, chosen)
    assert "ready" in {asked.outcome for asked in report.plans}
    assert any("terrain of the mission alone" in note for note in report.notes)


def test_targets_that_only_the_vehicle_knows_are_missed(tmp_path: Path) -> None:
    path = written(tmp_path / "part.tlog", recorded(PX4, until_s=30.0))
    chosen = replace(mission("copter-zurich"), targets_ne_m=(), targets_from_vehicle=True)
    report = watch(path, chosen)
    assert "MISSION_ITEM_INT" in {each.message for each in report.could_not}
    assert report.plans == []


def test_a_planner_that_breaks_ends_the_watch_and_not_the_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("by nothing")

    monkeypatch.setattr("companion.replay.shadow.plan", broken)
    path = written(tmp_path / "part.tlog", recorded(PX4, from_s=60.0, until_s=90.0))
    report = watch(path, mission("copter-zurich"))
    assert "PLANNER_DIED" in {why.code for hold in report.holds for why in hold.why}
    assert any("gave up watching" in note for note in report.notes)


# --- several vehicles, size


def test_progress_only_rises_and_comes_to_the_end(tmp_path: Path) -> None:
    shown = list[tuple[int, int]]()
    path = written(tmp_path / "part.tlog", recorded(PX4, until_s=40.0))
    watch(path, None, on_progress=lambda read, size: shown.append((read, size)))
    size = path.stat().st_size
    assert shown == sorted(shown)
    assert shown[-1] == (size, size)
    assert len(shown) > 1
