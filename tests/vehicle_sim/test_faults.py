"""The timeline against a brute-force replay, and every fault that there is."""

import math
import re

import numpy as np
import pytest
from fault_lines import LINES
from harness import GENTLE
from hypothesis import given
from hypothesis import strategies as st

from vehicle_sim.autopilot.values import Battery
from vehicle_sim.conditions import (
    SIM_PARAMETERS,
    SIM_PARAMETERS_PX4,
    Conditions,
    conditions_of,
    take_one_shots,
)
from vehicle_sim.dynamics.battery import PowerModule
from vehicle_sim.dynamics.copter import Copter
from vehicle_sim.dynamics.wind import Wind
from vehicle_sim.errors import InputError
from vehicle_sim.faults import FAULTS, Timeline, faults_page
from vehicle_sim.parameters import Firmware, Kind, Parameter, Parameters
from vehicle_sim.sensors.gps import ARDUCOPTER, PX4, Gps

TABLES: dict[Firmware, tuple[Parameter, ...]] = {
    "ardupilot": SIM_PARAMETERS,
    "px4": SIM_PARAMETERS_PX4,
}
S = 1_000_000


def parameters(firmware: Firmware = "ardupilot", **overrides: float) -> Parameters:
    return Parameters(TABLES[firmware], overrides)


def run(timeline: Timeline, values: Parameters, until_s: float, step_us: int = 10_000) -> None:
    for now_us in range(0, round(until_s * S) + 1, step_us):
        for name, value in timeline.step(now_us, values):
            values[name] = value


def after(text: str, firmware: Firmware = "ardupilot") -> Conditions:
    """What there is while this fault lasts."""
    values = parameters(firmware)
    run(Timeline.parse(f"at 0 s: {text}", firmware=firmware, latitude_deg=47.0), values, 0.0)
    return conditions_of(values)


# --- the parameters -------------------------------------------------------------------------------


@pytest.mark.parametrize("firmware", TABLES)
def test_names_fit_their_field_and_are_there_once(firmware: Firmware) -> None:
    names = [row.name for row in TABLES[firmware]]
    assert len(set(names)) == len(names)
    assert all(name.startswith("SIM_") and len(name) <= 16 for name in names)
    kinds = {row.kind for row in TABLES[firmware]}
    assert firmware == "ardupilot" or kinds <= {Kind.INT32, Kind.REAL32}  # PX4 knows no others


@pytest.mark.parametrize("firmware", TABLES)
def test_nothing_is_wrong_by_default(firmware: Firmware) -> None:
    conditions = conditions_of(parameters(firmware))
    assert conditions.gps.enabled
    assert not conditions.link.any
    assert conditions.wind.speed_m_s == conditions.wind.turbulence_m_s == 0.0
    assert not conditions.setpoints_ignored
    radar = conditions.radar
    assert radar == type(radar)()
    assert conditions.battery.most == 1.0


def test_a_table_without_simulation_parameters_is_fair_weather() -> None:
    assert conditions_of({}) == conditions_of(parameters())


def test_gps_parameters_are_those_of_the_recorded_flight() -> None:
    """arducopter-gps-loss.tlog: SIM_GPS1_GLTCH_X 0.00045, later SIM_GPS1_ENABLE 0."""
    values = parameters(SIM_GPS1_GLTCH_X=0.00045)
    assert conditions_of(values).gps.glitch_latitude_deg == 0.00045
    values["SIM_GPS1_ENABLE"] = 0
    assert not conditions_of(values).gps.enabled


@pytest.mark.parametrize(("used", "enabled"), [(0, False), (3, False), (4, True), (10, True)])
def test_px4_has_no_fix_with_fewer_than_four_satellites(used: int, *, enabled: bool) -> None:
    gps = conditions_of(parameters("px4", SIM_GPS_USED=used)).gps
    assert (gps.enabled, gps.satellites) == (enabled, used)


def test_what_happens_once_happens_once() -> None:
    values = parameters(SIM_EKF_RST_N=20, SIM_ORG_MOV_U=-3, SIM_PILOT=1, SIM_REBOOT=1)
    assert list(take_one_shots(values)) == [
        ("estimator_reset", (20.0, 0.0)),
        ("origin_move", (0.0, 0.0, -3.0)),
        ("pilot", (1.0,)),
        ("reboot", (1.0,)),
    ]
    assert list(take_one_shots(values)) == []
    values["SIM_PILOT"] = 1
    assert list(take_one_shots(values)) == [("pilot", (1.0,))]


