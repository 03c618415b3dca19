"""Recorded flights in shadow, as they are and cut, changed and written anew.

Against what their READMEs say, and against the plain session.  Times are seconds after the first
record; those of the faults are the recordings' own.
"""

import functools
import io
import itertools
import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import held
import pytest
from missions import mission
from msgspec import structs, to_builtins
from recordings import recording
from rich.console import Console
from tlog import written

from companion.errors import InputError
from companion.mavlink.dialect import Message, wire
from companion.mavlink.frames import Receiver, number_of, sender_of
from companion.mavlink.link import Output
from companion.mission.mission import Mission
from companion.replay.shadow import watch
from companion.replay.shadow_report import ShadowReport, VehicleReport, renderables
from companion.telemetry.logs import Record, open_log

ARDUPILOT, PX4 = "arducopter-gps-loss.tlog", "px4-gps-loss.tlog"
HEALTHY, PLANE = "px4-offboard-8mps.tlog", "px4-fixedwing-offboard.tlog"
VEHICLE = (1, 1)
HEARTBEAT = wire.MAVLINK_MSG_ID_HEARTBEAT
POSITION = wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
GPS = wire.MAVLINK_MSG_ID_GPS_RAW_INT
EKF = wire.MAVLINK_MSG_ID_EKF_STATUS_REPORT
Records = Iterable[Record]


@functools.cache
def _records(name: str) -> list[Record]:
    return list(open_log(recording(name)).records())


def recorded(name: str, from_s: float = 0.0, until_s: float = 1e9) -> Iterator[Record]:
    """A recorded flight between two times."""
    begins_us = _records(name)[0].time_us
    for record in _records(name):
        if from_s <= (record.time_us - begins_us) * 1e-6 <= until_s:
            yield record


def edited(records: Records, number: int, edit: Callable[[Message], object]) -> Iterator[Record]:
    """Each of the vehicle's messages of one kind changed in place, or left out if False."""
    codec = wire.MAVLink(None, *VEHICLE)
    for record in records:
        if number_of(record.frame) != number or sender_of(record.frame) != VEHICLE:
            yield record
            continue
        message = codec.decode(bytearray(record.frame))
        if edit(message) is not False:
            yield Record(record.time_us, bytes(message.pack(codec)))


def without(records: Records, number: int) -> Records:
    return edited(records, number, lambda _: False)


def setting(records: Records, number: int, *, first: float = 1e9, **values: int) -> Records:
    """Of so many of the vehicle's messages of a kind these fields are others."""
    count = itertools.count()

    def edit(message: Message) -> None:
        if next(count) < first:
            for name, value in values.items():
                setattr(message, name, value)

    return edited(records, number, edit)


# --- what is noted without a mission


def paused(until_s: float) -> Records:
    return [*recorded(HEALTHY, 60.0, 90.0), *recorded(HEALTHY, until_s, until_s + 14.0)]


def rebooted() -> Records:
    """Before it the GPS has no fix; and while it boots it does not say what it is."""
    boots = setting(recorded(HEALTHY, 0.0, 20.0), HEARTBEAT, first=3, type=wire.MAV_TYPE_GENERIC)
    first = list(setting(boots, GPS, fix_type=1))
    later_us = first[-1].time_us - first[0].time_us + 1_000_000  # by the log's clock
    again = (Record(time_us + later_us, frame) for time_us, frame in recorded(HEALTHY, 0.0, 25.0))
    return [*first, *again]


def seldom_placed() -> Records:
    """One position a second, as ground stations ask for them, and then none."""
    count = itertools.count(1)
    seldom = edited(recorded(HEALTHY, 60.0, 100.0), POSITION, lambda _: next(count) % 10 == 0)
    return [*seldom, *without(recorded(HEALTHY, 100.0, 120.0), POSITION)]


