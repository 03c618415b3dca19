import math

import pytest

from vehicle_sim.dynamics import GRAVITY_M_S2
from vehicle_sim.dynamics.plane import Plane, PlaneLimits
from vehicle_sim.geodesy import LocalFrame

DT_S = 0.01
LATITUDE_DEG, LONGITUDE_DEG = 47.0, 8.0


def plane(heading_deg: float = 0.0, limits: PlaneLimits | None = None) -> Plane:
    return Plane(
        latitude_deg=LATITUDE_DEG,
        longitude_deg=LONGITUDE_DEG,
        altitude_amsl_m=500.0,
        heading_rad=math.radians(heading_deg),
        limits=limits or PlaneLimits(),
    )


def local_m(vehicle: Plane) -> tuple[float, float]:
    frame = LocalFrame(latitude_deg=LATITUDE_DEG, longitude_deg=LONGITUDE_DEG)
    return frame.to_local(vehicle.latitude_deg, vehicle.longitude_deg)


def flown(
    vehicle: Plane,
    seconds: float,
    bank_deg: float = 0.0,
    climb_m_s: float = 0.0,
    airspeed_m_s: float = 20.0,
) -> Plane:
    for _ in range(round(seconds / DT_S)):
        vehicle.advance(math.radians(bank_deg), climb_m_s, airspeed_m_s, DT_S)
    return vehicle


def steady(bank_deg: float = 0.0, airspeed_m_s: float = 20.0, heading_deg: float = 0.0) -> Plane:
    """One that has settled, put back to the start."""
    vehicle = flown(plane(heading_deg), 30.0, bank_deg, 0.0, airspeed_m_s)
    vehicle.latitude_deg, vehicle.longitude_deg = LATITUDE_DEG, LONGITUDE_DEG
    return vehicle


@pytest.mark.parametrize("bank_deg", [-55.0, -30.0, 15.0, 45.0])
@pytest.mark.parametrize("airspeed_m_s", [15.0, 25.0])
def test_a_turn_has_the_radius_of_a_coordinated_turn(bank_deg: float, airspeed_m_s: float) -> None:
    vehicle = steady(bank_deg, airspeed_m_s)
    radius_m = airspeed_m_s**2 / (GRAVITY_M_S2 * math.tan(math.radians(bank_deg)))
    heading = vehicle.heading_rad
    centre_n, centre_e = -radius_m * math.sin(heading), radius_m * math.cos(heading)
    for _ in range(20):
        flown(vehicle, 0.5, bank_deg, 0.0, airspeed_m_s)
        north, east = local_m(vehicle)
        distance_m = math.hypot(north - centre_n, east - centre_e)
        assert distance_m == pytest.approx(abs(radius_m), rel=1e-3)


@pytest.mark.parametrize("heading_deg", [0.0, 90.0, 233.0])
def test_wind_adds_to_the_air_velocity(heading_deg: float) -> None:
    vehicle = steady(heading_deg=heading_deg)
    vehicle.wind_north_m_s, vehicle.wind_east_m_s, vehicle.wind_up_m_s = 3.0, -4.0, 0.5
    flown(vehicle, DT_S)
    heading = math.radians(heading_deg)
    assert vehicle.velocity_north_m_s == pytest.approx(20.0 * math.cos(heading) + 3.0, abs=1e-3)
    assert vehicle.velocity_east_m_s == pytest.approx(20.0 * math.sin(heading) - 4.0, abs=1e-3)
    assert vehicle.velocity_up_m_s == pytest.approx(0.5)
    assert vehicle.airspeed_m_s == pytest.approx(20.0, abs=1e-3)


def test_a_climb_costs_no_airspeed_and_counts_towards_it() -> None:
    vehicle = flown(steady(), 20.0, climb_m_s=4.0)
    assert vehicle.airspeed_m_s == pytest.approx(20.0, abs=1e-3)
    assert vehicle.velocity_up_m_s == pytest.approx(4.0, abs=1e-3)
    flat_m_s = math.hypot(vehicle.velocity_north_m_s, vehicle.velocity_east_m_s)
    assert math.hypot(flat_m_s, vehicle.velocity_up_m_s) == pytest.approx(20.0, abs=1e-3)
    before_m = vehicle.altitude_amsl_m
    flown(vehicle, 10.0, climb_m_s=4.0)
    assert vehicle.altitude_amsl_m - before_m == pytest.approx(40.0, abs=0.01)


