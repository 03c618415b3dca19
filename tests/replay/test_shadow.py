"""Recorded flights in shadow, as they are and cut, changed and written anew.

Against what their READMEs say, and against the plain session.  Times are seconds after the first
record; those of the faults are the recordings' own.
"""

import functools
import io
import itertools
import json
import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import missions
import pytest
from msgspec import structs, to_builtins
from recordings import recording
from rich.console import Console

from companion.errors import InputError
from companion.mavlink.autopilots import ALL
from companion.mavlink.dialect import Message, wire
from companion.mavlink.frames import Receiver, number_of, sender_of
from companion.mavlink.link import Output
from companion.mission.mission import Mission
from companion.mission.state import Phase
from companion.replay.shadow import LISTENED, watch
from companion.replay.shadow_report import ShadowReport, VehicleReport, renderables
from companion.session import Session
from companion.telemetry.logs import Record, open_log

ARDUPILOT, PX4 = "arducopter-gps-loss.tlog", "px4-gps-loss.tlog"
HEALTHY, PLANE = "px4-offboard-8mps.tlog", "px4-fixedwing-offboard.tlog"
GUIDED = "arduplane-guided-reposition.tlog"
MISSION_OF = {
    ARDUPILOT: "copter-canberra",
    PX4: "copter-zurich",
    "arducopter-guided-10mps.tlog": "copter-canberra",
    "arducopter-guided-global-stream-faults.tlog": "copter-zurich",
    GUIDED: "plane-canberra",
    PLANE: "plane-zurich",
    HEALTHY: "copter-zurich",
    "px4-offboard-short.tlog": "copter-zurich",
    "px4-offboard-short.ulg": "copter-zurich",
}
VEHICLE = (1, 1)
HEARTBEAT = wire.MAVLINK_MSG_ID_HEARTBEAT
POSITION = wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
GPS = wire.MAVLINK_MSG_ID_GPS_RAW_INT
EKF = wire.MAVLINK_MSG_ID_EKF_STATUS_REPORT
Records = Iterable[Record]


def mission(name: str) -> Mission:
    """With a search that takes no time."""
    return missions.mission(name, evaluations=100)


@functools.cache
def _records(name: str) -> list[Record]:
    return list(open_log(recording(name)).records())


def recorded(name: str, *, from_s: float = 0.0, until_s: float = 1e9) -> Iterator[Record]:
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


def never(_: Message) -> bool:
    return False


def each_tenth() -> Callable[[Message], bool]:
    count = itertools.count(1)
    return lambda _: next(count) % 10 == 0


def later(records: Records, by_s: float) -> Iterator[Record]:
    """By the log's clock, not by the vehicle's."""
    return (Record(each.time_us + round(1e6 * by_s), each.frame) for each in records)


def written(folder: Path, records: Records) -> Path:
    """A .tlog of these."""
    rows = (struct.pack(">Q", record.time_us) + record.frame for record in records)
    (folder / "log.tlog").write_bytes(b"".join(rows))
    return folder / "log.tlog"


# --- what is noted


class Noted(NamedTuple):
    """What comes of a log without a mission."""

    holds: list[tuple[str, float, float | None]]
    """Why it lets go, when, and when it would have gone on."""
    spans: dict[str, tuple[float, float | None]] = {}  # noqa: RUF012 - read only
    could_not: str = ""
    gave_up: bool = False


def paused(until_s: float) -> Records:
    return [
        *recorded(HEALTHY, from_s=60.0, until_s=90.0),
        *recorded(HEALTHY, from_s=until_s, until_s=until_s + 14.0),
    ]


def rebooted() -> Records:
    """Before it the GPS has no fix; and while it boots it does not say what it is."""
    unborn = itertools.count()

    def boots(message: Message) -> None:
        message.type = wire.MAV_TYPE_GENERIC if next(unborn) < 3 else message.type

    def blind(message: Message) -> None:
        message.fix_type = 1

    first = list(edited(edited(recorded(HEALTHY, until_s=20.0), HEARTBEAT, boots), GPS, blind))
    gap_s = (first[-1].time_us - first[0].time_us) * 1e-6 + 1.0
    return [*first, *later(recorded(HEALTHY, until_s=25.0), gap_s)]