NOTED: dict[str, tuple[Callable[[], Records], str]] = {
    "2 s are a pause": (lambda: paused(92.0), "POSITION_STALE 32.0-34.1; no position 32.0-32.1"),
    # once GPS and estimator are heard again, and then 2 s
    "6 s are a silence": (
        lambda: paused(96.0),
        "LINK_LOST 33.0-39.0; silence 30.0-36.0; no position 36.0; no word of GPS or estimator "
        "36.0-37.0",
    ),
    "a reboot": (rebooted, "no GPS fix yet 3.9-21.0; the autopilot has rebooted 21.0"),
    # What the estimator would have told at 114.7 s is only seen when the position jumps.
    # By then it is where the vehicle cannot be: it holds until it has jumped back.
    "no word of the estimator": (
        lambda: without(recorded(ARDUPILOT, 0.0, 195.0), EKF),
        "POSITION_JUMPED 123.1-140.5; NO_FIX 163.5-190.9; no GPS fix yet 3.2-10.1; position "
        "jumped 123.1 50 m, 138.1 51 m, 188.5 19 m; position where the vehicle cannot be "
        "123.6-138.1; GPS fix lost 163.5-188.5; the autopilot's own failsafe 171.2-190.1; tell "
        "whether the position is to be believed: EKF_STATUS_REPORT missing: taken to be good "
        "from 13 s on",
    ),
    "few positions": (
        seldom_placed,
        "POSITION_STALE 42.4-; no position 42.4-; tell in time that a position is missing: "
        "GLOBAL_POSITION_INT comes at 1.0 Hz",
    ),
}


def span(from_s: float, until_s: float | None, worst_m: float | None = None) -> str:
    ends = [f"{from_s:.1f}", "" if until_s is None else f"{until_s:.1f}"]
    return "-".join(dict.fromkeys(ends)) + ("" if worst_m is None else f" {worst_m:.0f} m")


def in_a_line(report: ShadowReport) -> str:
    """When and why it lets go, what was odd about the vehicle, what could not be told."""
    found: dict[str, list[str]] = {}
    for hold in report.holds:
        found.setdefault(hold.why[0].code, []).append(span(hold.let_go_s, hold.went_on_s))
    for each in [*report.health, *report.outside]:
        found.setdefault(each.kind, []).append(span(each.from_s, each.until_s, each.worst_m))
    told = [f"{what} {', '.join(spans)}" for what, spans in found.items()]
    told += [each.partition(". ")[0].partition(" (")[0] for each in report.could_not]
    return "; ".join(told)


@pytest.mark.parametrize("what", NOTED)
def test_it_lets_go_as_the_machine_that_flies_and_tells_what_was_odd(
    tmp_path: Path, what: str
) -> None:
    make, expected = NOTED[what]
    report = watch(written(tmp_path / "log.tlog", make()), None)
    assert in_a_line(report) == expected
    assert report.in_air_s <= report.length_s


# --- with missions

QUIET = {
    *("HEARTBEAT", "STATUSTEXT", "PARAM_REQUEST_READ", "MISSION_REQUEST_LIST", "MISSION_ACK"),
    *("COMMAND_LONG", "TIMESYNC"),
}
"""All that one who only watches ever says; commands are looked at more closely."""
ASKS = {wire.MAV_CMD_SET_MESSAGE_INTERVAL, wire.MAV_CMD_REQUEST_MESSAGE}


def watched_quietly(log: Path, chosen: Mission) -> ShadowReport:
    """Nothing that it would have said commands a vehicle."""
    sent, plans = list[bytes](), list[object]()

    def note(_at_s: float, out: Output) -> None:
        sent.extend(out.frames)
        plans.extend([out.plan] * (out.plan is not None))

    report = watch(log, chosen, on_output=note)
    messages = [each for frame in sent for each in Receiver().feed(frame)]
    assert len(messages) == len(sent) > 10
    assert {message.get_type() for message in messages} <= QUIET
    assert {m.command for m in messages if m.get_type() == "COMMAND_LONG"} <= ASKS
    assert len(plans) == len(report.plans)
    return report


