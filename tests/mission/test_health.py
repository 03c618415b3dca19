"""Thresholds: 0.5 s without a position, 1 s frozen, a jump of 1.5 times what can be flown.

Over a short time a jump is also what the speeds that were told cannot have made of the last one.
"""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up import MISSION, position
from renewed import replace

from companion.mission.events import Landed
from companion.mission.health import TRUST_S, astray_m, distrust, with_position, with_position_trust
from companion.mission.state import Reason, Vehicle

LIMITS = MISSION.task.limits
GOOD = Vehicle(fix_good=True, estimator_good=True, fix_at_s=math.inf, estimator_at_s=math.inf)
EAST = (0.0, 100.0, 0.0)
JUMP_M = 1.5 * math.hypot(150.0, 25.0) * 0.1 + 20.0  # in a tenth of a second, V = 150, climb 25


def seen(vehicle: Vehicle, time_s: float) -> Vehicle:
    return with_position_trust(vehicle, distrust(vehicle, time_s, LIMITS), time_s)


def after(*positions: tuple[float, float, float]) -> Vehicle:
    """Time, east, speed towards the east of each position."""
    vehicle = GOOD
    for time_s, east_m, speed_m_s in positions:
        event = position(time_s, (0.0, east_m, 3000.0), (0.0, speed_m_s, 0.0))
        vehicle = with_position(vehicle, event, LIMITS)
    return vehicle


class Track:
    """A vehicle flown level, and what is thought of the positions it tells."""

    def __init__(
        self, *, rate_hz: float = 10.0, landed: Landed = Landed.IN_AIR, speed_m_s: float = 20.0
    ) -> None:
        self.vehicle = replace(GOOD, landed=landed)
        self.time_s = self.north_m = self.east_m = 0.0
        self.course_rad, self.turn_rad_s = math.radians(90.0), 0.0
        self.speed_m_s, self.step_s = speed_m_s, 1.0 / rate_hz

    @property
    def reason(self) -> Reason | None:
        return distrust(self.vehicle, self.time_s, LIMITS)

    def vouch(self, *, fix: bool = True, estimator: bool = True) -> "Track":
        failed_at_s = self.vehicle.estimator_failed_at_s if estimator else self.time_s
        self.vehicle = replace(
            self.vehicle, fix_good=fix, estimator_good=estimator, estimator_failed_at_s=failed_at_s
        )
        return self

    def fly(self, seconds: float) -> "Track":
        for _ in range(round(seconds / self.step_s)):
            middle_rad = self.course_rad + 0.5 * self.step_s * self.turn_rad_s
            self.course_rad += self.step_s * self.turn_rad_s
            self.north_m += self.step_s * self.speed_m_s * math.cos(middle_rad)
            self.east_m += self.step_s * self.speed_m_s * math.sin(middle_rad)
            self._tell()
        return self

    def stand_still(self, seconds: float) -> None:
        """The position is frozen, the speed is not."""
        for _ in range(round(seconds / self.step_s)):
            self._tell()

    def _tell(self) -> None:
        self.time_s += self.step_s
        self.vehicle = seen(self.vehicle, self.time_s)  # a gap is seen before it ends
        velocity = (
            self.speed_m_s * math.cos(self.course_rad),
            self.speed_m_s * math.sin(self.course_rad),
            0.0,
        )
        event = position(self.time_s, (self.north_m, self.east_m, 3000.0), velocity)
        self.vehicle = seen(with_position(self.vehicle, event, LIMITS), self.time_s)


def test_a_vehicle_that_never_gave_a_position_is_not_believed() -> None:
    assert distrust(GOOD, 0.0, LIMITS) is Reason.POSITION_STALE


@pytest.mark.parametrize(("age_s", "reason"), [(0.49, None), (0.51, Reason.POSITION_STALE)])
def test_a_position_is_believed_for_half_a_second(age_s: float, reason: Reason | None) -> None:
    assert distrust(after((10.0, 0.0, 0.0)), 10.0 + age_s, LIMITS) is reason


@pytest.mark.parametrize(("frozen_s", "reason"), [(0.9, None), (1.1, Reason.POSITION_FROZEN)])
@pytest.mark.parametrize(("speed_m_s", "moves"), [(0.9, False), (1.1, True)])
def test_a_position_that_stands_still_for_a_second_while_the_speed_does_not_is_frozen(
    frozen_s: float, reason: Reason | None, speed_m_s: float, moves: bool
) -> None:
    times = [10.0 + 0.1 * tick for tick in range(round(frozen_s / 0.1) + 1)]
    vehicle = after(*((time_s, 0.0, speed_m_s) for time_s in times))
    assert distrust(vehicle, times[-1], LIMITS) is (reason if moves else None)


