"""Every recorded flight in shadow: against what their READMEs say, and against the plain session.

Times are seconds after the first record; those of the faults are the recordings' own.
"""

import functools
import io
import itertools
import json
from dataclasses import dataclass, field, replace
from pathlib import Path

import cut_logs
import pytest
from cut_logs import VEHICLE, recorded, written
from msgspec import structs, to_builtins
from recordings import recording
from rich.console import Console

from companion.mavlink.autopilots import ALL
from companion.mavlink.dialect import wire
from companion.mavlink.frames import Receiver, sender_of
from companion.mavlink.link import Output
from companion.mission.mission import Mission
from companion.mission.state import Phase
from companion.replay.shadow import LISTENED, watch
from companion.replay.shadow_report import ShadowReport, VehicleReport, renderables
from companion.session import Session

ARDUPILOT, PX4 = "arducopter-gps-loss.tlog", "px4-gps-loss.tlog"
PLANE = "px4-fixedwing-offboard.tlog"
MISSION_OF = {
    ARDUPILOT: "copter-canberra",
    PX4: "copter-zurich",
    "arducopter-guided-10mps.tlog": "copter-canberra",
    "arducopter-guided-global-stream-faults.tlog": "copter-zurich",
    "arduplane-guided-reposition.tlog": "plane-canberra",
    PLANE: "plane-zurich",
    "px4-offboard-8mps.tlog": "copter-zurich",
    "px4-offboard-short.tlog": "copter-zurich",
    "px4-offboard-short.ulg": "copter-zurich",
}
WATCHED = (ARDUPILOT, PX4, PLANE)
"""With their missions, in CI too."""


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


def mission(name: str) -> Mission:
    """The mission about a recording, with a search that takes no time."""
    return cut_logs.mission(MISSION_OF[name], evaluations=100)


@functools.cache
def watched(name: str) -> tuple[ShadowReport, Sent]:
    """With its mission, but nowhere to go: nothing is planned."""
    sent = Sent()
    chosen = replace(mission(name), targets_ne_m=())
    return watch(recording(name), chosen, on_output=sent), sent


def report_of(name: str) -> ShadowReport:
    """Of a recorded flight."""
    return watched(name)[0]


@pytest.fixture(scope="module")
def minute(tmp_path_factory: pytest.TempPathFactory) -> tuple[ShadowReport, Sent]:
    """A minute of a flight with its GPS lost in it, with plans."""
    sent, folder = Sent(), tmp_path_factory.mktemp("minute")
    log = written(folder / "minute.tlog", recorded(PX4, from_s=40.0, until_s=100.0))
    return watch(log, mission(PX4), on_output=sent), sent


# --- against the READMEs


@pytest.mark.parametrize(
    ("log", "holds", "lost_s"),
    [
        (ARDUPILOT, [("ESTIMATOR", 114.67, 148.3), ("NO_FIX", 163.51, 188.5)], (163.5, 188.5)),
        (PX4, [("NO_FIX", 76.36, 108.6)], (76.3, 106.6)),
    ],
)
def test_it_lets_go_as_soon_as_the_machine_that_flies_and_until_the_position_is_right(
    log: str, holds: list[tuple[str, float, float]], lost_s: tuple[float, float]
) -> None:
    report = report_of(log)
    for hold, (why, let_go_s, right_s) in zip(report.holds, holds, strict=False):
        assert (hold.why[0].code, hold.in_air) == (why, True)
        assert hold.let_go_s == pytest.approx(let_go_s, abs=0.01)
        assert hold.trusted_s == pytest.approx(right_s + 0.5, abs=0.6)
        assert hold.went_on_s - hold.trusted_s >= 1.89  # 2 s after it was last doubted
    [lost] = [each for each in report.health if each.kind == "GPS fix lost" and each.in_air]
    assert (lost.from_s, lost.until_s) == pytest.approx(lost_s, abs=0.1)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in WATCHED else pytest.mark.nightly)
        for name in MISSION_OF
    ],
)
def test_a_healthy_flight_is_watched_without_a_hold_and_none_is_ever_commanded(name: str) -> None:
    """A report is plain values, without NaN."""
    report, sent = watched(name)
    if name not in (ARDUPILOT, PX4):
        assert (report.holds, report.could_not) == ([], [])
        odd = {each.kind for each in report.health}
        assert odd <= {"the autopilot's own failsafe", "no GPS fix yet"}  # some begin at power-on
    assert report.watched_from_s is not None
    assert report.watched_from_s < 45.0  # ArduCopter's estimator takes 41.6 s
    assert_quiet(sent)
    assert sent.plans == len(report.plans) == 0
    again = json.loads(json.dumps(to_builtins(report), allow_nan=False))
    assert again["schema"] == 1
    assert [hold["let_go_s"] for hold in again["holds"]] == [h.let_go_s for h in report.holds]