WATCHED: dict[str, tuple[str, str | None]] = {
    ARDUPILOT: (
        "copter-canberra",
        "ESTIMATOR 114.7-150.6; NO_FIX 163.5-190.9; no GPS fix yet 3.2-10.1; estimator not to be "
        "believed 113.6-148.6, 170.6-188.6; position jumped 123.1 50 m, 138.1 51 m, 188.5 19 m; "
        "GPS fix lost 163.5-188.5; the autopilot's own failsafe 171.2-190.1; below the floor "
        "46.6-54.0 16 m, 189.0-209.5 12 m, 297.0-323.7 16 m",
    ),
    PX4: (
        "copter-zurich",
        "NO_FIX 76.4-110.7; GPS fix lost 76.4-106.6; the autopilot's own failsafe 81.8-109.1; "
        "estimator not to be believed 81.8-108.1; position jumped 107.9 4 m, 108.0 6 m, 108.1 7 "
        "m, 108.2 5 m; below the floor 4.8-8.0 4 m, 108.8-111.0 5 m, 184.6-197.6 5 m",
    ),
    "arducopter-guided-10mps.tlog": ("copter-canberra", None),
    "arducopter-guided-global-stream-faults.tlog": ("copter-zurich", None),
    "arduplane-guided-reposition.tlog": ("plane-canberra", None),
    # it sinks to the ground from 35 to 150 s, climbs, and lands at 442 s
    PLANE: (
        "plane-zurich",
        "the autopilot's own failsafe 309.1-325.4; below the floor 4.5-13.4 20 m, 33.6-158.0 21 "
        "m, 411.5-439.6 20 m",
    ),
    HEALTHY: ("copter-zurich", None),
    "px4-offboard-short.tlog": ("copter-zurich", None),
    "px4-offboard-short.ulg": ("copter-zurich", None),
}
"""Mission, and what is told; None: only what is so on the ground, and at power-on."""
EACH = [
    pytest.param(name, marks=() if name in (ARDUPILOT, PX4, PLANE) else pytest.mark.nightly)
    for name in WATCHED
]


@pytest.mark.parametrize("name", EACH)
def test_a_healthy_flight_is_watched_without_a_hold_and_none_is_ever_commanded(name: str) -> None:
    """With nowhere to go, nothing is planned.  A report is plain values, without NaN."""
    chosen, expected = WATCHED[name]
    report = watched_quietly(recording(name), mission(chosen, targets_ne_m=()))
    if expected is None:
        assert (report.holds, report.could_not) == ([], [])
        odd = {each.kind for each in report.health}
        assert odd <= {"the autopilot's own failsafe", "no GPS fix yet"}
    else:
        assert in_a_line(report) == expected
    assert report.watched_from_s < 45.0  # ArduCopter's estimator takes 41.6 s
    again = json.loads(json.dumps(to_builtins(report), allow_nan=False))
    assert (again["schema"], again["plans"]) == (1, [])
    assert [hold["let_go_s"] for hold in again["holds"]] == [h.let_go_s for h in report.holds]


# --- plans


def test_it_plans_where_the_vehicle_is_and_only_where_that_is_to_be_believed(
    tmp_path: Path,
) -> None:
    """A minute with its GPS lost in it.

    Each path begins where the vehicle was when it was asked for, T and more before.  And the
    vehicle does 6 m/s elsewhere: by then it is 18 m on, and 37 m when the next is ready.
    """
    log = written(tmp_path / "log.tlog", recorded(PX4, 40.0, 100.0))
    report = watched_quietly(log, mission("copter-zurich"))
    first, *others = plans = report.plans
    assert len(plans) > 5
    [hold] = report.holds
    asked_s = [asked.at_s for asked in plans]
    assert asked_s == sorted(asked_s)
    assert asked_s[-1] < hold.let_go_s
    assert first.why == "it begins to watch"
    assert all("m off the path" in asked.why for asked in others)
    assert "flown track off its own paths" in text_of(report)
    # the last one was to be answered when it had let go
    assert [asked.outcome for asked in plans] == ["ready"] * len(others) + ["given up"]
    track = [each for each in held.recorded(PX4) if each[1].get_msgId() == POSITION]
    for asked in plans:
        _, m = min(track, key=lambda each, at_s=asked.at_s + 40.0: abs(each[0] - at_s))
        found = [getattr(asked.place, name) for name in asked.place.__struct_fields__]
        assert found[:2] == pytest.approx([m.lat * 1e-7, m.lon * 1e-7], abs=3e-5)
        assert found[2] == pytest.approx(m.alt * 1e-3, abs=1.0)
    offs = [asked.off for asked in plans[:-1]]
    for off, after in itertools.pairwise(offs):
        assert 0.0 < off.rms_m <= off.max_m <= 6.5 * 6.5
        assert off.from_s <= off.max_at_s <= off.until_s < after.from_s
        assert off.until_s - off.from_s == pytest.approx(3.1, abs=0.2)
        assert off.positions == pytest.approx(10.0 * (off.until_s - off.from_s), abs=2)
    assert report.own_path.max_m == max(off.max_m for off in offs)
    assert report.own_path.positions == sum(off.positions for off in offs)