def test_one_changed_coordinate_thaws_a_frozen_position() -> None:
    ticks = [(10.0 + 0.1 * tick, 0.0, 50.0) for tick in range(20)]
    assert distrust(after(*ticks), 11.9, LIMITS) is Reason.POSITION_FROZEN
    assert distrust(after(*ticks, (12.0, 5.0, 50.0)), 12.0, LIMITS) is None


@pytest.mark.parametrize(
    ("step_m", "reason"), [(JUMP_M - 0.01, None), (JUMP_M + 0.01, Reason.POSITION_JUMPED)]
)
def test_a_jump_is_a_step_of_more_than_can_be_flown(step_m: float, reason: Reason | None) -> None:
    vehicle = after((10.0, 0.0, 0.0), (10.1, step_m, 2.0 * step_m / 0.1))  # it says it flew there
    assert distrust(vehicle, 10.1, LIMITS) is reason


@pytest.mark.parametrize(
    ("aside_m", "reason"),
    [(3.9, None), (8.5, Reason.POSITION_JUMPED), (-8.5, Reason.POSITION_JUMPED)],
)
@pytest.mark.parametrize("speed_m_s", [0.0, 20.0])
def test_a_jump_is_a_step_that_the_speeds_told_cannot_have_made(
    aside_m: float, reason: Reason | None, speed_m_s: float
) -> None:
    """4 m and 35 % of the way are allowed: 4.7 m at 20 m/s."""
    vehicle = after((10.0, 0.0, speed_m_s), (10.1, 0.1 * speed_m_s + aside_m, speed_m_s))
    assert distrust(vehicle, 10.1, LIMITS) is reason


@pytest.mark.parametrize("of", ["fix_at_s", "estimator_at_s"])
@pytest.mark.parametrize(("silent_s", "reason"), [(4.9, None), (5.1, Reason.HEALTH_SILENT)])
def test_what_vouches_for_the_position_must_go_on_saying_so(
    of: str, silent_s: float, reason: Reason | None
) -> None:
    vehicle = replace(after((10.0, 0.0, 0.0)), **{of: 10.0 - silent_s})
    assert distrust(vehicle, 10.0, LIMITS) is reason


def test_an_estimator_may_flicker_for_a_second() -> None:
    flickers = replace(after((10.0, 0.0, 0.0)), estimator_good=False, estimator_failed_at_s=10.0)
    later = replace(flickers, position_at_s=12.0, moved_at_s=12.0)
    assert distrust(flickers, 10.4, LIMITS) is None
    assert distrust(later, 10.99, LIMITS) is None
    assert distrust(later, 11.01, LIMITS) is Reason.ESTIMATOR


@pytest.mark.parametrize(("error_m", "reason"), [(4.9, None), (5.1, Reason.INACCURATE)])
def test_what_the_autopilot_claims_to_know_must_be_what_the_mission_allows(
    error_m: float, reason: Reason | None
) -> None:
    assert LIMITS.navigation_error_m == 5.0
    assert distrust(replace(after((10.0, 0.0, 0.0)), error_m=error_m), 10.0, LIMITS) is reason


def test_a_jump_is_forgotten_after_half_a_second_of_positions_that_agree() -> None:
    jumped = [(10.0, 0.0, 0.0), (10.1, 500.0, 0.0)]
    later = [(10.1 + 0.1 * tick, 500.0, 0.0) for tick in range(1, 6)]
    assert distrust(after(*jumped, *later[:-1]), 10.5, LIMITS) is Reason.POSITION_JUMPED
    assert distrust(after(*jumped, *later), 10.61, LIMITS) is None


def test_the_step_of_a_gap_in_the_positions_may_be_longer() -> None:
    assert distrust(after((10.0, 0.0, 0.0), (14.0, 150.0 * 4.0, 150.0)), 14.0, LIMITS) is None


@pytest.mark.parametrize(
    ("vehicle", "reason"),
    [
        (Vehicle(fix_good=False, estimator_good=True), Reason.NO_FIX),
        (Vehicle(fix_good=True, estimator_good=False), Reason.ESTIMATOR),
        (Vehicle(fix_good=False, estimator_good=False), Reason.NO_FIX),
    ],
    ids=["fix", "estimator", "both"],
)
def test_receiver_and_estimator_must_both_vouch(vehicle: Vehicle, reason: Reason) -> None:
    assert distrust(with_position(vehicle, position(1.0), LIMITS), 1.0, LIMITS) is reason


