"""Somebody else's logs as they are: cut, with gaps, silences and reboots, and little in them.

Times are seconds after the first record.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from cut_logs import alone, changed, mission, packed, recorded, thinned, whole, without
from cut_logs import written as written_to
from recordings import recording

from companion.errors import InputError
from companion.mavlink.dialect import Message, wire
from companion.mission.mission import Mission
from companion.replay.shadow import watch
from companion.replay.shadow_report import Observed, ShadowReport, renderables
from companion.telemetry.logs import Record

ARDUPILOT, PX4 = "arducopter-gps-loss.tlog", "px4-gps-loss.tlog"
HEALTHY, PLANE = "px4-offboard-8mps.tlog", "px4-fixedwing-offboard.tlog"
HEARTBEAT = wire.MAVLINK_MSG_ID_HEARTBEAT
POSITION = wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
GPS = wire.MAVLINK_MSG_ID_GPS_RAW_INT
EKF = wire.MAVLINK_MSG_ID_EKF_STATUS_REPORT
Records = Iterable[Record]
Write = Callable[[Records], Path]


@pytest.fixture
def written(tmp_path: Path) -> Write:
    """Writes a .tlog of these records."""
    return lambda records: written_to(tmp_path / "log.tlog", records)


def holds(report: ShadowReport) -> list[tuple[float, float, str]]:
    """When it let go, by the log and by the vehicle, and why."""
    return [(hold.let_go_s, hold.vehicle_s, hold.why[0].code) for hold in report.holds]


def codes(report: ShadowReport) -> set[str]:
    """All reasons to hold."""
    return {why.code for hold in report.holds for why in hold.why}


def of(report: ShadowReport, kind: str) -> list[Observed]:
    return [each for each in report.health if each.kind == kind]


def gave_up(report: ShadowReport) -> list[str]:
    return [note for note in report.notes if "gave up watching" in note]


def later(records: Records, by_us: int) -> Iterator[Record]:
    """By the log's clock, not by the vehicle's."""
    for record in records:
        yield Record(record.time_us + by_us, record.frame)


def heartbeat(autopilot: int = 12, kind: int = wire.MAV_TYPE_QUADROTOR) -> Message:
    return wire.MAVLink_heartbeat_message(kind, autopilot, 81, 0, 4, 3)


# --- cut, gaps, clocks


@pytest.mark.parametrize(("from_s", "until_s"), [(0.0, 0.5), (0.0, 90.0), (60.0, 120.0)])
def test_of_a_part_of_a_log_the_same_is_told(written: Write, from_s: float, until_s: float) -> None:
    uncut = whole(PX4)
    cut = alone(written(recorded(PX4, from_s=from_s, until_s=until_s)))
    began = [hold for hold in uncut.holds if from_s <= hold.let_go_s <= until_s]
    assert len(cut.holds) == len(began)
    for hold, same in zip(cut.holds, began, strict=True):
        assert (hold.vehicle_s, hold.why[0].code) == (same.vehicle_s, same.why[0].code)
        assert hold.let_go_s == pytest.approx(same.let_go_s - from_s, abs=0.01)
        assert same.went_on_s is not None
        went_on_s = same.went_on_s - from_s
        assert hold.went_on_s == (
            pytest.approx(went_on_s, abs=0.01) if went_on_s <= until_s - from_s else None
        )
    assert cut.length_s == pytest.approx(until_s - from_s, abs=0.1)
    if from_s:
        assert cut.in_air_s == pytest.approx(until_s - from_s, abs=1.0)
    else:
        seen = [each.from_s for each in uncut.health if each.from_s <= until_s]
        assert [each.from_s for each in cut.health] == seen


@pytest.mark.parametrize(("until_s", "is_silent"), [(96.0, True), (92.0, False)])
def test_a_gap_is_a_silence_of_the_link_if_it_lasts(
    written: Write, until_s: float, is_silent: bool
) -> None:
    """Of 6 s; of up to 2 s it is a pause."""
    before = recorded(HEALTHY, from_s=60.0, until_s=90.0)
    after = recorded(HEALTHY, from_s=until_s, until_s=until_s + 14.0)
    report = alone(written([*before, *after]))
    assert ("LINK_LOST" in codes(report)) == is_silent == bool(of(report, "silence"))
    if not is_silent:
        return
    [hold], [silence] = report.holds, of(report, "silence")
    assert hold.why[0].code == "LINK_LOST"
    assert hold.let_go_s == pytest.approx(33.0, abs=0.1)  # silent for 3 s
    assert hold.trusted_s is not None
    assert 36.0 < hold.trusted_s < 37.2  # once GPS and estimator, silent for 6 s, are heard
    assert (silence.from_s, silence.until_s) == pytest.approx((30.0, 36.0), abs=0.1)
    assert silence.in_air


@pytest.mark.parametrize("by_s", [700.0, 100_000.0])
def test_after_a_silence_that_nobody_waits_for_it_begins_again(written: Write, by_s: float) -> None:
    after = later(recorded(PX4, from_s=50.0, until_s=80.0), round(by_s * 1e6))
    report = alone(written([*recorded(PX4, until_s=50.0), *after]))
    lost, fix = report.holds
    assert lost.why[0].code == "LINK_LOST"
    assert lost.let_go_s == pytest.approx(53.0, abs=0.1)
    assert lost.went_on_s is not None
    assert 50.0 + by_s < lost.went_on_s < 55.0 + by_s
    assert fix.why[0].code == "NO_FIX"
    assert fix.let_go_s == pytest.approx(76.36 + by_s, abs=0.02)
    assert len(gave_up(report)) == 1


@pytest.mark.parametrize("silent_s", [1, 700])
def test_a_reboot_is_told_however_long_it_takes(written: Write, silent_s: int) -> None:
    """Before it the GPS has no fix; and while it boots it does not say what it is."""
    beats = iter(range(3))

    def unborn(message: Message) -> None:
        if next(beats, None) is not None:
            message.type = wire.MAV_TYPE_GENERIC

    def blind(message: Message) -> None:
        message.fix_type = 1

    booting = changed(recorded(HEALTHY, until_s=20.0), HEARTBEAT, unborn)
    first = list(changed(booting, GPS, blind))
    gap_us = first[-1].time_us - first[0].time_us + silent_s * 1_000_000
    report = alone(written([*first, *later(recorded(HEALTHY, until_s=25.0), gap_us)]))
    [reboot] = of(report, "the autopilot has rebooted")
    assert reboot.from_s == pytest.approx(20.0 + silent_s, abs=1.0)
    no_fix = of(report, "no GPS fix yet")[0]
    assert no_fix.from_s < 5.0
    assert no_fix.until_s == pytest.approx(20.0, abs=1.5)
    assert report.watched_from_s is not None
    assert report.watched_from_s > 20.0 + silent_s
    assert report.holds == gave_up(report) == []
    said = "\n".join(str(each) for each in renderables(report))
    assert "this mission is for" not in said


# --- what is not in it


def submarine(message: Message) -> None:
    message.type = wire.MAV_TYPE_SUBMARINE


def few(log: str, *numbers: int, until_s: float = 10.0) -> Iterator[Record]:
    return without(recorded(log, until_s=until_s), *numbers)


FIFTY = [Record(10**15 + 10**6 * k, packed(heartbeat(), (1, 50))) for k in range(30)]
REFUSED: dict[str, tuple[Records, str]] = {
    "a submarine": (
        list(changed(few(ARDUPILOT), HEARTBEAT, submarine)),
        r"which the companion does not fly. It flies: ",
    ),
    "no position": (list(few(ARDUPILOT, POSITION, until_s=80.0)), "no GLOBAL_POSITION_INT.*ecord"),
    "no heartbeat": (list(few(ARDUPILOT, HEARTBEAT, until_s=80.0)), "it has no HEARTBEAT.*ecord"),
    # as PX4 with MAV_COMP_ID 50
    "another component": (FIFTY, r"component 50 of system 1.*MAV_COMP_ID"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_cannot_be_watched_is_refused_in_one_line(written: Write, what: str) -> None:
    """What a log is of is told before what it lacks, and how to have that recorded."""
    records, words = REFUSED[what]
    for system_id in (None,) if what == "no heartbeat" else (None, 1):
        with pytest.raises(InputError, match=words) as caught:
            alone(written(records), system_id=system_id)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("number", "expected"),
    [
        # What the estimator would have told at 114.7 s is only seen when the position jumps.
        # By then it is where the vehicle cannot be: it holds until it has jumped back.
        (EKF, [("POSITION_JUMPED", 123.3), ("NO_FIX", 163.51)]),
        (GPS, [("ESTIMATOR", 114.67), ("ESTIMATOR", 171.7)]),  # the fix was lost at 163.5
    ],
)
def test_without_a_word_of_gps_or_estimator_the_rest_is_still_told(
    written: Write, number: int, expected: list[tuple[str, float]]
) -> None:
    report = alone(written(few(ARDUPILOT, number, until_s=195.0)))
    name = wire.mavlink_map[number].msgname
    [said] = report.could_not
    assert f"{name} missing: taken to be good" in said
    assert said.endswith("docs/logs.md")
    assert list(report.missing) == [name]
    assert [(code, at_s) for at_s, _, code in holds(report)] == [
        (code, pytest.approx(at_s, abs=0.5)) for code, at_s in expected
    ]


def test_a_log_with_few_positions_is_not_taken_for_a_fault_until_they_end(written: Write) -> None:
    """One a second, as ground stations ask for them; and it is said."""
    told = thinned(recorded(HEALTHY, from_s=60.0, until_s=100.0), POSITION, 10)
    ends = without(recorded(HEALTHY, from_s=100.0, until_s=120.0), POSITION)
    report = alone(written([*told, *ends]))
    assert any("GLOBAL_POSITION_INT comes at 1.0 Hz" in each for each in report.could_not)
    [hold] = report.holds
    assert hold.why[0].code == "POSITION_STALE"
    assert 40.0 < hold.let_go_s < 44.5
    assert hold.trusted_s is None


# --- missions


def test_what_is_known_of_the_ground_stands_in_for_a_radar_if_any_is(written: Write) -> None:
    """With nothing known it says so, and tells the rest."""
    path = written(recorded(PX4, from_s=40.0, until_s=60.0))
    known = replace(mission("copter-zurich", evaluations=100), scanner_component_id=100)
    report, blind = watch(path, known), watch(path, replace(known, known=None))
    assert "ready" in {asked.outcome for asked in report.plans}
    assert any("terrain of the mission alone" in note for note in report.notes)
    [said] = blind.could_not
    assert "nothing is known of the ground" in said
    assert "[terrain]" in said
    assert "ready" not in {asked.outcome for asked in blind.plans}
    refused = {asked.reason for asked in blind.plans if asked.outcome == "refused"}
    assert refused <= {"NOTHING_SEEN", "START_NEAR_UNKNOWN"}
    assert holds(blind) == holds(alone(path))


def test_a_planner_that_breaks_ends_the_watch_and_not_the_program(
    written: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("by nothing")

    monkeypatch.setattr("companion.replay.shadow.plan", broken)
    path = written(recorded(PX4, from_s=60.0, until_s=90.0))
    report = watch(path, mission("copter-zurich"))
    assert "PLANNER_DIED" in codes(report)
    assert gave_up(report)


@pytest.mark.parametrize(
    ("name", "chosen", "words"),
    [
        (PX4, mission("plane-zurich"), r"it is for .*; the log is of PX4"),
        (PLANE, mission("copter-zurich"), r"it is for .*; the log is of PX4"),
        (PX4, replace(mission("copter-zurich"), autopilot="ardupilot"), r"the log is of PX4"),
        (PX4, mission("copter-canberra"), r"km north.*outside its \[area\].*leave --mission out"),
    ],
)
def test_a_mission_for_another_vehicle_or_place_is_refused_in_one_line(
    name: str, chosen: Mission, words: str
) -> None:
    with pytest.raises(InputError, match=words) as refused:
        watch(recording(name), chosen)
    assert "\n" not in str(refused.value)
