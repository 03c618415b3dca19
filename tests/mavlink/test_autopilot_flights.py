"""Each strategy drives the simulated vehicle that it is for: up, along, stop, on, down.

Tolerances are what was measured, and a little more; see docs on `vehicle.tracking_error_m`.
"""

import functools
import math

import pytest
from driver import SYSTEM, Driver, Firmware, Flight, Kind, Route, airborne

from companion.mission.events import (
    Estimator,
    GpsFix,
    Landed,
    Mode,
    VehicleStatus,
)

Who = tuple[Firmware, Kind]
COPTERS: tuple[Who, ...] = (("ardupilot", "copter"), ("px4", "copter"))
PLANES: tuple[Who, ...] = (("ardupilot", "plane"), ("px4", "plane"))
V = {("ardupilot", "plane"): 21.0, ("px4", "plane"): 14.0}
COPTER_M_S = 8.0
HEADING_RAD = 0.3
RIGHT = (-math.sin(HEADING_RAD), math.cos(HEADING_RAD))
each = pytest.mark.parametrize("who", [*COPTERS, *PLANES], ids="-".join)


def speed(who: Who) -> float:
    return V.get(who, COPTER_M_S)


def straight(driver: Driver, length_m: float, ahead_m: float = 0.0) -> Route:
    """From where it is, or a little ahead of there."""
    north, east, altitude = driver.here
    north += ahead_m * math.cos(HEADING_RAD)
    east += ahead_m * math.sin(HEADING_RAD)
    return Route.of((north, east, altitude), HEADING_RAD, [(length_m, 0.0)])


def weaving(driver: Driver, v: float, lateral_m_s2: float, lead_in_m: float) -> Route:
    """A straight way in, then arcs to the left and to the right."""
    curvature = lateral_m_s2 / v**2
    arc_m = 0.9 / curvature
    arcs = [(arc_m, sign * curvature) for sign in (1, -1, -1, 1, 1, -1)]
    return Route.of(driver.here, HEADING_RAD, [(lead_in_m, 0.0), *arcs, (lead_in_m, 0.0)])


def guided(who: Who) -> Driver:
    """In the air; in guided mode already, if that can be without setpoints."""
    driver = airborne(*who)
    if who[0] == "px4":
        driver.simulation.set_parameter("COM_OBL_RC_ACT", 5)
    else:
        driver.ask_mode(Mode.GUIDED)
        driver.send(driver.pilot.set_speed(speed(who) - 1.0, SYSTEM))
    return driver


@functools.cache
def _cruising(who: Who) -> tuple[Driver, Flight]:
    driver = guided(who)
    length_m = 250.0 if who in COPTERS else 750.0
    skip_m = 150.0 if who in COPTERS else 500.0
    flight = driver.follow(straight(driver, length_m), speed(who), skip_m=skip_m)
    return driver, flight


def cruising(who: Who) -> Driver:
    """In the middle of a straight stream, at speed; the stream still runs."""
    return _cruising(who)[0].copy()


def along_m(driver: Driver, start_nea_m: tuple[float, float, float]) -> tuple[float, float]:
    """How far on, and how far to the right, of a point."""
    north = driver.truly[0] - start_nea_m[0]
    east = driver.truly[1] - start_nea_m[1]
    on = north * math.cos(HEADING_RAD) + east * math.sin(HEADING_RAD)
    return on, north * RIGHT[0] + east * RIGHT[1]


def watched(driver: Driver, seconds: float) -> list[tuple[float, float]]:
    """`along_m` of where it is now, ten times a second."""
    start, seen = driver.truly, list[tuple[float, float]]()
    for _ in range(round(10 * seconds)):
        driver.run(0.1)
        seen.append(along_m(driver, start))
    return seen


# --- finding it, and taking off


@each
def test_it_takes_off_in_its_own_way_and_is_above_the_ground_where_it_was_sent(who: Who) -> None:
    driver = airborne(*who)
    assert driver.landed is Landed.IN_AIR
    assert driver.armed
    assert driver.truly[2] - driver.ground_amsl_m == pytest.approx(60.0, abs=6.0)
    if who in COPTERS:
        assert math.hypot(*driver.truly[:2]) < 1.0
    assert not driver.newest[VehicleStatus].failsafe


# --- following


