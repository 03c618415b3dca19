"""Somebody else's logs as they are: cut, with gaps, silences and reboots, and little in them.

Times are seconds after the first record.
"""

import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from cut_logs import STATION, alone, changed, mission, packed, recorded, thinned, whole, without
from cut_logs import written as written_to
from log_files import bin_of, fmt_entries
from recordings import recording

from companion.errors import InputError
from companion.mavlink.dialect import Message, wire
from companion.mavlink.frames import number_of
from companion.mission.mission import Mission
from companion.replay.shadow import watch
from companion.replay.shadow_report import Observed, ShadowReport, renderables
from companion.telemetry.logs import Record

ARDUPILOT, PX4 = "arducopter-gps-loss.tlog", "px4-gps-loss.tlog"
HEALTHY, COPTER = "px4-offboard-8mps.tlog", "arducopter-guided-10mps.tlog"
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


@pytest.mark.parametrize(
    ("from_s", "until_s"), [(0.0, 0.5), (0.0, 90.0), (0.0, 130.0), (60.0, 120.0)]
)
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


def test_of_a_vehicle_that_falls_silent_nothing_is_told_beyond_its_last_word(
    written: Write,
) -> None:
    """In the midst of its failsafe, in the air; the ground station records for 5 minutes more."""
    flown = list(recorded(PX4, until_s=90.0))
    own = packed(heartbeat(wire.MAV_AUTOPILOT_INVALID, wire.MAV_TYPE_GCS), STATION)
    station = [Record(flown[-1].time_us + k * 1_000_000, own) for k in range(1, 301)]
    until_then = alone(written(flown))
    report = alone(written([*flown, *station]))
    last_s = (flown[-1].time_us - flown[0].time_us) * 1e-6
    assert report.length_s == pytest.approx(last_s + 300.0)
    [failsafe] = of(report, "the autopilot's own failsafe")
    assert of(until_then, "the autopilot's own failsafe")[0].until_s is None
    assert failsafe.until_s == pytest.approx(last_s, abs=0.1)
    [silence] = of(report, "silence")
    assert silence.from_s == pytest.approx(last_s, abs=0.1)
    assert silence.until_s is None
    assert report.in_air_s == pytest.approx(until_then.in_air_s, abs=0.1)
    assert all(each.at_s <= last_s for each in report.said)


@pytest.mark.parametrize("blind_s", [0.0, 3.0])
def test_a_reboot_in_the_air_is_a_hold(written: Write, blind_s: float) -> None:
    """Whether or not the first word after it is a position."""
    first = list(recorded(HEALTHY, until_s=40.0))
    began_us, gap_us = first[0].time_us, first[-1].time_us - first[0].time_us + 1_000_000
    seen_us = began_us + blind_s * 1e6
    again = [each for each in first if number_of(each.frame) != POSITION or each.time_us > seen_us]
    report = alone(written([*first, *later(again, gap_us)]))
    assert of(report, "the autopilot has rebooted")
    [hold] = report.holds
    assert hold.let_go_s == pytest.approx(41.0, abs=1.5)
    assert hold.went_on_s is not None
    assert hold.went_on_s < 50.0


@pytest.mark.parametrize("silent_s", [1, 15, 700])
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


def again(content: bytes, by_us: int) -> bytes:
    """The entries of a .bin once more, later by the vehicle's clock."""
    described = fmt_entries()
    sizes = {described[at + 3]: described[at + 4] for at in range(0, len(described), 89)}
    out, at = bytearray(content), 0
    while at < len(out):
        (time_us,) = struct.unpack_from("<Q", out, at + 3)
        struct.pack_into("<Q", out, at + 3, time_us + by_us)
        at += sizes[out[at + 2]]
    return bytes(out)


