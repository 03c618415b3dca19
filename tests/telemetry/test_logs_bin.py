"""ArduPilot's .bin, told as MAVLink, against the .tlog of the same flight."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from log_files import bin_of, counts, entry, fmt_entries, messages_of, of, opened, told
from recordings import recording
from told_alike import both_at, changes, late_s, of_kind, table

from companion.errors import InputError
from companion.mavlink.dialect import wire
from companion.replay.shadow import watch
from companion.telemetry.logs import Odd, open_log

COPTER, PLANE = "arducopter-gps-loss.tlog", "arduplane-guided-reposition.tlog"
COPTER_START = b"".join(
    (
        fmt_entries(),
        entry("MSG", 1000, b"ArduCopter V4.5.7"),
        entry("PARM", 1000, b"SYSID_THISMAV", 7, 1),
        entry("MODE", 2000, 4, 4, 1),
    )
)
PLACE = (471_000_000, 85_000_000, 500, 0, 0)
VELOCITY = (0, 0, 0, 90, 3, 4, 0, *([0] * 8))  # of the estimator: 3 m/s north, 4 m/s east


@pytest.mark.parametrize("name", [COPTER, PLANE])
@pytest.mark.sample(2)
def test_the_same_flight_is_told_as_in_its_tlog(name: str, tmp_path: Path) -> None:
    theirs = messages_of(open_log(recording(name)).records())
    theirs = [pair for pair in theirs if pair[1].get_srcComponent() == 1]
    log = opened(tmp_path, bin_of(recording(name)))
    ours = messages_of(log.records())
    assert not log.findings
    assert (log.kind, log.systems, log.system_id) == ("bin", (1,), 1)
    positions = "time_boot_ms lat lon alt relative_alt vx vy vz hdg"
    was, now = both_at(theirs, ours, "GLOBAL_POSITION_INT", positions)
    assert len(was) > 0.95 * len(of_kind(theirs, "GLOBAL_POSITION_INT"))
    off = np.abs(was - now)
    off[:, -1] = np.minimum(off[:, -1], 36_000 - off[:, -1])  # a heading goes round
    assert off.max() <= 1  # the last digit of the wire
    assert np.ptp(late_s(theirs, ours)) < 0.5  # the .tlog has the time of arrival
    for kind, fields in {
        "GPS_RAW_INT": "fix_type lat lon alt satellites_visible vel cog",
        "EKF_STATUS_REPORT": "flags",
        "HOME_POSITION": "latitude longitude altitude",
        "GPS_GLOBAL_ORIGIN": "latitude longitude altitude",
        "PARAM_VALUE": "param_value",
    }.items():
        mine, others = (table(each, kind, fields) for each in (ours, theirs))
        np.testing.assert_allclose(mine, others, rtol=1e-6, atol=10.0)  # of the wire's units
    names = [[m.param_id for _, m in of_kind(each, "PARAM_VALUE")] for each in (ours, theirs)]
    assert names[0] == names[1]
    times = "time_unix_usec time_boot_ms"
    dates = [table(each, "SYSTEM_TIME", times) @ [1e-3, -1.0] for each in (theirs, ours)]
    assert dates[1].max() == pytest.approx(dates[0].max(), abs=100.0)
    left, same = (
        set(table(each, "SYS_STATUS", "battery_remaining").flat) for each in (ours, theirs)
    )
    assert left <= same
    modes = [changes(each, "HEARTBEAT", "type custom_mode base_mode") for each in (ours, theirs)]
    assert [each[1:] for each in modes[0]] == [each[1:] for each in modes[1]]
    texts = [m.text for _, m in of_kind(ours, "STATUSTEXT")]
    texts = [text for text in texts if "V4.5.7 (" not in text]  # that one is the writer's
    assert texts == [m.text for _, m in of_kind(theirs, "STATUSTEXT")]
    states = table(ours, "HEARTBEAT", "system_status")
    assert (wire.MAV_STATE_CRITICAL in states) == (name == COPTER)  # its failsafe
    ground = table(ours, "EXTENDED_SYS_STATE", "landed_state").ravel()
    assert ground[0] == wire.MAV_LANDED_STATE_ON_GROUND
    assert wire.MAV_LANDED_STATE_IN_AIR in ground
    if name == COPTER:  # the plane's log ends in the air
        assert ground[-1] == wire.MAV_LANDED_STATE_ON_GROUND


def test_whose_log_it_is_stands_in_its_parameters(tmp_path: Path) -> None:
    log = opened(tmp_path, COPTER_START)
    (beat,) = of(told(log), "HEARTBEAT")
    assert (beat.get_srcSystem(), log.system_id, beat.type) == (7, 7, wire.MAV_TYPE_QUADROTOR)
    assert not beat.base_mode & wire.MAV_MODE_FLAG_SAFETY_ARMED
    with pytest.raises(InputError, match=r"--system = 3: there is no such.*Its vehicles: 7"):
        opened(tmp_path, COPTER_START, system_id=3)


def test_an_unknown_date_and_what_is_missing_are_told(tmp_path: Path) -> None:
    log = opened(tmp_path, COPTER_START)
    told(log)
    assert set(counts(log)) == {Odd.NO_DATE}
    missing = log.missing().keys()
    assert "EKF_STATUS_REPORT" in missing
    assert {"HEARTBEAT", "PARAM_VALUE", "STATUSTEXT", "ESTIMATOR_STATUS"}.isdisjoint(missing)


GREETINGS = {
    b"APMrover2 V3.5.0": "3.5",
    b"ArduPlane V3.9.11": "3.9",
    b"ArduCopter V4.0.0 (0bb18a15)": None,
    b"ArduCopter V10.1.0": None,
}


@pytest.mark.parametrize(("greeting", "refused"), GREETINGS.items(), ids=str)
def test_firmware_before_4_0_is_refused_by_its_version(
    greeting: bytes, refused: str | None, tmp_path: Path
) -> None:
    content = fmt_entries() + entry("MSG", 900_000, greeting)
    if refused is None:
        assert opened(tmp_path, content).autopilot == wire.MAV_AUTOPILOT_ARDUPILOTMEGA
        return
    rule = f"it is of ArduPilot {refused}, and logs are read from 4.0 on. Fly newer"
    with pytest.raises(InputError, match=re.escape(rule)):
        opened(tmp_path, content)


def test_who_nobody_knows_is_refused_with_what_was_looked_for(tmp_path: Path) -> None:
    log = opened(tmp_path, fmt_entries() + entry("MSG", 900_000, b"HomeBrew 1.0"))
    with pytest.raises(InputError, match=r"no HEARTBEAT: .*; no entry \(VER, MSG\) tells"):
        watch(log.path, None)


def test_a_position_without_a_velocity_is_not_told(tmp_path: Path) -> None:
    """Nor one whose velocity is older than a second."""
    content = COPTER_START + entry("POS", 1_000_000, *PLACE) + entry("XKF1", 2_000_000, *VELOCITY)
    content += entry("POS", 2_100_000, *PLACE) + entry("POS", 3_900_000, *PLACE)
    (position,) = of(told(opened(tmp_path, content)), "GLOBAL_POSITION_INT")
    assert (position.time_boot_ms, position.vx, position.vy) == (2100, 300, 400)


TEXTS = [entry("MSG", 3_000_000 + k * 1000, b"%d" % k) for k in range(6)]
LEAPS = [3_000_000, 4_000_000, 1 << 60, 5_000_000, 4_000_000_000, 6_000_000]
SENSELESS = (
    entry("XKF1", 3000, 0, 0, 0, 90, math.nan, 1e30, 0, *([0] * 8)),
    entry("POS", 4000, 1, 1, 500, 0, 0),
    entry("POS", 900_000, 1, 1, math.inf, 0, 0),
    entry("BAT", 5000, 0, *([math.nan] * 4), *([0] * 6)),
    entry("MODE", 6000, 200, 200, 1),
    entry("MSG", 7000, b"\xff\xfe\x00"),
)
DAMAGES: dict[str, tuple[bytes, list[str] | None, dict[Odd, int]]] = {
    "cut, noise and the end missing": (
        TEXTS[0] + TEXTS[1][:20] + TEXTS[2] + b"noise" + TEXTS[3] + TEXTS[4] + TEXTS[5][:30],
        ["0", "3", "4"],  # what noise follows is left out, too
        {
            Odd.DAMAGED: 2,
            Odd.GARBAGE: 20 + len(TEXTS[2]) + len(b"noise") - 2 * len(b"\xa3\x95"),
            Odd.CUT_SHORT: 30,
        },
    ),
    "a time that leaps is not believed once": (
        b"".join(entry("MSG", time_us, b"%d" % time_us) for time_us in LEAPS),
        ["3000000", "4000000", "5000000", "6000000"],
        {Odd.WRONG_STAMP: 2},
    ),
    "numbers that fit into no message": (b"".join(SENSELESS), None, {Odd.DAMAGED: 3}),
    "what the vehicle could not write": (
        b"".join(entry("DSF", 3000 + k, lost, *([0] * 5)) for k, lost in enumerate((0, 40, 42))),
        [],
        {Odd.LOST_ENTRIES: 42},
    ),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_what_is_damaged_is_left_out_and_counted_and_the_rest_is_kept(
    tmp_path: Path, damage: str
) -> None:
    content, texts, found = DAMAGES[damage]
    log = opened(tmp_path, COPTER_START + content)
    messages = told(log)
    if texts is not None:
        assert [m.text for m in of(messages, "STATUSTEXT")] == ["ArduCopter V4.5.7", *texts]
    assert not of(messages, "GLOBAL_POSITION_INT")
    assert counts(log) == found | {Odd.NO_DATE: 1}