def seldom_placed() -> Records:
    """One position a second, as ground stations ask for them, and then none."""
    told = edited(recorded(HEALTHY, from_s=60.0, until_s=100.0), POSITION, each_tenth())
    return [*told, *edited(recorded(HEALTHY, from_s=100.0, until_s=120.0), POSITION, never)]


def without(number: int) -> Records:
    return edited(recorded(ARDUPILOT, until_s=195.0), number, never)


REBOOT, NO_FIX_YET, FAILSAFE = "the autopilot has rebooted", "no GPS fix yet", "own failsafe"
NOTED: dict[str, tuple[Callable[[], Records], Noted]] = {
    ARDUPILOT: (
        lambda: recorded(ARDUPILOT),
        Noted(
            [("ESTIMATOR", 114.67, 150.6), ("NO_FIX", 163.51, 190.9)],
            {"GPS fix lost": (163.5, 188.5), "estimator": (113.6, 148.6), FAILSAFE: (171.2, 190.1)},
        ),
    ),
    PX4: (
        lambda: recorded(PX4),
        Noted([("NO_FIX", 76.36, 110.7)], {"GPS fix lost": (76.3, 106.6), FAILSAFE: (81.8, 109.1)}),
    ),
    "cut off in a hold": (
        lambda: recorded(PX4, until_s=90.0),
        Noted([("NO_FIX", 76.36, None)], {"GPS fix lost": (76.3, None)}),
    ),
    "begun in the air": (
        lambda: recorded(PX4, from_s=60.0, until_s=120.0),
        Noted([("NO_FIX", 16.36, 50.7)], {"GPS fix lost": (16.3, 46.6)}),
    ),
    "2 s are a pause": (lambda: paused(92.0), Noted([("POSITION_STALE", 32.0, 34.0)])),
    # once GPS and estimator are heard again, and then 2 s
    "6 s are a silence": (
        lambda: paused(96.0),
        Noted([("LINK_LOST", 33.0, 38.6)], {"silence": (30.0, 36.0)}),
    ),
    "nobody waits so long": (
        lambda: [
            *recorded(PX4, until_s=50.0),
            *later(recorded(PX4, from_s=50.0, until_s=80.0), 700.0),
        ],
        Noted(
            [("LINK_LOST", 53.0, 752.5), ("NO_FIX", 776.36, None)],
            {"silence": (50.0, 750.0)},
            gave_up=True,
        ),
    ),
    "a reboot": (rebooted, Noted([], {REBOOT: (21.0, 21.0), NO_FIX_YET: (1.0, 20.0)})),
    # What the estimator would have told at 114.7 s is only seen when the position jumps.
    # By then it is where the vehicle cannot be: it holds until it has jumped back.
    "no word of the estimator": (
        lambda: without(EKF),
        Noted(
            [("POSITION_JUMPED", 123.07, 140.5), ("NO_FIX", 163.51, 190.9)],
            could_not="EKF_STATUS_REPORT missing: taken to be good",
        ),
    ),
    "no word of the GPS": (
        lambda: without(GPS),  # the fix was lost at 163.5 s
        Noted(
            [("ESTIMATOR", 114.67, 150.6), ("ESTIMATOR", 171.7, 190.9)],
            could_not="GPS_RAW_INT missing: taken to be good",
        ),
    ),
    "few positions": (
        seldom_placed,
        Noted([("POSITION_STALE", 42.3, None)], could_not="GLOBAL_POSITION_INT comes at 1.0 Hz"),
    ),
}


@functools.cache
def noted(name: str) -> ShadowReport:
    return watch(recording(name), None)


