"""What each line of a timeline asks for, and when; what a client sees of it in flight.

What a sensor or a link makes of it is in the tests of these.
"""

import functools
import math
import re
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from harness import GCS, KINDS, Rig, copied, flying, heartbeat, setpoint
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.cli import bundled_worlds
from vehicle_sim.errors import InputError
from vehicle_sim.faults import COMPANION_OFF, FAULTS, Timeline, conditions_of, entries
from vehicle_sim.geodesy import FloatArray, LocalFrame, metres_per_degree
from vehicle_sim.in_process import vehicle
from vehicle_sim.parameters import Firmware
from vehicle_sim.plans import PlanKind
from vehicle_sim.world import VehicleKind

S = 1_000_000
approx = pytest.approx

ASKS: dict[str, tuple[str, dict[str, Any]]] = {
    "gps_off": ("gps", {"enabled": False}),
    "gps_glitch 50 m north 10 m down": ("gps", {"glitch_m": (50.0, 0.0, -10.0)}),
    "gps_glitch 5 m east 3 m south": ("gps", {"glitch_m": (-3.0, 5.0, 0.0)}),
    "gps_drift 2 m/s west": ("gps", {"drift_m_s": (0.0, -2.0, 0.0)}),
    "gps_jam": ("gps", {"jammed": True}),
    "gps_noise 3 m": ("gps", {"sigma_m": 3.0}),
    "gps_delay 400 ms": ("gps", {"lag_s": 0.4}),
    "gps_satellites 5": ("gps", {"satellites": 5}),
    "wind 8 m/s from 90 deg": ("wind", {"speed_m_s": 8.0, "from_rad": math.pi / 2}),
    "wind 8 m/s from 180 deg turbulence 2 rising 9 deg": (
        "wind",
        {"speed_m_s": 8.0, "turbulence_m_s": 2.0, "rising_rad": math.pi / 20},
    ),
    "turbulence 4 m/s": ("wind", {"turbulence_m_s": 4.0}),
    "battery 15 %": ("battery", {"most": 0.15}),
    "battery_voltage 10.5 V": ("battery", {"voltage_v": 10.5}),
    "link_off": ("link", {"off": True}),
    "link_off on link 2": ("link", {"off": True, "only": 2}),
    "link_loss 20 % to_vehicle": ("link", {"lost": 0.2, "way": "to_vehicle"}),
    "link_delay 300 ms jitter 50 ms from_vehicle on link 1": (
        "link",
        {"delay_us": 300_000, "jitter_us": 50_000, "way": "from_vehicle", "only": 1},
    ),
    "link_duplication 20 %": ("link", {"duplicated": 0.2}),
    "rangefinder_off": ("autopilot", {"rangefinder_off": True}),
    "setpoints_ignored": ("autopilot", {"setpoints_ignored": True}),
}


def asked(text: str, at_s: float = 0.0) -> Any:
    """The conditions that a timeline asks for at a time, without any parameter."""
    timeline = Timeline(text)
    timeline.step(round(at_s * S))
    return conditions_of({}, timeline.lasting)


# --- each fault -----------------------------------------------------------------------------------


def test_every_fault_is_in_a_table() -> None:
    seen = {line.split()[0] for line in (*ASKS, *SEES, "reboot")}
    lasting = {fault.name for fault in FAULTS if not fault.once} - {COMPANION_OFF}
    assert {fault.name for fault in FAULTS if fault.once} == seen - lasting
    assert {name.split("_")[0] for name in lasting - seen} == {"radar", "lidar"}  # in their tests


@pytest.mark.parametrize("line", ASKS)
def test_a_fault_asks_for_what_it_says_while_it_lasts_and_for_nothing_else(line: str) -> None:
    usual, (group, fields) = asked(""), ASKS[line]
    times_s = (0.99, 1.0, 2.99, 3.0)
    before, first, last, after = (asked(f"at 1 s for 2 s: {line}", at_s) for at_s in times_s)
    assert before == after == usual
    assert first == last != usual
    expected = getattr(usual, group)._replace(**fields)._asdict()
    for key, value in expected.items():
        assert getattr(getattr(first, group), key) == approx(value), key
    assert first._replace(**{group: getattr(usual, group)}) == usual


# --- the timeline ---------------------------------------------------------------------------------

OVERLAPPING = """at 2 s: turbulence 1 m/s
at 4 s for 6 s: turbulence 2 m/s
at 1 s for 7 s: turbulence 3 m/s
at 4 s for 2 s: radar_noise 4 m
at 4 s for 3 s: turbulence 5 m/s"""