@pytest.mark.parametrize("firmware", TABLES)
@given(data=st.data())
def test_no_value_of_any_parameter_leads_off_the_earth(
    firmware: Firmware, data: st.DataObject
) -> None:
    """Receiver, wind and battery stay finite and in range whatever is set."""
    values = parameters(firmware)
    wild = st.floats(width=32) | st.sampled_from([math.inf, -math.inf, math.nan, 1e38, -1e38])
    for name in data.draw(st.lists(st.sampled_from([row.name for row in TABLES[firmware]]))):
        value = data.draw(wild)
        if math.isfinite(value) or values.row(name).kind is Kind.REAL32:
            values[name] = value
    take_one_shots(values)
    conditions = conditions_of(values)
    rng = np.random.default_rng(1)
    gps, wind = Gps(ARDUCOPTER if firmware == "ardupilot" else PX4, rng), Wind(rng)
    power = PowerModule(Battery(), "ardupilot copter" if firmware == "ardupilot" else "px4")
    copter = Copter(
        latitude_deg=47.0, longitude_deg=179.9, altitude_amsl_m=50.0, limits=GENTLE, drag_1_s=0.5
    )
    for now_us in range(9_700_000, 11_000_000, 50_000):
        wind.step(0.05, copter, conditions.wind, 0.0)
        copter.advance(0.0, 0.0, 0.0, 0.05)
        power.step(0.05, copter, armed=True, conditions=conditions.battery)
        fix = gps.step(now_us, copter, conditions.gps)
        assert abs(fix.latitude_deg) <= 90.0
        assert abs(fix.longitude_deg) <= 180.0
        assert abs(fix.altitude_amsl_m) < 1e6
        assert 0 <= fix.fix_type <= 6
        assert 0 <= fix.satellites <= 50
        assert abs(fix.velocity_north_m_s) < 5000.0
        assert abs(copter.wind_north_m_s) + abs(copter.wind_up_m_s) < 1000.0
        assert 0.0 <= power.battery.remaining <= 1.0
        assert 0.0 <= power.battery.voltage_v < 100.0


# --- each fault -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", LINES)
@pytest.mark.parametrize("firmware", TABLES)
def test_a_fault_sets_what_the_documentation_says_and_gives_it_back(
    name: str, firmware: Firmware
) -> None:
    fault = next(fault for fault in FAULTS if fault.name == name)
    text = f"at 1 s: {LINES[name]}"
    if fault.only not in (None, firmware):
        with pytest.raises(InputError, match=f"is for {fault.only}"):
            Timeline.parse(text, firmware=firmware)
        return
    values, before = parameters(firmware), parameters(firmware).values()
    run(Timeline.parse(text, firmware=firmware), values, 2.0)
    changed = {key for key, value in values.values().items() if value != before[key]}
    assert changed
    assert name == "set" or changed <= set(fault.values)
    assert (
        conditions_of(values) != conditions_of(parameters(firmware))
        or name == "set"
        or (fault.once and take_one_shots(values))
    )
    if not fault.once:
        values = parameters(firmware)
        run(Timeline.parse(text.replace("1 s:", "1 s for 2 s:")), values, 4.0)
        assert values.values() == before


def test_faults_mean_what_they_say() -> None:
    assert not after("gps_off").gps.enabled
    assert not after("gps_off", "px4").gps.enabled
    drift = after("gps_drift 2 m/s down").gps
    assert (drift.drift_north_m_s, drift.drift_up_m_s) == (0.0, -2.0)
    assert after("gps_satellites 5").gps.satellites == 5
    wind = after("wind 8 m/s from 270 deg turbulence 2 m/s rising 10 deg").wind
    assert wind.from_rad == pytest.approx(1.5 * math.pi)
    assert (wind.speed_m_s, wind.turbulence_m_s) == (8.0, 2.0)
    assert wind.rising_rad == pytest.approx(math.radians(10.0))
    assert after("wind 8 m/s from 270 deg").wind.turbulence_m_s == 0.0
    assert after("link_loss 20 %").link.lost == pytest.approx(0.2)
    late = after("link_delay 300 ms jitter 50 ms from_vehicle on link 2").link
    assert (late.delay_us, late.jitter_us, late.mask) == (300_000, 50_000, 4)
    assert (late.to_vehicle, late.from_vehicle) == (False, True)
    both = after("link_off").link
    assert (both.off, both.to_vehicle, both.from_vehicle, both.mask) == (True, True, True, 0)
    assert after("radar_noise 5 m").radar.noise_m == 5.0
    assert after("radar_noise 5 m either_way").radar.noise_m == -5.0
    assert after("radar_blind").radar.blind
    assert after("battery 15 %").battery.most == pytest.approx(0.15)
    assert after("setpoints_ignored").setpoints_ignored