def test_nothing_exceeds_its_limit() -> None:
    limits = PlaneLimits(
        airspeed_min_m_s=14.0,
        airspeed_max_m_s=24.0,
        bank_max_rad=math.radians(40.0),
        roll_rate_rad_s=math.radians(60.0),
        climb_max_m_s=3.0,
        sink_max_m_s=2.0,
        acceleration_m_s2=1.5,
    )
    vehicle = plane(limits=limits)
    for sign in (1.0, -1.0, 1.0):
        for step in range(3000):
            roll_rad, airspeed = vehicle.roll_rad, vehicle.airspeed_m_s
            vehicle.advance(sign * 9.0, sign * 99.0, 20.0 + sign * 99.0, DT_S)
            assert abs(vehicle.roll_rad) <= limits.bank_max_rad + 1e-12
            assert abs(vehicle.roll_rad - roll_rad) <= limits.roll_rate_rad_s * DT_S + 1e-12
            assert abs(vehicle.airspeed_m_s - airspeed) <= limits.acceleration_m_s2 * DT_S + 1e-12
            assert -2.0 - 1e-9 <= vehicle.velocity_up_m_s <= 3.0 + 1e-9
            assert 0.0 <= vehicle.throttle <= 1.0, step
    assert vehicle.airspeed_m_s == pytest.approx(24.0, abs=0.01)
    flown(vehicle, 60.0, airspeed_m_s=0.0)
    assert vehicle.airspeed_m_s == pytest.approx(14.0, abs=0.01)


def test_the_run_on_the_runway_is_that_of_constant_acceleration() -> None:
    vehicle = plane(heading_deg=120.0)
    vehicle.wind_north_m_s = -6.0
    for _ in range(500):
        vehicle.roll_on_ground(3.0, DT_S)
    north, east = local_m(vehicle)
    assert math.hypot(north, east) == pytest.approx(0.5 * 3.0 * 5.0**2, rel=1e-3)
    assert math.degrees(math.atan2(east, north)) == pytest.approx(120.0, abs=0.01)
    headwind_m_s = 6.0 * math.cos(math.radians(120.0))
    assert vehicle.airspeed_m_s == pytest.approx(15.0 + headwind_m_s, abs=0.01)
    for _ in range(1000):
        vehicle.roll_on_ground(-3.0, DT_S)
    assert vehicle.velocity_north_m_s == vehicle.velocity_east_m_s == 0.0


def test_lifting_off_in_cross_wind_does_not_jump() -> None:
    vehicle = plane()
    vehicle.wind_east_m_s, vehicle.wind_north_m_s = 7.0, -4.0
    for _ in range(600):
        vehicle.roll_on_ground(3.0, DT_S)
    for _ in range(1000):
        before = vehicle.velocity_north_m_s, vehicle.velocity_east_m_s
        vehicle.advance(0.0, 2.0, 20.0, DT_S)
        change = math.dist(before, (vehicle.velocity_north_m_s, vehicle.velocity_east_m_s))
        assert change < 0.25  # 7 m/s that die away within half a second, and the climb
    assert vehicle.velocity_east_m_s == pytest.approx(7.0, abs=0.01)


def test_touching_down_points_the_nose_along_the_track() -> None:
    vehicle = steady()
    vehicle.wind_east_m_s = 5.0
    flown(vehicle, 1.0)
    course = math.atan2(vehicle.velocity_east_m_s, vehicle.velocity_north_m_s)
    speed = math.hypot(vehicle.velocity_east_m_s, vehicle.velocity_north_m_s)
    vehicle.touch_down(400.0)
    vehicle.roll_on_ground(0.0, DT_S)
    assert vehicle.altitude_amsl_m == 400.0
    assert vehicle.heading_rad == pytest.approx(course)
    assert math.hypot(vehicle.velocity_north_m_s, vehicle.velocity_east_m_s) == pytest.approx(speed)


def test_the_reported_acceleration_is_the_change_of_velocity() -> None:
    vehicle = steady(40.0)
    size = math.hypot(vehicle.acceleration_north_m_s2, vehicle.acceleration_east_m_s2)
    assert size == pytest.approx(GRAVITY_M_S2 * math.tan(math.radians(40.0)), rel=1e-3)


def test_an_airframe_that_slips_flies_wider_circles() -> None:
    vehicle = plane()
    vehicle.turn_efficiency = 0.75
    flown(vehicle, 30.0, 30.0)
    before_rad = vehicle.heading_rad
    flown(vehicle, 1.0, 30.0)
    turned_rad = (vehicle.heading_rad - before_rad) % math.tau
    coordinated_rad = GRAVITY_M_S2 * math.tan(math.radians(30.0)) / 20.0
    assert turned_rad == pytest.approx(0.75 * coordinated_rad, rel=1e-3)
