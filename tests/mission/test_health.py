"""Thresholds: 0.5 s without a position, 1 s frozen, a jump of 1.5 times what can be flown.

Over a short time a jump is also what the speeds that were told cannot have made of the last one.
In flight a position that is not believed is a hold, with what is wrong with it in words.
"""

import copy
import math
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up import (
    COPTERS,
    MISSION,
    Craft,
    position,
    shifted,
    texts,
)
from renewed import replace

from companion.mission.events import Landed, Mode, Plan, Position, Setpoint
from companion.mission.health import TRUST_S, astray_m, distrust, take_distrust, take_position
from companion.mission.phases import Phase, Reason
from companion.mission.state import Vehicle
from companion.mission.vehicle_traits import VehicleTraits

LIMITS = MISSION.task.limits
GOOD = Vehicle(fix_good=True, estimator_good=True, fix_at_s=math.inf, estimator_at_s=math.inf)
FLICKERS = {"estimator_good": False, "estimator_failed_at_s": 10.0}
JUMP_M = 1.5 * math.hypot(150.0, 25.0) * 0.1 + 20.0  # in a tenth of a second, V = 150, climb 25


def with_position(vehicle: Vehicle, event: Position) -> Vehicle:
    vehicle = copy.copy(vehicle)
    take_position(vehicle, event, LIMITS)
    return vehicle


def after(*positions: tuple[float, float, float]) -> Vehicle:
    """Time, east, speed towards the east of each position."""
    vehicle = GOOD
    for time_s, east_m, speed_m_s in positions:
        event = position(time_s, (0.0, east_m, 3000.0), (0.0, speed_m_s, 0.0))
        vehicle = with_position(vehicle, event)
    return vehicle


class Track:
    """A vehicle flown level to the east, and what is thought of the positions that it tells."""

    def __init__(
        self, *, rate_hz: float = 10.0, landed: Landed = Landed.IN_AIR, speed_m_s: float = 20.0
    ) -> None:
        self.vehicle = replace(GOOD, landed=landed)
        self.time_s = self.north_m = self.east_m = 0.0
        self.course_rad, self.turn_rad_s = 0.5 * math.pi, 0.0
        self.speed_m_s, self.step_s = speed_m_s, 1.0 / rate_hz

    @property
    def reason(self) -> Reason | None:
        return distrust(self.vehicle, self.time_s, LIMITS)

    def vouch(self, *, fix: bool = True, estimator: bool = True) -> "Track":
        self.vehicle = replace(self.vehicle, fix_good=fix, estimator_good=estimator)
        if not estimator:
            self.vehicle.estimator_failed_at_s = self.time_s
        return self

    def fly(self, seconds: float, *, frozen: bool = False) -> "Track":
        """frozen: its position is, its speed is not."""
        for _ in range(round(seconds / self.step_s)):
            middle_rad = self.course_rad + 0.5 * self.step_s * self.turn_rad_s
            self.course_rad += self.step_s * self.turn_rad_s
            if not frozen:
                self.north_m += self.step_s * self.speed_m_s * math.cos(middle_rad)
                self.east_m += self.step_s * self.speed_m_s * math.sin(middle_rad)
            self.time_s += self.step_s
            take_distrust(self.vehicle, self.reason, self.time_s)  # a gap is seen before it ends
            course = math.cos(self.course_rad), math.sin(self.course_rad), 0.0
            north, east, up = (self.speed_m_s * each for each in course)
            here = (self.north_m, self.east_m, 3000.0)
            self.vehicle = with_position(
                self.vehicle, position(self.time_s, here, (north, east, up))
            )
            take_distrust(self.vehicle, self.reason, self.time_s)
        return self


Place = tuple[float, float, float]
STOOD: tuple[Place, ...] = ((10.0, 0.0, 0.0),)
JUMPED: tuple[Place, ...] = ((10.0, 0.0, 0.0), (10.1, 500.0, 0.0))
AGREE: tuple[Place, ...] = tuple((10.1 + 0.1 * tick, 500.0, 0.0) for tick in range(1, 6))
FROZEN: tuple[Place, ...] = tuple((10.0 + 0.1 * tick, 0.0, 50.0) for tick in range(20))