@each
def test_it_follows_a_straight_line(who: Who) -> None:
    _, flight = _cruising(who)
    assert len(flight.off_m) > 50
    assert flight.most_m < (1.0 if who in COPTERS else 3.6)
    if who in COPTERS:
        assert max(flight.behind_m) < 1.0  # neither early nor late


@pytest.mark.parametrize(
    ("who", "lateral_m_s2", "most_m"),
    [
        (COPTERS[0], 1.2, 2.0),
        (COPTERS[1], 1.2, 4.0),
        pytest.param(PLANES[0], 1.0, 6.0, marks=pytest.mark.nightly),
        (PLANES[0], 2.0, 12.0),
        pytest.param(PLANES[1], 1.0, 4.0, marks=pytest.mark.nightly),
        (PLANES[1], 3.5, 6.0),
    ],
)
def test_it_follows_a_curve_and_is_believed_all_the_way(
    who: Who, lateral_m_s2: float, most_m: float
) -> None:
    driver = guided(who)
    driver.events.clear()
    lead_in_m = 150.0 if who in COPTERS else 600.0
    route = weaving(driver, speed(who), lateral_m_s2, lead_in_m)
    flight = driver.follow(route, speed(who), skip_m=lead_in_m)
    assert flight.most_m < most_m
    assert len(flight.off_m) > 100
    checks = [e.good for e in driver.events if isinstance(e, GpsFix | Estimator)]
    assert len(checks) > 100
    assert all(checks)


@each
def test_the_echo_is_the_setpoint_and_px4s_plane_has_none(who: Who) -> None:
    driver, flight = _cruising(who)
    assert bool(flight.echo_off_m) == driver.pilot.traits.reports_target
    settled = flight.echo_off_m[20:]
    assert max(settled, default=0.0) < 0.1


def test_arduplane_flies_as_fast_as_it_is_told() -> None:
    driver = guided(PLANES[0])
    driver.send(driver.pilot.set_speed(17.0, SYSTEM))
    flight = driver.follow(straight(driver, 900.0), 17.0, skip_m=600.0)
    assert flight.speed_m_s == pytest.approx(17.0 * 1.045, abs=0.3)  # true airspeed at 550 m


# --- stopping and going on


@pytest.mark.parametrize(("who", "most_m"), [(COPTERS[0], 6.0), (COPTERS[1], 21.0)])
def test_a_copter_holds_within_its_stopping_distance(who: Who, most_m: float) -> None:
    driver = cruising(who)
    driver.silent()
    driver.set_mode(Mode.HOLD)
    seen = watched(driver, 20.0)
    assert driver.mode is Mode.HOLD
    assert driver.speed_m_s < 0.3
    assert 0.0 < max(on for on, _ in seen) < most_m
    assert max(abs(aside) for _, aside in seen) < 1.5


@pytest.mark.parametrize(
    ("who", "on_m", "aside_m"), [(PLANES[0], 100.0, 115.0), (PLANES[1], 85.0, 85.0)]
)
def test_a_plane_holds_on_a_circle_about_where_it_was_told(
    who: Who, on_m: float, aside_m: float
) -> None:
    driver = cruising(who)
    driver.silent()
    driver.set_mode(Mode.HOLD)
    seen = watched(driver, 80.0)
    assert driver.mode is Mode.HOLD
    assert max(on for on, _ in seen) < on_m
    assert max(abs(aside) for _, aside in seen) < aside_m
    assert min(on for on, _ in seen) < 0.0  # it has come round


def test_px4s_plane_holds_about_a_point() -> None:
    driver = cruising(PLANES[1])
    point = driver.here[0] + 200.0, driver.here[1], driver.here[2]
    driver.silent()
    driver.set_mode(Mode.HOLD, point)
    driver.run(40.0)
    away = [math.dist(driver.truly[:2], point[:2]) for _ in range(400) if driver.run(0.1) is None]
    assert driver.mode is Mode.HOLD
    assert max(away) == pytest.approx(80.0, abs=2.0)
    assert min(away) == pytest.approx(80.0, abs=2.0)


@pytest.mark.parametrize("who", COPTERS, ids="-".join)
def test_a_copter_that_is_told_to_stay_stands_there(who: Who) -> None:
    driver = cruising(who)
    braking_m = COPTER_M_S**2 / (2.0 * 2.0)
    north, east, altitude = driver.here
    north += braking_m * math.cos(HEADING_RAD)
    east += braking_m * math.sin(HEADING_RAD)
    driver.stay((north, east, altitude))
    seen = watched(driver, 20.0)
    assert driver.mode is Mode.GUIDED
    assert max(on for on, _ in seen) < braking_m + 4.0
    assert math.dist(driver.truly, (north, east, altitude)) < 1.0