def test_a_bin_that_records_only_while_armed_is_not_silent_in_between(tmp_path: Path) -> None:
    """Two flights in one file, five minutes apart."""
    flight, path = bin_of(recording(COPTER), most=5000), tmp_path / "armed.bin"
    path.write_bytes(flight)
    one = alone(path)
    gap_us = round((one.length_s + 300.0) * 1e6)
    path.write_bytes(flight + again(flight[len(fmt_entries()) :], gap_us))
    report = alone(path)
    assert of(report, "silence") == gave_up(report) == []
    ends = [(each.from_s, each.until_s or 0.0) for each in of(report, "not recorded")]
    gaps = [end for end in ends if end[1] - end[0] > 60.0]  # the log that was made has one of 3 s
    assert gaps == [pytest.approx((one.length_s, gap_us * 1e-6), abs=1.0)]
    assert "LINK_LOST" not in codes(report)
    assert len(report.holds) == 2 * len(one.holds)
    assert report.in_air_s == pytest.approx(2 * one.in_air_s, abs=2.0)


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
    "one that lacks positions, too": (
        list(changed(few(ARDUPILOT, POSITION), HEARTBEAT, submarine)),
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


@pytest.mark.sample(3)
@pytest.mark.parametrize(("every", "rate_hz"), [(10, 1.0), (5, 2.0), (20, 0.5)])
def test_a_log_with_few_positions_is_not_taken_for_a_fault(
    written: Write, every: int, rate_hz: float
) -> None:
    """As ground stations ask for them; and it is said."""
    report = alone(written(thinned(recorded(HEALTHY, until_s=120.0), POSITION, every)))
    assert report.holds == []
    assert report.position_rate_hz == pytest.approx(rate_hz, rel=0.05)
    [said] = report.could_not
    assert f"GLOBAL_POSITION_INT comes at {rate_hz:.1f} Hz" in said


@pytest.mark.parametrize(
    ("every", "between_s"),
    [(1, (40.4, 40.7)), (10, (40.0, 44.5))],  # half a second, as in flight, and one message more
)
def test_a_position_that_ends_is_missed_by_the_clock_that_goes_on(
    written: Write, every: int, between_s: tuple[float, float]
) -> None:
    told = thinned(recorded(HEALTHY, from_s=60.0, until_s=100.0), POSITION, every)
    ends = without(recorded(HEALTHY, from_s=100.0, until_s=120.0), POSITION)
    [hold] = alone(written([*told, *ends])).holds
    assert hold.why[0].code == "POSITION_STALE"
    assert between_s[0] < hold.let_go_s < between_s[1]
    assert hold.trusted_s is None


def test_positions_that_stand_still_are_told(written: Write) -> None:
    first = next(each for each in recorded(HEALTHY) if each.frame[7] == POSITION)
    held_ms = wire.MAVLink(None).decode(bytearray(first.frame)).time_boot_ms + 80_000

    def freeze(message: Message) -> None:
        if message.time_boot_ms > held_ms:
            message.lat, message.lon = 473_977_000, 85_456_000

    report = alone(written(changed(recorded(HEALTHY, until_s=95.0), POSITION, freeze)))
    assert of(report, "position stands still")
    [hold] = report.holds
    assert {"POSITION_FROZEN"} < codes(report)  # it jumps there first
    assert hold.let_go_s == pytest.approx(80.0, abs=1.5)


# --- missions


@pytest.mark.sample(2)
@pytest.mark.parametrize("every", [6, 12])
def test_a_mission_adds_no_holds_to_those_of_the_vehicle(written: Write, every: int) -> None:
    """Positions 0.6 s and 1.2 s apart are no loss of them, whenever a plan comes."""
    path = written(thinned(recorded(HEALTHY, from_s=20.0, until_s=70.0), POSITION, every))
    report = watch(path, mission("copter-zurich", evaluations=100))
    assert len([each for each in report.plans if each.outcome == "ready"]) > 5
    assert holds(report) == holds(alone(path))
    assert len(report.holds) <= 1


def test_a_mission_somewhere_else_is_refused_in_one_line() -> None:
    with pytest.raises(InputError) as caught:
        watch(recording(PX4), mission("copter-canberra"))
    text = str(caught.value)
    assert "\n" not in text
    for words in ("47.397", "km north", "outside its [area]", "leave --mission out"):
        assert words in text


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


def test_targets_that_only_the_vehicle_knows_are_missed(written: Write) -> None:
    chosen = replace(mission("copter-zurich"), targets_ne_m=(), targets_from_vehicle=True)
    report = watch(written(recorded(PX4, until_s=30.0)), chosen)
    assert "MISSION_ITEM_INT is not heard" in " ".join(report.could_not)
    assert report.plans == []


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


def test_of_several_vehicles_the_missions_is_watched(written: Write) -> None:
    flown = list(recorded(PX4, until_s=10.0))
    others = (Record(each.time_us, packed(heartbeat(), (2, 1))) for each in flown[::100])
    path = written(sorted([*flown, *others], key=lambda each: each.time_us))
    chosen = replace(mission("copter-zurich"), system_id=1, targets_ne_m=())
    for report in (watch(path, chosen), alone(path, system_id=1)):
        assert report.system_id == 1
        assert report.watched_from_s is not None