def still(frozen_s: float, speed_m_s: float) -> tuple[Place, ...]:
    ticks = range(round(frozen_s / 0.1) + 1)
    return tuple((10.0 + 0.1 * tick, 0.0, speed_m_s) for tick in ticks)


def step(step_m: float, speed_m_s: float, then_m_s: float | None = None) -> tuple[Place, ...]:
    then_m_s = speed_m_s if then_m_s is None else then_m_s
    return ((10.0, 0.0, speed_m_s), (10.1, step_m, then_m_s))


@pytest.mark.parametrize(
    ("positions", "at_s", "changes", "reason"),
    [
        ((), 0.0, {}, Reason.POSITION_STALE),
        (STOOD, 10.49, {}, None),
        (STOOD, 10.51, {}, Reason.POSITION_STALE),
        # it stands still for a second while its speed does not
        (still(0.9, 1.1), 10.9, {}, None),
        (still(1.1, 0.9), 11.1, {}, None),
        (still(1.1, 1.1), 11.1, {}, Reason.POSITION_FROZEN),
        (FROZEN, 11.9, {}, Reason.POSITION_FROZEN),
        ((*FROZEN, (12.0, 5.0, 50.0)), 12.0, {}, None),  # one changed coordinate thaws it
        # more than can be flown, though it says that it flew there
        (step(JUMP_M - 0.01, 0.0, 20.0 * (JUMP_M - 0.01)), 10.1, {}, None),
        (step(JUMP_M + 0.01, 0.0, 20.0 * (JUMP_M + 0.01)), 10.1, {}, Reason.POSITION_JUMPED),
        (((10.0, 0.0, 0.0), (14.0, 150.0 * 4.0, 150.0)), 14.0, {}, None),  # it had time for that
        # what the speeds told cannot have made: 4 m and 35 % of the way are allowed
        *(
            (
                step(0.1 * v + aside_m, v),
                10.1,
                {},
                None if aside_m < 4.0 else Reason.POSITION_JUMPED,
            )
            for v in (0.0, 20.0)
            for aside_m in (3.9, 8.5)
        ),
        *((step(0.1 * v - 8.5, v), 10.1, {}, Reason.POSITION_JUMPED) for v in (0.0, 20.0)),
        # forgotten after half a second of positions that agree
        ((*JUMPED, *AGREE[:-1]), 10.5, {}, Reason.POSITION_JUMPED),
        ((*JUMPED, *AGREE), 10.61, {}, None),
        # what vouches for it: must go on saying so, both of them; an estimator may flicker
        (STOOD, 10.0, {"fix_at_s": 5.1}, None),
        (STOOD, 10.0, {"fix_at_s": 4.9}, Reason.HEALTH_SILENT),
        (STOOD, 10.0, {"estimator_at_s": 5.1}, None),
        (STOOD, 10.0, {"estimator_at_s": 4.9}, Reason.HEALTH_SILENT),
        (STOOD, 10.0, {"fix_good": False}, Reason.NO_FIX),
        (STOOD, 10.0, {"estimator_good": False}, Reason.ESTIMATOR),
        (STOOD, 10.0, {"fix_good": False, "estimator_good": False}, Reason.NO_FIX),
        (STOOD, 10.4, FLICKERS, None),
        (((11.9, 0.0, 0.0),), 10.99, FLICKERS, None),
        (((11.9, 0.0, 0.0),), 11.01, FLICKERS, Reason.ESTIMATOR),
        # what the autopilot claims to know must be what the mission allows
        (STOOD, 10.0, {"error_m": 4.9}, None),
        (STOOD, 10.0, {"error_m": 5.1}, Reason.INACCURATE),
    ],
)
def test_a_position_is_believed_while_it_can_be_true(
    positions: tuple[Place, ...], at_s: float, changes: dict[str, Any], reason: Reason | None
) -> None:
    assert LIMITS.navigation_error_m == 5.0
    assert distrust(replace(after(*positions), **changes), at_s, LIMITS) is reason


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
        vehicle = with_position(vehicle, position(time_s, here, velocity))
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