@pytest.mark.parametrize("latitude_deg", [0.0, -35.4, 47.0, 60.0])
def test_a_glitch_in_metres_is_that_far_on_the_ellipsoid(latitude_deg: float) -> None:
    from pyproj import Geod

    values = parameters()
    text = "at 0 s: gps_glitch 50 m north 30 m west"
    run(Timeline.parse(text, latitude_deg=latitude_deg), values, 0.0)
    gps = conditions_of(values).gps
    _, _, away_m = Geod(ellps="WGS84").inv(
        8.0, latitude_deg, 8.0 + gps.glitch_longitude_deg, latitude_deg + gps.glitch_latitude_deg
    )
    assert away_m == pytest.approx(math.hypot(50.0, 30.0), abs=0.01)
    assert gps.glitch_longitude_deg < 0.0 < gps.glitch_latitude_deg


# --- the timeline ---------------------------------------------------------------------------------


def test_a_fault_lasts_as_long_as_it_says() -> None:
    timeline = Timeline.parse("at 120 s for 30 s: gps_off  # as in the recorded flight\n\n# end\n")
    values = parameters()
    seen = {}
    for now_us in range(0, 200 * S, 10_000):
        for name, value in timeline.step(now_us, values):
            seen[now_us] = (name, value)
    assert seen == {120 * S: ("SIM_GPS1_ENABLE", 0.0), 150 * S: ("SIM_GPS1_ENABLE", 1.0)}


def test_the_last_one_begun_counts_and_the_first_value_comes_back() -> None:
    text = """
    at 10 s for 30 s: wind 5 m/s from 0 deg
    at 20 s for 10 s: wind 9 m/s from 90 deg
    at 25 s for 100 s: turbulence 3 m/s
    """
    timeline, values = Timeline.parse(text), parameters(SIM_WIND_SPD=1, SIM_WIND_TURB=0.5)
    expected = {5: (1.0, 0.5), 15: (5.0, 0.0), 22: (9.0, 0.0), 27: (9.0, 3.0), 35: (5.0, 3.0)}
    expected |= {45: (1.0, 3.0), 130: (1.0, 0.5)}
    got = {}
    for second in range(131):
        for name, value in timeline.step(second * S, values):
            values[name] = value
        if second in expected:
            got[second] = (values["SIM_WIND_SPD"], values["SIM_WIND_TURB"])
    assert got == expected


def test_a_fault_that_stays_is_not_ended_by_one_before_it() -> None:
    text = "at 10 s for 20 s: wind 5 m/s from 0 deg\nat 15 s: wind 9 m/s from 0 deg"
    values = parameters()
    run(Timeline.parse(text), values, 40.0)
    assert values["SIM_WIND_SPD"] == 9.0


def test_what_was_set_from_outside_before_a_fault_comes_back_after_it() -> None:
    timeline, values = Timeline.parse("at 10 s for 5 s: wind 5 m/s from 0 deg"), parameters()
    values["SIM_WIND_SPD"] = 2.5  # by PARAM_SET, at 0 s
    run(timeline, values, 20.0)
    assert values["SIM_WIND_SPD"] == 2.5


def test_faults_may_be_added_on_the_way() -> None:
    timeline, values = Timeline.parse("at 3 s for 10 s: wind 5 m/s from 0 deg"), parameters()
    run(timeline, values, 5.0)
    timeline.add("for 2 s: wind 9 m/s from 0 deg", 6 * S)
    timeline.add("gps_jam", 6 * S)
    assert timeline.next_us == 6 * S
    got = []
    for second in range(6, 15):
        for name, value in timeline.step(second * S, values):
            values[name] = value
        got.append(values["SIM_WIND_SPD"])
    assert got == [9.0, 9.0, 5.0, 5.0, 5.0, 5.0, 5.0, 0.0, 0.0]
    assert values["SIM_GPS1_JAM"] == 1.0