def test_it_tells_where_the_mission_does_not_allow_the_vehicle_to_be() -> None:
    """PX4's aeroplane sinks to the ground from 35 to 150 s, climbs, and lands at 442 s."""
    _, sank, landing = report_of(PLANE).outside
    assert sank.kind == landing.kind == "below the floor"
    assert (sank.from_s, sank.until_s) == pytest.approx((35.0, 157.0), abs=13.0)
    assert landing.until_s == pytest.approx(440.0, abs=3.0)
    lowest_m = min(at[3] for at in track_of(PLANE) if 40.0 < at[0] < 160.0)
    floor_m = mission(PLANE).task.limits.floor_amsl_m
    assert sank.worst_m == pytest.approx(floor_m - lowest_m, abs=0.01)


def assert_quiet(sent: Sent) -> None:
    """Nothing that it would have said commands a vehicle."""
    messages = [each for frame in sent.frames for each in Receiver().feed(frame)]
    assert len(messages) == len(sent.frames) > 10
    assert {message.get_type() for message in messages} <= QUIET
    asked = {m.command for m in messages if m.get_type() == "COMMAND_LONG"}
    assert asked <= {wire.MAV_CMD_SET_MESSAGE_INTERVAL, wire.MAV_CMD_REQUEST_MESSAGE}


def test_what_the_vehicle_did_by_itself_stands_beside_jumps_as_long_as_they_were() -> None:
    health = report_of(ARDUPILOT).health
    jumps = [each for each in health if each.kind == "position jumped" and each.from_s < 150.0]
    assert [each.worst_m for each in jumps] == pytest.approx([50.0, 51.0], abs=1.0)
    said = [(each.text, each.at_s) for each in report_of(ARDUPILOT).said]
    times = dict(said)
    assert times["armed"] == pytest.approx(44.0, abs=0.1)
    assert times["“EKF variance”"] == pytest.approx(171.2, abs=0.1)
    modes = [each for each in said if each[0].startswith("mode")]
    assert [text.removeprefix("mode ") for text, _ in modes] == [
        *("STABILIZE", "GUIDED", "LAND", "GUIDED", "LAND")
    ]
    assert [at_s for _, at_s in modes[1:]] == pytest.approx([43.1, 171.2, 203.2, 286.7], abs=0.6)


# --- against the session itself