@pytest.mark.parametrize("what", NOTED)
def test_it_lets_go_as_the_machine_that_flies_and_tells_what_was_odd(
    tmp_path: Path, what: str
) -> None:
    make, expected = NOTED[what]
    report = noted(what) if what in MISSION_OF else watch(written(tmp_path, make()), None)
    assert [hold.why[0].code for hold in report.holds] == [code for code, *_ in expected.holds]
    for hold, (_, let_go_s, went_on_s) in zip(report.holds, expected.holds, strict=True):
        tolerance_s = 0.02 if hold.why[0].code == "NO_FIX" else 0.5
        assert hold.let_go_s == pytest.approx(let_go_s, abs=tolerance_s)
        assert hold.went_on_s == (went_on_s and pytest.approx(went_on_s, abs=2.0))
        if hold.went_on_s is not None and not expected.gave_up:  # 2 s after it was last doubted
            assert hold.let_go_s < hold.trusted_s <= hold.went_on_s - 1.89
    for kind, (from_s, until_s) in expected.spans.items():
        span = next(each for each in report.health if kind in each.kind)
        assert span.from_s == pytest.approx(from_s, abs=3.0 if kind == NO_FIX_YET else 1.0)
        assert span.until_s == (until_s and pytest.approx(until_s, abs=1.5))
    assert any(each.kind == "silence" for each in report.health) == ("silence" in expected.spans)
    assert report.in_air_s <= report.length_s
    assert len(report.could_not) == bool(expected.could_not)
    assert expected.could_not in "".join(report.could_not)
    assert any("gave up watching" in note for note in report.notes) == expected.gave_up


def test_what_the_vehicle_did_by_itself_stands_beside_jumps_as_long_as_they_were() -> None:
    report = noted(ARDUPILOT)
    jumps = [each for each in report.health if each.kind == "position jumped"]
    assert [each.worst_m for each in jumps] == pytest.approx([50.0, 51.0, 18.8], abs=1.0)
    times = {each.text: each.at_s for each in report.said}
    assert times["armed"] == pytest.approx(44.0, abs=0.1)
    assert times["“EKF variance”"] == pytest.approx(171.2, abs=0.1)
    modes = [each for each in report.said if each.text.startswith("mode")]
    assert [each.text.removeprefix("mode ") for each in modes] == [
        *("STABILIZE", "GUIDED", "LAND", "GUIDED", "LAND")
    ]
    expected_s = [43.1, 171.2, 203.2, 286.7]
    assert [each.at_s for each in modes[1:]] == pytest.approx(expected_s, abs=0.6)


# --- with missions

QUIET = {
    *("HEARTBEAT", "STATUSTEXT", "PARAM_REQUEST_READ", "MISSION_REQUEST_LIST", "MISSION_ACK"),
    *("COMMAND_LONG", "TIMESYNC"),
}
"""All that one who only watches ever says; commands are looked at more closely."""


@dataclass(slots=True)
class Sent:
    """What a shadow would have said."""

    frames: list[bytes] = field(default_factory=list)
    plans: int = 0

    def __call__(self, _at_s: float, out: Output) -> None:
        self.frames += out.frames
        self.plans += out.plan is not None


def assert_quiet(sent: Sent) -> None:
    """Nothing that it would have said commands a vehicle."""
    messages = [each for frame in sent.frames for each in Receiver().feed(frame)]
    assert len(messages) == len(sent.frames) > 10
    assert {message.get_type() for message in messages} <= QUIET
    asked = {m.command for m in messages if m.get_type() == "COMMAND_LONG"}
    assert asked <= {wire.MAV_CMD_SET_MESSAGE_INTERVAL, wire.MAV_CMD_REQUEST_MESSAGE}


@functools.cache
def watched(name: str) -> tuple[ShadowReport, Sent]:
    """With its mission, but nowhere to go: nothing is planned."""
    sent = Sent()
    chosen = replace(mission(MISSION_OF[name]), targets_ne_m=())
    return watch(recording(name), chosen, on_output=sent), sent


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in (ARDUPILOT, PX4, PLANE) else pytest.mark.nightly)
        for name in MISSION_OF
    ],
)
def test_a_healthy_flight_is_watched_without_a_hold_and_none_is_ever_commanded(name: str) -> None:
    """A report is plain values, without NaN."""
    report, sent = watched(name)
    if name not in (ARDUPILOT, PX4):
        assert (report.holds, report.could_not) == ([], [])
        odd = {each.kind for each in report.health}
        assert odd <= {"the autopilot's own failsafe", NO_FIX_YET}  # some begin at power-on
    assert report.watched_from_s is not None
    assert report.watched_from_s < 45.0  # ArduCopter's estimator takes 41.6 s
    assert_quiet(sent)
    assert sent.plans == len(report.plans) == 0
    again = json.loads(json.dumps(to_builtins(report), allow_nan=False))
    assert again["schema"] == 1
    assert [hold["let_go_s"] for hold in again["holds"]] == [h.let_go_s for h in report.holds]