def test_without_a_radar_and_with_nothing_known_of_the_ground_it_says_so(tmp_path: Path) -> None:
    """And tells the rest; where the mission knows the ground, that stands in for a radar."""
    path = written(tmp_path / "log.tlog", recorded(PX4, 40.0, 60.0))
    known = mission("copter-zurich", scanner_component_id=100)
    report, blind = watch(path, known), watch(path, replace(known, known=None))
    assert "ready" in {asked.outcome for asked in report.plans}
    assert "nothing is known of the ground" in "".join(blind.could_not)
    assert "ready" not in {asked.outcome for asked in blind.plans}


def test_a_planner_that_breaks_ends_the_watch_and_not_the_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("companion.replay.shadow.plan", lambda *_, **__: 1 / 0)
    report = watch(
        written(tmp_path / "log.tlog", recorded(PX4, 60.0, 90.0)), mission("copter-zurich")
    )
    assert "PLANNER_DIED" in {why.code for hold in report.holds for why in hold.why}
    assert any("gave up watching" in note for note in report.notes)


# --- what is refused, and how it is told

BEAT = wire.MAVLink_heartbeat_message(2, 12, 81, 0, 4, 3).pack(wire.MAVLink(None, 1, 50))
ELSEWHERE = [Record(10**15 + 10**6 * k, bytes(BEAT)) for k in range(9)]  # PX4's MAV_COMP_ID is 50
SUBMARINE = {"type": wire.MAV_TYPE_SUBMARINE}
REFUSED: dict[str, tuple[Callable[[Records], Records], Any, str]] = {
    "a submarine": (
        lambda log: setting(log, HEARTBEAT, **SUBMARINE),
        None,
        r"which the companion does not fly. It flies: ",
    ),
    "no position": (lambda log: without(log, POSITION), None, "no GLOBAL_POSITION_INT.*ecord"),
    "no heartbeat": (lambda log: without(log, HEARTBEAT), None, "it has no HEARTBEAT.*ecord"),
    "another component": (lambda _: ELSEWHERE, None, r"component 50 of system 1.*MAV_COMP_ID"),
    "a plane's mission": (iter, mission("plane-canberra"), r"it is for .*; the log is of Ardu"),
    "another autopilot's": (iter, mission("copter-canberra", autopilot="px4"), r"the log is of Ar"),
    "a mission elsewhere": (
        iter,
        mission("copter-zurich"),
        r"km .*outside its \[area\].*leave --mission out",
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_cannot_be_watched_is_refused_in_one_line(tmp_path: Path, what: str) -> None:
    """What a log is of is told before what it lacks, and how to have that recorded."""
    make, chosen, words = REFUSED[what]
    log = written(tmp_path / "log.tlog", make(recorded(ARDUPILOT, 0.0, 60.0)))
    for system_id in (None,) if what == "no heartbeat" else (None, 1):
        with pytest.raises(InputError, match=words) as caught:
            watch(log, chosen, system_id=system_id)
        assert "\n" not in str(caught.value)


def text_of(report: ShadowReport, width: int = 160) -> str:
    console = Console(file=(out := io.StringIO()), width=width)
    for part in renderables(report):
        console.print(part, highlight=False)
    return out.getvalue()


def test_the_page_shows_the_report_as_it_is_printed() -> None:
    """And what a vehicle says is no colour: PX4 before 1.10 puts the module in brackets."""
    report = watch(recording(PX4), None)
    says = VehicleReport(at_s=report.holds[0].let_go_s, text="“[commander] lost[/b]”")
    assert "“[commander] lost[/b]”" in text_of(structs.replace(report, said=[says]))
    page = Path(__file__).parents[2] / "docs/reference/shadow-report.md"
    lines = map(str.rstrip, text_of(report, width=100).splitlines())
    assert "\n".join(lines) in page.read_text(encoding="utf-8")