@pytest.mark.parametrize(
    "name",
    [
        PX4,
        pytest.param(ARDUPILOT, marks=pytest.mark.nightly),
        pytest.param("arduplane-guided-reposition.tlog", marks=pytest.mark.nightly),
    ],
)
def test_what_is_passed_over_unread_changes_nothing(name: str) -> None:
    """All frames of the autopilot, one by one, to a session of its own."""
    chosen = replace(mission(name), targets_ne_m=(), system_id=1)
    session = Session(chosen, seed=1, lockstep=False, shadow=True)
    changes, reason, first_us = list[tuple[float, str | None]](), None, None
    for record in recorded(name):
        first_us = record.time_us if first_us is None else first_us
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
        for hold in report_of(name).holds
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
    minute: tuple[ShadowReport, Sent],
) -> None:
    report, sent = minute
    assert sent.plans == len(report.plans) > 5
    assert_quiet(sent)
    [hold] = report.holds
    assert hold.went_on_s is None  # the cut ends before the fix is back
    asked_s = [asked.at_s for asked in report.plans]
    assert asked_s == sorted(asked_s)
    assert asked_s[-1] < hold.let_go_s
    assert report.plans[0].why == "it begins to watch"
    assert all("off its path" in asked.why for asked in report.plans[1:])
    text = text_of(report)
    assert "it begins to watch" in text
    assert "flown track off its own paths" in text
    assert {asked.outcome for asked in report.plans[:-1]} == {"ready"}
    assert report.plans[-1].outcome == "given up"  # it was to be answered when it had let go
    track = track_of(PX4)
    for asked in report.plans:
        at = min(track, key=lambda each, at_s=asked.at_s + 40.0: abs(each[0] - at_s))
        assert asked.place.latitude_deg == pytest.approx(at[1], abs=2e-5)
        assert asked.place.longitude_deg == pytest.approx(at[2], abs=3e-5)
        assert asked.place.altitude_amsl_m == pytest.approx(at[3], abs=1.0)


def test_how_far_the_track_was_from_its_own_path(minute: tuple[ShadowReport, Sent]) -> None:
    """Each path begins where the vehicle was when it was asked for, T and more before.

    And the vehicle does 6 m/s elsewhere: by then it is 18 m on, and 37 m when the next is ready.
    """
    report, _ = minute
    offs = [asked.off for asked in report.plans if asked.off is not None]
    assert len(offs) == sum(asked.outcome == "ready" for asked in report.plans) > 5
    for off, after in itertools.pairwise(offs):
        assert 0.0 < off.rms_m <= off.max_m <= 6.5 * 6.5
        assert off.from_s <= off.max_at_s <= off.until_s < after.from_s
        assert off.until_s - off.from_s == pytest.approx(3.1, abs=0.2)
        assert off.positions == pytest.approx(10.0 * (off.until_s - off.from_s), abs=2)
    own = report.own_path
    assert own is not None
    assert own.max_m == max(off.max_m for off in offs)
    assert own.positions == sum(off.positions for off in offs)


def track_of(name: str) -> list[tuple[float, float, float, float]]:
    """Time, latitude, longitude and altitude, of the vehicle's own positions."""
    found, first_us = list[tuple[float, float, float, float]](), None
    receiver = Receiver()
    for record in recorded(name):
        first_us = record.time_us if first_us is None else first_us
        for message in receiver.feed(record.frame) if sender_of(record.frame) == VEHICLE else ():
            if message.get_type() == "GLOBAL_POSITION_INT":
                at_s = (record.time_us - first_us) * 1e-6
                found.append((at_s, message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3))
    return found


# --- as it is told


def text_of(report: ShadowReport, width: int = 160) -> str:
    console = Console(file=(out := io.StringIO()), width=width)
    for part in renderables(report):
        console.print(part, highlight=False)
    return out.getvalue()


def test_the_page_shows_the_report_as_it_is_printed() -> None:
    """And what a vehicle says is no colour: PX4 before 1.10 puts the module in brackets."""
    report = report_of(PX4)
    says = VehicleReport(at_s=report.holds[0].let_go_s, text="“[commander] lost[/b]”")
    assert "“[commander] lost[/b]”" in text_of(structs.replace(report, said=[says]))
    page = Path(__file__).parents[2] / "docs/reference/shadow-report.md"
    lines = map(str.rstrip, text_of(cut_logs.whole(PX4), width=100).splitlines())
    assert "\n".join(lines) in page.read_text(encoding="utf-8")