@pytest.mark.parametrize("strides", [(1,) * 12, (4, 3, 5), (6, 6)])
def test_of_faults_that_set_the_same_the_last_begun_counts(strides: tuple[int, ...]) -> None:
    """And one that is added begins now."""
    timeline, now_s = Timeline(OVERLAPPING), 0
    turbulence = [0, 3, 1, 1, 5, 5, 5, 2, 2, 2, 1, 1, 1]
    for stride in strides:
        now_s += stride
        timeline.step(now_s * S)
        seen = conditions_of({}, timeline.lasting)
        assert seen.wind.turbulence_m_s == turbulence[now_s]
        assert seen.radar.noise_m == (4.0 if 4 <= now_s < 6 else 0.0)
    for line, lasts in (("for 3 s: turbulence 6 m/s", 6), ("turbulence 7 m/s", 7)):
        timeline.add(line, now_s * S)
        assert timeline.next_us == now_s * S
        timeline.step((now_s + 2) * S)
        assert conditions_of({}, timeline.lasting).wind.turbulence_m_s == lasts


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("gps_off", 'reads "at TIME: FAULT"'),
        *((f"at {bad}: gps_off", "TIME with its unit") for bad in ("120", "-5 s", "1e400 s")),
        ("at 5 s for 0 s: gps_off", "lasts no time"),
        *(("at 5 s: gps_of", "Did you mean gps_off"), ("at 5 s: zebra", "Choose from: gps_off")),
        (f"at 5 s: ground_command {'1' * 300}x", 'reads "ground_command'),  # and at once
        ("at 5 s: wind 8 m/s from 400 deg", "400 must lie from -360 to 360"),
        ("at 5 s: link_off on link 24", "24 must lie from 0 to 23"),
        ("at 5 s for 3 s: reboot", "happens once"),
        ("at 5 s: companion_off", "lasts a time"),
        ("at 5 s: gps_glitch 20 m north 2000000 m up", "must lie from 0 to 100000"),
    ],
)
def test_a_bad_line_says_where_what_and_what_to_do(line: str, message: str) -> None:
    began_s = time.process_time()
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        entries(f"# a comment\nat 1 s: gps_off\n{line}\n", name="faults.txt")
    assert time.process_time() - began_s < 1.0
    assert caught.value.field == "faults.txt:3"
    assert re.search(r"[.?]$", str(caught.value))


def test_without_a_companion_none_can_be_killed() -> None:
    """A campaign kills its own, and the vehicle flies by the other lines."""
    text = "at 1 s: gps_off\nat 1 s for 2 s: companion_off\nat 2 s: zebra"
    with pytest.raises(InputError, match=r"timeline:2 = .*only campaigns fly one"):
        Timeline(text.replace("zebra", "gps_jam"))
    with pytest.raises(InputError, match="faults:3 = 'zebra'"):
        vehicle(bundled_worlds()["forest"], seed=1, faults=text)


@given(
    text=st.text(max_size=80), prefix=st.sampled_from(["", "at ", "at 1 s: ", "at 1 s: wind 5 "])
)
def test_any_text_is_a_timeline_or_an_input_error(text: str, prefix: str) -> None:
    with suppress(InputError):
        asked(prefix + text, 2.0)


# --- in flight ------------------------------------------------------------------------------------


@copied
def under_way(firmware: str) -> Rig:
    """Northwards by setpoints, at 5 m/s."""
    it = flying(firmware, "copter")
    for number in (49, 32):
        it.command(511, number, 100_000)
    it.streamed = setpoint(None, (5.0, 0.0, 0.0))
    it.run(1.0)
    assert firmware != "px4" or it.set_mode("Offboard") == 0
    return it.run(5.0)


@functools.cache
def flown(firmware: Firmware, line: str = "turbulence 0 m/s") -> Rig:
    """Four seconds on with a fault, or with none."""
    it = under_way(firmware)
    it.heard.clear()
    it.fault(line)
    return it.run(4.0)


def moved_m(a: Rig, b: Rig) -> FloatArray:
    """How far from the one the other begins in the local frame: north, east, down."""
    one, other = (it.said("LOCAL_POSITION_NED")[0] for it in (a, b))
    return np.array((other.x - one.x, other.y - one.y, other.z - one.z))