@pytest.mark.parametrize(
    ("who", "least_m", "most_m"), [(PLANES[0], 85.0, 100.0), (PLANES[1], 0.0, 35.0)]
)
def test_a_plane_that_is_told_to_stay_circles_there(
    who: Who, least_m: float, most_m: float
) -> None:
    """ArduPlane no wider than the loiter radius of the mission, 100 m here."""
    driver = cruising(who)
    place = driver.here
    driver.stay(place)
    driver.run(60.0)
    away = [math.dist(driver.truly[:2], place[:2]) for _ in range(400) if driver.run(0.1) is None]
    assert driver.mode is Mode.GUIDED
    assert least_m <= min(away)
    assert max(away) <= most_m


@pytest.mark.parametrize(
    ("who", "mode", "most_m"),
    [
        (COPTERS[0], Mode.GUIDED, 42.0),
        (COPTERS[1], Mode.HOLD, 22.0),
        (PLANES[0], Mode.GUIDED, 165.0),
        (PLANES[1], Mode.HOLD, 100.0),
    ],
)
def test_how_far_it_flies_on_when_the_stream_ends(who: Who, mode: Mode, most_m: float) -> None:
    """Limits.dead_man_s and the reach that certificates keep clear are made of this."""
    driver = cruising(who)
    driver.silent()
    seen = watched(driver, 40.0)
    assert driver.mode is mode
    assert 0.8 * most_m < max(on for on, _ in seen) < most_m


@each
def test_it_goes_on_after_a_hold(who: Who) -> None:
    driver = cruising(who)
    driver.silent()
    driver.ask_mode(Mode.HOLD)
    driver.run(10.0)
    if who[0] == "ardupilot":
        driver.ask_mode(Mode.GUIDED)
        driver.send(driver.pilot.set_speed(speed(who) - 1.0, SYSTEM))
    skip_m = 100.0 if who in COPTERS else 700.0
    flight = driver.follow(straight(driver, skip_m + 200.0), speed(who), skip_m=skip_m)
    assert flight.most_m < (1.0 if who in COPTERS else 3.6)


# --- whom it obeys


@each
def test_a_pilot_who_takes_the_mode_keeps_it_while_setpoints_go_on(who: Who) -> None:
    driver = cruising(who)
    driver.messages.clear()
    driver.stay(driver.here)
    driver.simulation.add_fault("pilot")
    driver.run(5.0)
    assert driver.mode is Mode.OTHER
    refused = [m for m in driver.messages if driver.pilot.refuses_setpoint(m)]
    assert bool(refused) == (who == PLANES[0])


def test_px4_stays_in_a_commanded_hold_while_setpoints_go_on() -> None:
    driver = cruising(COPTERS[1])
    driver.set_mode(Mode.HOLD)
    driver.run(5.0)
    assert driver.mode is Mode.HOLD


# --- down


@pytest.mark.parametrize("who", [*COPTERS, PLANES[1]], ids="-".join)
def test_it_lands_where_it_is(who: Who) -> None:
    driver = cruising(who)
    driver.silent()
    driver.ask_mode(Mode.LAND)
    driver.until(lambda: driver.landed is Landed.ON_GROUND and not driver.armed, 150.0)
    assert driver.truly[2] == pytest.approx(driver.ground_amsl_m, abs=1.0)


# --- whether it is where it says


@each
@pytest.mark.parametrize("fault", ["gps_glitch 50 m north", "gps_glitch 8 m north", "gps_off"])
def test_it_is_not_believed_before_its_estimate_goes_wrong(who: Who, fault: str) -> None:
    driver = cruising(who)
    north, east, altitude = driver.here
    driver.stay((north, east, altitude))
    assert driver.believed
    driver.simulation.add_fault(f"for 30 s: {fault}")
    behind_m = 0.2 * speed(who) + 3.0  # of a position that is a tick old
    for _ in range(300):
        driver.run(0.1)
        if not driver.believed:
            break
        assert math.dist(driver.here[:2], driver.truly[:2]) < behind_m
    assert not driver.believed
