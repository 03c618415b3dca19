"""The flown track out of frames, and what follows from vehicle times that begin again."""

import json
import math
from typing import Any

import pytest
from golden import GOLDENS
from pymavlink.dialects.v20 import all as wire

from companion.config import load_mission
from companion.mission import events
from companion.mission import journal as noted
from companion.telemetry.export.formats import features_of
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


def flight(*positions: bytes | float, entries: Any = (), system_id: int | None = 1) -> Flight:
    """Positions a tenth of a second apart, by their vehicle times, then entries of the journal."""
    found = Flight(MISSION, system_id)
    for k, each in enumerate(positions):
        found.look(EPOCH_US + 100_000 * k, each if isinstance(each, bytes) else position(each))
    for entry in entries:
        found.take(entry)
    found.settle()
    return found


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
def test_units_signs_datums_and_what_is_not_told(told: Any, expected: dict[str, float]) -> None:
    found = flight(position(12.3, **told))
    values = {name: getattr(found.track, name)[0] for name in FIRST}
    assert values == pytest.approx(FIRST | expected, nan_ok=True)


def test_only_the_autopilot_of_the_vehicle_counts_and_only_with_a_fix() -> None:
    others = [position(1.0, ids=ids) for ids in ((2, 1), (1, 195), (255, 190))]
    assert len(flight(*others, 2.0).track) == 1
    assert len(flight(*others, 2.0, system_id=None).track) == 2
    without = [position(4.0, lat=0, lon=0), position(5.0, lat=2_000_000_000)]
    found = flight(position(1.0, lat=0, lon=0), 3.0, *without)  # at first nobody has one
    assert (found.track.t_s.tolist(), found.left_out) == ([3.0], 2)
    none = flight(entries=[begun("holding", 1.0)])
    assert (len(none.track), none.segments(), none.places_nea_m.shape) == (0, [], (0, 3))
    assert {each.kind for each in features_of(none)} <= {"target", "radar"}


def header(**more: Any) -> noted.Header:
    facts = {"version": 1, "mission": "m", "seed": 1, "profile": "flight", "lockstep": True}
    return noted.Header(**{"schema": "companion-journal", **facts, **more})


def begun(name: str, time_s: float) -> noted.Phase:
    reason = "x" if name == "holding" else None
    return noted.Phase(time_s=time_s, phase=name, was="", reason=reason, code=None)


TRACKS = {
    "after a reboot times count from the new boot": (
        (99.0, 100.0, 101.0, 0.5, 0.6),
        [
            *(begun("flying", 100.0), events.Rebooted(time_s=0.4)),
            *(begun("preparing", 0.4), begun("holding", 0.6)),
        ],
        "99.0 waiting, 100.0 flying, 101.0 flying, 0.5 preparing, 0.6 holding, reboot at 101.0, "
        "hold at 0.6",
    ),
    "a reboot while no companion ran is seen by the clock": (
        (1000.0, 1001.0, 5.0),
        [header(), begun("flying", 1000.0), header(resumed=1), begun("preparing", 5.0)],
        "1000.0 flying, 1001.0 flying, 5.0 preparing",
    ),
    # it waited nine seconds for a vehicle that had been on for two
    "before it knew the clock it counts from the first position": (
        (2.0, 3.0),
        [begun("preparing", 9.0), begun("arming", 3.0)],
        "2.0 waiting, 3.0 arming",
    ),
    "a reboot before the first fix counts, too": (
        (position(50.0, lat=0, lon=0), 2.0, 3.0),
        [begun("preparing", 50.0), events.Rebooted(time_s=1.0), begun("flying", 3.0)],
        "2.0 preparing, 3.0 flying, reboot at 2.0",
    ),
    "a single fall of the clock is a mistake": (
        (100.0, 100.1, 3.0, 100.2, 100.3),
        [],
        "100.0 waiting, 100.1 waiting, 100.2 waiting, 100.3 waiting",
    ),
    "positions in no order are no reboot": (
        (5.0, 4.5, 5.1),
        [],
        "5.0 waiting, 4.5 waiting, 5.1 waiting",
    ),
}


@pytest.mark.parametrize("what", TRACKS)
def test_phases_and_moments_are_those_of_their_times_and_boots(what: str) -> None:
    times_s, entries, told = TRACKS[what]
    found = flight(*times_s, entries=entries)
    decided = zip(found.track.t_s, found.decided_at(found.times_s), strict=True)
    words = [f"{t_s:.1f} {each.phase}" for t_s, each in decided]
    at = ((m.what, found.track.t_s[found.row_at(m.time_s)]) for m in found.moments)
    assert ", ".join([*words, *(f"{kind} at {t_s:.1f}" for kind, t_s in at)]) == told
    parts = [(name, part.start, part.stop) for name, part in found.segments()]
    assert sum(stop - start for _, start, stop in parts) == len(found.track)


def test_legs_of_the_way_back_are_not_those_of_a_plan() -> None:
    lines = (GOLDENS / "copter-goes-back/decisions.jsonl").read_text("utf-8").splitlines()
    told = [each for each in map(json.loads, lines) if each.get("kind") in ("plan ready", "leg")]
    entries = [noted.entry_of(each) for each in told]
    assert [each.number for each in entries if isinstance(each, noted.LegBegun)] == [1, 2, 3, 4]
    planned = flight(50.0, 130.0, entries=[header(), *entries]).planned
    assert [(each.plan.plan_id, each.leg) for each in planned] == [(1, 1), (2, 2)]