def track_of(name: str) -> list[tuple[float, float, float, float]]:
    """Time, latitude, longitude and altitude, of the vehicle's own positions."""
    records = list(recorded(name))
    return [
        ((record.time_us - records[0].time_us) * 1e-6, m.lat * 1e-7, m.lon * 1e-7, m.alt * 1e-3)
        for record in records
        if number_of(record.frame) == POSITION and sender_of(record.frame) == VEHICLE
        for m in Receiver().feed(record.frame)
    ]


def test_it_tells_where_the_mission_does_not_allow_the_vehicle_to_be() -> None:
    """PX4's aeroplane sinks to the ground from 35 to 150 s, climbs, and lands at 442 s."""
    _, sank, landing = watched(PLANE)[0].outside
    assert sank.kind == landing.kind == "below the floor"
    assert (sank.from_s, sank.until_s) == pytest.approx((35.0, 157.0), abs=13.0)
    assert landing.until_s == pytest.approx(440.0, abs=3.0)
    lowest_m = min(at[3] for at in track_of(PLANE) if 40.0 < at[0] < 160.0)
    floor_m = mission("plane-zurich").task.limits.floor_amsl_m
    assert sank.worst_m == pytest.approx(floor_m - lowest_m, abs=0.01)


@pytest.mark.parametrize(
    "name", [PX4, *(pytest.param(name, marks=pytest.mark.nightly) for name in (ARDUPILOT, GUIDED))]
)
def test_what_is_passed_over_unread_changes_nothing(name: str) -> None:
    """All frames of the autopilot, one by one, to a session of its own."""
    chosen = replace(mission(MISSION_OF[name]), targets_ne_m=(), system_id=1)
    session = Session(chosen, seed=1, lockstep=False, shadow=True)
    changes, reason, first_us = list[tuple[float, str | None]](), None, _records(name)[0].time_us
    for record in recorded(name):
        if sender_of(record.frame) != VEHICLE:
            continue
        session.receive(record.frame, record.time_us * 1e-6)
        session.run()
        state = session.state
        if state.phase is Phase.SHADOW and state.reason is not reason:
            reason = state.reason
            at_s = (record.time_us - first_us) * 1e-6
            changes.append((at_s, None if reason is None else reason.name))
    mine = [
        (at_s, code)
        for hold in watched(name)[0].holds
        for at_s, code in [*((why.at_s, why.code) for why in hold.why), (hold.went_on_s, None)]
    ]
    assert [code for _, code in mine] == [code for _, code in changes]
    assert [at_s for at_s, _ in mine] == pytest.approx([at_s for at_s, _ in changes], abs=0.11)


def test_whatever_a_strategy_reads_of_the_health_is_heard() -> None:
    """But for echoes of setpoints, which say nothing of the vehicle."""
    echoes = {
        wire.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED,
        wire.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT,
    }
    read = {number for autopilot in ALL for number in autopilot.decoders}
    assert read - echoes <= LISTENED


# --- plans


def test_it_plans_where_the_vehicle_is_and_only_where_that_is_to_be_believed(
    tmp_path: Path,
) -> None:
    """A minute with its GPS lost in it.

    Each path begins where the vehicle was when it was asked for, T and more before.  And the
    vehicle does 6 m/s elsewhere: by then it is 18 m on, and 37 m when the next is ready.
    """
    sent = Sent()
    log = written(tmp_path, recorded(PX4, from_s=40.0, until_s=100.0))
    report = watch(log, mission("copter-zurich"), on_output=sent)
    first, *others = plans = report.plans
    assert sent.plans == len(plans) > 5
    assert_quiet(sent)
    [hold] = report.holds
    asked_s = [asked.at_s for asked in plans]
    assert asked_s == sorted(asked_s)
    assert asked_s[-1] < hold.let_go_s
    assert first.why == "it begins to watch"
    assert all("m off the path" in asked.why for asked in others)
    assert "flown track off its own paths" in text_of(report)
    # the last one was to be answered when it had let go
    assert [asked.outcome for asked in plans] == ["ready"] * len(others) + ["given up"]
    track = track_of(PX4)
    for asked in plans:
        at = min(track, key=lambda each, at_s=asked.at_s + 40.0: abs(each[0] - at_s))
        assert asked.place.latitude_deg == pytest.approx(at[1], abs=2e-5)
        assert asked.place.longitude_deg == pytest.approx(at[2], abs=3e-5)
        assert asked.place.altitude_amsl_m == pytest.approx(at[3], abs=1.0)
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
    path = written(tmp_path, recorded(PX4, from_s=40.0, until_s=60.0))
    known = replace(mission("copter-zurich"), scanner_component_id=100)
    report, blind = watch(path, known), watch(path, replace(known, known=None))
    assert "ready" in {asked.outcome for asked in report.plans}
    assert "nothing is known of the ground" in "".join(blind.could_not)
    assert "ready" not in {asked.outcome for asked in blind.plans}