def test_what_estimators_give_in_to_is_not_believed_until_it_jumps_back_or_was_vouched_for() -> (
    None
):
    """Where the vehicle cannot be; for a minute without a jump, then from there on."""
    track = doubted(20.0, 50.0, 10.0).vouch().fly(10.0)
    assert track.reason is Reason.POSITION_ELSEWHERE
    assert astray_m(track.vehicle) == pytest.approx(50.0, abs=0.1)
    track.vouch(estimator=False).fly(10.0)
    track.north_m = 0.0
    assert track.fly(1.0).vouch().fly(0.1).reason is None
    track = doubted(20.0, 50.0, 10.0).vouch().fly(59.5)
    assert track.reason is Reason.POSITION_ELSEWHERE
    assert track.fly(1.0).reason is None
    assert track.fly(TRUST_S + 1.0).reason is None
    assert astray_m(track.vehicle) == 0.0


@pytest.mark.parametrize(
    ("track", "north_m", "then_s"),
    [
        (lambda: doubted(20.0, 50.0, 10.0).vouch().fly(50.0), 30.0, 30.0),  # the minute again
        (lambda: Track().fly(10.0), 50.0, 5.0),  # that nothing announced
        (lambda: doubted(60.0, 50.0, 10.0).vouch(), 0.0, 1.0),  # however long it was rejected
    ],
    ids=["again", "unannounced", "rejected"],
)
def test_a_jump_is_not_believed(track: Callable[[], Track], north_m: float, then_s: float) -> None:
    jumps = track()
    jumps.north_m += north_m
    assert jumps.fly(then_s).reason is Reason.POSITION_ELSEWHERE


@pytest.mark.parametrize(("lost_s", "back_m"), [(10.0, 12.0), (31.0, 31.0)])
def test_an_estimator_without_gps_may_have_drifted_so_far(lost_s: float, back_m: float) -> None:
    """px4.md 8: 31 m after 31 s."""
    track = doubted(lost_s, back_m, lost_s - 0.1, fix=False).vouch().fly(1.0)
    assert track.reason is None


@pytest.mark.parametrize("frozen", [False, True])
def test_what_is_flown_unseen_is_no_discrepancy_as_far_as_it_can_be_flown(frozen: bool) -> None:
    track = Track().fly(10.0)
    if frozen:
        track.fly(10.0, frozen=True)
    track.time_s += 0.0 if frozen else 10.0
    track.east_m += 900.0  # V is 150 m/s
    assert track.fly(1.0).reason is None


def test_on_the_ground_a_position_may_jump_as_it_likes() -> None:
    track = Track(landed=Landed.ON_GROUND, speed_m_s=0.0).fly(10.0)
    track.north_m += 50.0
    assert track.fly(1.0).reason is None


# --- in flight


@COPTERS
@pytest.mark.parametrize("taken", [False, True])
def test_it_holds_where_the_vehicle_cannot_be_says_how_far_off_and_goes_on_once_it_agrees(
    traits: VehicleTraits, taken: bool
) -> None:
    """It gets a fix that is 50 m off; also while somebody else has it, who then gives it back."""
    craft = Craft(traits=traits).fly_to(Phase.FLYING).run_for(10.0)
    craft.mode = Mode.OTHER if taken else craft.mode
    craft.fix = False
    craft.run_for(3.0)
    craft.fix = True
    shifted(craft, 50.0).run_for(10.0)
    craft.mode = Mode.GUIDED if taken else craft.mode
    craft.run_for(5.0)
    assert craft.state.reason is Reason.POSITION_ELSEWHERE
    assert craft.mode is Mode.HOLD
    said = texts(craft.commands)[-1].removeprefix(f"hold: {Reason.POSITION_ELSEWHERE.text}: ")
    off_m, allowed_m = (float(each.split(" m ")[0]) for each in said.split(", "))
    assert off_m == pytest.approx(50.0, abs=8.0)  # it stops within a tick
    assert allowed_m < off_m
    assert not [c for c in craft.during(30.0) if isinstance(c, Setpoint | Plan)]
    assert shifted(craft, -50.0).run_for(10.0).phase is Phase.FLYING
