"""Thresholds: 0.5 s without a position, 1 s frozen, a jump of 1.5 times what can be flown.

Over a short time a jump is also what the speeds that were told cannot have made of the last one.
In flight a position that is not believed is a hold: `test_stories`.
"""

import math
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up import MISSION, now, position
from renewed import replace

from companion.mission.events import Landed
from companion.mission.health import TRUST_S, distrust, take_distrust, take_position
from companion.mission.phases import Reason
from companion.mission.state import Vehicle

LIMITS = MISSION.task.limits
FLICKERS = {"estimator_good": False, "estimator_failed_at_s": 10.0}
JUMP_M = 1.5 * math.hypot(150.0, 25.0) * 0.1 + 20.0  # in a tenth of a second, V = 150, climb 25


def vehicle() -> Vehicle:
    """All that is said of its position is good."""
    said = {"fix_good": True, "estimator_good": True, "landed": Landed.IN_AIR}
    return Vehicle(**said, fix_at_s=math.inf, estimator_at_s=math.inf)


Place = tuple[float, float, float]
"""Time, east, and the speed towards it."""
STOOD: tuple[Place, ...] = ((10.0, 0.0, 0.0),)
JUMPED: tuple[Place, ...] = ((10.0, 0.0, 0.0), (10.1, 500.0, 0.0))
AGREE: tuple[Place, ...] = tuple((10.1 + 0.1 * tick, 500.0, 0.0) for tick in range(1, 6))


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
        ((*still(1.9, 50.0), (12.0, 5.0, 50.0)), 12.0, {}, None),  # one changed coordinate thaws it
        # more than can be flown, though it says that it flew there
        (step(JUMP_M - 0.01, 0.0, 20.0 * (JUMP_M - 0.01)), 10.1, {}, None),
        (step(JUMP_M + 0.01, 0.0, 20.0 * (JUMP_M + 0.01)), 10.1, {}, Reason.POSITION_JUMPED),
        (((10.0, 0.0, 0.0), (14.0, 150.0 * 4.0, 150.0)), 14.0, {}, None),  # it had time for that
        # what the speeds told cannot have made: 4 m and 35 % of the way are allowed
        *((step(0.1 * v + 3.9, v), 10.1, {}, None) for v in (0.0, 20.0)),
        *((step(0.1 * v + 8.5, v), 10.1, {}, Reason.POSITION_JUMPED) for v in (0.0, 20.0)),
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
    told = replace(vehicle(), landed=Landed.ON_GROUND)
    for time_s, east_m, speed_m_s in positions:
        event = position(time_s, (0.0, east_m, 3000.0), (0.0, speed_m_s, 0.0))
        take_position(told, event, LIMITS)
    assert distrust(replace(told, **changes), at_s, LIMITS) is reason


class Track:
    """A vehicle flown level to the east, and what is thought of the positions that it tells."""

    north_m = east_m = time_s = climb_m_s = turn_rad_s = 0.0
    speed_m_s, course_rad, step_s = 20.0, 0.5 * math.pi, 0.1
    fix = estimator = True
    frozen = False
    """Its position is, its speed is not."""

    def __init__(self) -> None:
        self.vehicle = vehicle()

    @property
    def reason(self) -> Reason | None:
        return distrust(self.vehicle, self.time_s, LIMITS)

    def fly(self, seconds: float) -> "Track":
        vehicle = self.vehicle
        if vehicle.estimator_good and not self.estimator:
            vehicle.estimator_failed_at_s = self.time_s
        vehicle.fix_good, vehicle.estimator_good = self.fix, self.estimator
        for _ in range(round(seconds / self.step_s)):
            middle_rad = self.course_rad + 0.5 * self.step_s * self.turn_rad_s
            self.course_rad += self.step_s * self.turn_rad_s
            moved_m = 0.0 if self.frozen else self.step_s * self.speed_m_s
            self.north_m += moved_m * math.cos(middle_rad)
            self.east_m += moved_m * math.sin(middle_rad)
            self.time_s += self.step_s
            take_distrust(vehicle, self.reason, self.time_s)  # a gap is seen before it ends
            north, east = math.cos(self.course_rad), math.sin(self.course_rad)
            velocity = (self.speed_m_s * north, self.speed_m_s * east, self.climb_m_s)
            here = (self.north_m, self.east_m, 3000.0 + self.climb_m_s * self.time_s)
            take_position(vehicle, position(self.time_s, here, velocity), LIMITS)
            take_distrust(vehicle, self.reason, self.time_s)
        return self