def fence_ahead_m(it: Rig) -> tuple[float, float]:
    """How far its first item lies to the north and east of where it was put."""
    here = under_way(it.firmware).vehicle
    frame = LocalFrame(latitude_deg=here.latitude_deg, longitude_deg=here.longitude_deg)
    (there,) = it.simulation.plans[PlanKind.FENCE]
    return frame.to_local(there.x / 1e7, there.y / 1e7)


def mode(it: Rig) -> int:
    return int(it.last("HEARTBEAT").custom_mode)


SEES: dict[str, Callable[[Rig, Rig], object]] = {
    # without and with the fault: something true if it can be seen
    "setpoints_ignored": lambda a, b: (  # PX4 leaves OFFBOARD, ArduPilot stays
        a.ned_m[0] > b.ned_m[0] + 0.1 and (mode(a) == mode(b)) == (mode(a) < 1 << 16)
    ),
    "link_loss 100 % to_vehicle": lambda a, b: (
        a.ned_m[0] > b.ned_m[0] + 0.1 and len(b.all("ATTITUDE")) == len(a.all("ATTITUDE"))
    ),
    "link_loss 100 % from_vehicle": lambda a, b: a.heard and not b.heard,
    "estimator_reset 20 m north": lambda a, b: moved_m(a, b) == approx([20, 0, 0], abs=1),
    "origin_move 20 m north 3 m up": lambda a, b: (
        moved_m(a, b) == approx([-20, 0, 3], abs=1.0)
        and [b.last("GPS_GLOBAL_ORIGIN").latitude - a.last("GPS_GLOBAL_ORIGIN").latitude]
        == approx([20.0 / metres_per_degree(47.0)[0] * 1e7], abs=10.0)
    ),
    "pilot": lambda a, b: mode(a) != mode(b),
    "ground_command 176 1 2 to_autopilot": lambda a, b: mode(a) != mode(b),
    "ground_command 193 1 2 3": lambda _, b: (
        [(m.command, m.param1, m.param2, m.param3) for m in b.said("COMMAND_LONG", GCS)]
        == [(193, 1.0, 2.0, 3.0)]
    ),
    "ground_target 50 m north 20 m west": lambda a, b: (
        not a.all("COMMAND_INT") and [m.command for m in b.said("COMMAND_INT", GCS)] == [192]
    ),
    "ground_fence 20 m 60 m ahead": lambda a, b: (
        not a.simulation.plans[PlanKind.FENCE] and fence_ahead_m(b) == approx((60.0, 0.0), abs=3.0)
    ),
}


@pytest.mark.parametrize("firmware", ["ardupilot", "px4"])
@pytest.mark.parametrize("line", SEES)
def test_a_client_sees_the_fault(firmware: Firmware, line: str) -> None:
    assert SEES[line](flown(firmware), flown(firmware, line))


@pytest.mark.sample(4)
@pytest.mark.parametrize(("firmware", "kind"), KINDS[::-1])
def test_two_runs_with_all_faults_say_the_same_bytes(firmware: Firmware, kind: VehicleKind) -> None:
    """Every fault, half a second after one another, three seconds each; the reboot last."""
    radar = ("blind", "drop 30 %", "off", "loss 50 %", "noise 5 m", "delay 450 ms", "rate 1 Hz")
    lines = [f"for 3 s: {each}" for each in (*ASKS, *(f"radar_{each}" for each in radar))]
    lines += [each for each in (*SEES, "reboot") if "link" not in each and "ignored" not in each]

    def run() -> tuple[list[tuple[float, int, bytes]], list[str]]:
        scanner = {"component_id": 100, "range_m": 2000.0}
        it = Rig(firmware, kind, links=2, scanner=scanner, seed=7)
        it.source, it.beat = GCS, heartbeat(mavlink.MAV_TYPE_GCS)
        it.climb(30.0)
        for number in (1, 24, 30, 32, 33, 85, 147, 193):
            it.command(511, number, 20_000)
        south_west = round((it.home[0] - 5e-3) * 1e7), round((it.home[1] - 8e-3) * 1e7)
        asked = mavlink.MAVLink_terrain_request_message(*south_west, 30, 0xF0F)
        for line in lines:
            it.fault(line)
            it.send(asked)
            it.run(0.5)
        assert it.all("TERRAIN_DATA")
        out = [(heard.at_s, heard.link, heard.frame) for heard in it.heard]
        return out, list(it.simulation.take_truth())

    first, again = run(), run()
    assert first == again
    assert len(first[0]) > 3000