def test_a_planner_that_breaks_ends_the_watch_and_not_the_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("by nothing")

    monkeypatch.setattr("companion.replay.shadow.plan", broken)
    log = written(tmp_path, recorded(PX4, from_s=60.0, until_s=90.0))
    report = watch(log, mission("copter-zurich"))
    assert "PLANNER_DIED" in {why.code for hold in report.holds for why in hold.why}
    assert any("gave up watching" in note for note in report.notes)


# --- what is refused


def submarine(message: Message) -> None:
    message.type = wire.MAV_TYPE_SUBMARINE


def early(number: int, edit: Callable[[Message], object]) -> Records:
    return edited(recorded(ARDUPILOT, until_s=60.0), number, edit)


BEAT = wire.MAVLink_heartbeat_message(2, 12, 81, 0, 4, 3).pack(wire.MAVLink(None, 1, 50))
ELSEWHERE = [Record(10**15 + 10**6 * k, bytes(BEAT)) for k in range(9)]  # PX4's MAV_COMP_ID is 50
PLANES = mission("plane-zurich")
ARDUPILOTS = replace(mission("copter-zurich"), autopilot="ardupilot")
REFUSED: dict[str, tuple[Callable[[], Records], Any, str]] = {
    "a submarine": (
        lambda: early(HEARTBEAT, submarine),
        None,
        r"which the companion does not fly. It flies: ",
    ),
    "no position": (lambda: early(POSITION, never), None, "no GLOBAL_POSITION_INT.*ecord"),
    "no heartbeat": (lambda: early(HEARTBEAT, never), None, "it has no HEARTBEAT.*ecord"),
    "another component": (lambda: ELSEWHERE, None, r"component 50 of system 1.*MAV_COMP_ID"),
    "a plane's mission": (lambda: recorded(PX4), PLANES, r"it is for .*; the log is of PX4"),
    "another autopilot's": (lambda: recorded(PX4), ARDUPILOTS, r"the log is of PX4"),
    "a mission elsewhere": (
        lambda: recorded(PX4),
        mission("copter-canberra"),
        r"km north.*outside its \[area\].*leave --mission out",
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_cannot_be_watched_is_refused_in_one_line(tmp_path: Path, what: str) -> None:
    """What a log is of is told before what it lacks, and how to have that recorded."""
    make, chosen, words = REFUSED[what]
    log = written(tmp_path, make())
    for system_id in (None,) if what == "no heartbeat" else (None, 1):
        with pytest.raises(InputError, match=words) as caught:
            watch(log, chosen, system_id=system_id)
        assert "\n" not in str(caught.value)


# --- as it is told


def text_of(report: ShadowReport, width: int = 160) -> str:
    console = Console(file=(out := io.StringIO()), width=width)
    for part in renderables(report):
        console.print(part, highlight=False)
    return out.getvalue()


def test_the_page_shows_the_report_as_it_is_printed() -> None:
    """And what a vehicle says is no colour: PX4 before 1.10 puts the module in brackets."""
    report = noted(PX4)
    says = VehicleReport(at_s=report.holds[0].let_go_s, text="“[commander] lost[/b]”")
    assert "“[commander] lost[/b]”" in text_of(structs.replace(report, said=[says]))
    page = Path(__file__).parents[2] / "docs/reference/shadow-report.md"
    lines = map(str.rstrip, text_of(report, width=100).splitlines())
    assert "\n".join(lines) in page.read_text(encoding="utf-8")