LINE = st.tuples(
    st.integers(0, 30),
    st.none() | st.integers(1, 15),
    st.sampled_from(["SIM_WIND_SPD", "SIM_WIND_TURB", "SIM_LNK_LOSS"]),
    st.integers(1, 40),
)


@given(lines=st.lists(LINE, max_size=8), stride=st.integers(1, 7))
def test_any_overlap_is_what_a_replay_from_the_start_says(
    lines: list[tuple[int, int | None, str, int]], stride: int
) -> None:
    def text(line: tuple[int, int | None, str, int]) -> str:
        at, length, name, value = line
        for_how_long = "" if length is None else f" for {length} s"
        return f"at {at} s{for_how_long}: set {name} {value}"

    def expected(name: str, now: int) -> float:
        """The line that began last of those that last now or for ever."""
        begun = [
            (at, number, value)
            for number, (at, length, which, value) in enumerate(lines)
            if which == name and at <= now and (length is None or now < at + length)
        ]
        return float(max(begun)[2]) if begun else 0.0

    timeline, values = Timeline.parse("\n".join(map(text, lines))), parameters()
    for now in range(0, 60, stride):
        for name, value in timeline.step(now * S, values):
            values[name] = value
        for name in ("SIM_WIND_SPD", "SIM_WIND_TURB", "SIM_LNK_LOSS"):
            assert values[name] == expected(name, now)


BAD = [
    ("at 120 s gps_off", 'reads "at TIME: FAULT"'),
    ("gps_off", 'reads "at TIME: FAULT"'),
    ("at 120: gps_off", "names its unit"),
    ("at soon: gps_off", "is not a time"),
    ("at -5 s: gps_off", "lies outside the run"),
    ("at 1e400 s: gps_off", "is not a time"),
    ("at 5 s for 0 s: gps_off", "lasts no time"),
    ("at 5 s: gps_of", "Did you mean gps_off"),
    ("at 5 s: zebra", "Choose from: gps_off"),
    ("at 5 s: wind 8 from 270 deg", 'reads "wind SPEED m/s from DIRECTION deg'),
    ("at 5 s: wind 800 m/s from 270 deg", "SPEED must lie from 0 to 100"),
    ("at 5 s: wind nan m/s from 270 deg", "reads"),
    ("at 5 s: link_loss 120 %", "PERCENT must lie from 0 to 100"),
    ("at 5 s: link_loss 20", 'reads "link_loss PERCENT %'),
    ("at 5 s for 3 s: reboot", "happens once"),
    ("at 5 s: set SIM_WIND_SPED 4", "Did you mean SIM_WIND_SPD"),
    ("at 5 s: set WPNAV_SPEED 4", "has no such parameter"),
    ("at 5 s: estimator_reset 20 m up", "reads"),
]


@pytest.mark.parametrize(("line", "message"), BAD)
def test_a_bad_line_says_where_what_and_what_to_do(line: str, message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        Timeline.parse(f"# a comment\nat 1 s: gps_off\n{line}\n", name="faults.txt")
    assert caught.value.field == "faults.txt:3"
    assert re.search(r"[.?]$", str(caught.value))


@given(text=st.text(max_size=80))
def test_any_text_is_a_timeline_or_an_input_error(text: str) -> None:
    for prefix in ("", "at 1 s: ", "at 1 s: wind 5 m/s from ", "at "):
        try:
            timeline = Timeline.parse(prefix + text)
        except InputError:
            continue
        run(timeline, parameters(), 2.0, 500_000)


def test_case_and_spaces_do_not_matter() -> None:
    texts = ["AT 1 S : WIND 8m/s FROM 270deg", "at 1s: wind  8 m/s  from 270 deg"]
    made = [Timeline.parse(text).entries[0].sets for text in texts]
    assert made[0] == made[1]


def test_the_page_of_the_documentation_has_every_fault() -> None:
    rows = [row for row in faults_page().splitlines() if row.startswith("| `")]
    assert all(len(re.split(r"(?<!\\)\|", row)) == 5 for row in rows)
    for fault, row in zip(FAULTS, rows, strict=True):
        assert row.startswith(f"| `{fault.name}")