@given(
    speed_m_s=st.floats(0.0, 150.0),
    climb_m_s=st.floats(-25.0, 25.0),
    course_rad=st.floats(-math.pi, math.pi),
    rate_hz=st.sampled_from([2.5, 5.0, 10.0, 20.0, 50.0]),
)
def test_a_flight_within_the_limits_is_always_believed(
    speed_m_s: float, climb_m_s: float, course_rad: float, rate_hz: float
) -> None:
    vehicle = GOOD
    velocity = (speed_m_s * math.cos(course_rad), speed_m_s * math.sin(course_rad), climb_m_s)
    for tick in range(60):
        time_s = tick / rate_hz
        here = (velocity[0] * time_s, velocity[1] * time_s, 3000.0 + climb_m_s * time_s)
        vehicle = with_position(vehicle, position(time_s, here, velocity), LIMITS)
        assert distrust(vehicle, time_s, LIMITS) is None


# --- after a loss or a glitch


def doubted(
    seconds: float, jump_m: float = 0.0, after_s: float = 0.0, *, fix: bool = True
) -> Track:
    """Flown east at 20 m/s for 10 s; then not vouched for, and with a jump north on the way."""
    track = Track().fly(10.0)
    track.vouch(fix=fix, estimator=False)
    track.fly(after_s)
    track.north_m += jump_m
    return track.fly(seconds - after_s)


def test_a_position_that_estimators_give_in_to_is_not_believed_where_the_vehicle_cannot_be() -> (
    None
):
    track = doubted(20.0, 50.0, 10.0).vouch().fly(5.0)
    assert track.reason is Reason.POSITION_ELSEWHERE
    assert astray_m(track.vehicle) == pytest.approx(50.0, abs=0.1)


def test_it_is_believed_as_soon_as_it_has_jumped_back() -> None:
    track = doubted(20.0, 50.0, 10.0).vouch().fly(10.0)
    track.vouch(estimator=False).fly(10.0)
    track.north_m = 0.0
    track.fly(1.0).vouch().fly(0.1)
    assert track.reason is None


def test_it_is_believed_wherever_it_is_once_it_was_vouched_for_a_minute_without_a_jump() -> None:
    track = doubted(20.0, 50.0, 10.0).vouch().fly(59.5)
    assert track.reason is Reason.POSITION_ELSEWHERE
    assert track.fly(1.0).reason is None
    assert track.fly(TRUST_S + 1.0).reason is None
    assert astray_m(track.vehicle) == 0.0  # and counts from there on


def test_a_jump_begins_the_minute_again() -> None:
    track = doubted(20.0, 50.0, 10.0).vouch().fly(50.0)
    track.north_m += 30.0
    assert track.fly(30.0).reason is Reason.POSITION_ELSEWHERE


def test_a_jump_that_nothing_announced_is_not_believed_either() -> None:
    track = Track().fly(10.0)
    track.north_m += 50.0
    assert track.fly(5.0).reason is Reason.POSITION_ELSEWHERE


@pytest.mark.parametrize(("lost_s", "back_m"), [(10.0, 12.0), (31.0, 31.0)])
def test_an_estimator_without_gps_may_have_drifted_so_far(lost_s: float, back_m: float) -> None:
    """px4.md 8: 31 m after 31 s."""
    track = doubted(lost_s, back_m, lost_s - 0.1, fix=False).vouch().fly(1.0)
    assert track.reason is None


def test_a_drift_is_no_more_likely_for_having_been_rejected_since_the_jump() -> None:
    assert doubted(60.0, 50.0, 10.0).vouch().fly(1.0).reason is Reason.POSITION_ELSEWHERE


@pytest.mark.parametrize("rate_hz", [2.5, 10.0])
def test_what_is_flown_meanwhile_is_no_discrepancy(rate_hz: float) -> None:
    """A plane that circles at 20 m/s with a radius of 80 m, for two minutes."""
    track = Track(rate_hz=rate_hz).fly(10.0)
    track.vouch(estimator=False)
    track.turn_rad_s = 0.25
    track.fly(120.0)
    assert track.vouch().fly(0.5).reason is None


@pytest.mark.parametrize("frozen", [False, True])
def test_what_is_flown_unseen_is_no_discrepancy_as_far_as_it_can_be_flown(frozen: bool) -> None:
    track = Track().fly(10.0)
    if frozen:
        track.stand_still(10.0)
    track.time_s += 0.0 if frozen else 10.0
    track.east_m += 900.0  # V is 150 m/s
    assert track.fly(1.0).reason is None


def test_on_the_ground_a_position_may_jump_as_it_likes() -> None:
    track = Track(landed=Landed.ON_GROUND, speed_m_s=0.0).fly(10.0)
    track.north_m += 50.0
    assert track.fly(1.0).reason is None