@given(
    speed_m_s=st.floats(0.0, 150.0),
    climb_m_s=st.floats(-25.0, 25.0),
    course_rad=st.floats(-math.pi, math.pi),
    step_s=st.sampled_from([0.4, 0.2, 0.1, 0.05, 0.02]),
)
def test_a_flight_within_the_limits_is_always_believed(**how: float) -> None:
    track = Track()
    now(**how)(track)
    for _ in range(60):
        assert track.fly(track.step_s).reason is None


# --- after a loss or a glitch


Happening = float | Callable[[Any], object]


def leaps(**by: float) -> Callable[[Track], None]:
    """These are so much more at once."""

    def leap(track: Track) -> None:
        for name, value in by.items():
            setattr(track, name, getattr(track, name) + value)

    return leap


def landed(track: Track) -> None:
    track.vehicle.landed, track.speed_m_s = Landed.ON_GROUND, 0.0


jumps, unseen, flies_on = leaps(north_m=50.0), leaps(time_s=10.0), leaps(east_m=900.0)
"""The latter for ten seconds, and to where it can in these: V is 150 m/s."""
doubted, lost = now(estimator=False), now(fix=False, estimator=False)
vouched = now(fix=True, estimator=True)
frozen, thawed = now(frozen=True), now(frozen=False)
circles = now(turn_rad_s=0.25, step_s=0.4)
"""A plane at 20 m/s with a radius of 80 m, which tells its position 2.5 times a second."""
GLITCH: tuple[Happening, ...] = (doubted, 10.0, jumps, 10.0, vouched)
"""What estimators give in to."""


@pytest.mark.parametrize(
    ("happens", "believed"),
    [
        # not believed where the vehicle cannot be, until it jumps back or was vouched for a minute
        ((*GLITCH, 10.0), False),
        ((*GLITCH, 10.0, doubted, 10.0, leaps(north_m=-50.0), 1.0, vouched, 0.1), True),
        ((*GLITCH, 59.5), False),
        ((*GLITCH, 60.5, TRUST_S + 1.0), True),
        ((*GLITCH, 50.0, leaps(north_m=30.0), 30.0), False),
        ((jumps, 5.0), False),  # that nothing announced
        ((doubted, 10.0, jumps, 50.0, vouched, 1.0), False),  # however long it was rejected
        # px4.md 8: an estimator without GPS has drifted by 31 m after 31 s
        ((lost, 9.9, leaps(north_m=12.0), 0.1, vouched, 1.0), True),
        ((lost, 30.9, leaps(north_m=31.0), 0.1, vouched, 1.0), True),
        # of what was before it was believed nothing counts: no drift, nor how long it was blind
        (2 * (lost, 5.0, leaps(north_m=8.0), 1.0, vouched, 10.0), True),
        ((lost, 40.0, vouched, 10.0, *GLITCH, 10.0), False),
        # unseen it may have flown as far as it can; on the ground it may jump
        ((unseen, flies_on, 1.0), True),
        ((frozen, 10.0, thawed, flies_on, 1.0), True),
        # what repeats tells nothing
        ((doubted, 1.0, frozen, 0.4, thawed, leaps(east_m=8.0), 1.0, vouched, 0.1), True),
        ((landed, 10.0, leaps(north_m=50.0), 1.0), True),
        ((circles, doubted, 120.0, vouched, 0.8), True),  # what is flown meanwhile
    ],
)
def test_after_a_loss_or_a_glitch(happens: tuple[Happening, ...], believed: bool) -> None:
    track = Track().fly(10.0)
    for each in happens:
        track.fly(each) if isinstance(each, float) else each(track)
    assert track.reason is (None if believed else Reason.POSITION_ELSEWHERE)
