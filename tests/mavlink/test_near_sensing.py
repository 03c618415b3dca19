"""What lidars say, message by message (between real posts: test_near_scanner.py)."""

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from typing import Any

import lidars
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lidars import attitude, beam, health, tell
from wires import FRAME, wire

from companion.mavlink.near_sensing import NearSensing, Sight
from companion.mavlink.poses import Poses
from companion.world.near_map import NearSensor, Sweep

LIDAR = NearSensor(kind="obstacle_distance", component_id=196, range_m=40.0, latency_s=0.0)
BEHIND_AUTOPILOT = NearSensor(
    kind="distance_sensor", component_id=1, range_m=16.0, latency_s=0.04, blind_m=0.2
)
NOW_S = 10.0
UNKNOWN = 65_535
WELL = health(well=True)
obstacle_distance = partial(lidars.obstacle_distance, NOW_S)


def standing(yaw_rad: float = 0.0, pitch_rad: float = 0.0) -> Poses:
    """A vehicle at 3, 4 and 5 m."""
    poses = Poses(FRAME)
    for time_s in (NOW_S - 0.2, NOW_S, NOW_S + 0.2):
        poses.on_position(time_s, (3.0, 4.0, 5.0))
        poses.on_attitude(attitude(time_s, 0.0, pitch_rad, yaw_rad))
    return poses


def swept(sensor: NearSensor, *told: tuple[Any, float], poses: Poses | None = None) -> list[Sweep]:
    """What is made of messages, each with the time at which it was heard."""
    sensing = NearSensing(sensor, poses or standing())
    for message, now_s in told:
        tell(sensing, message, now_s)
    return sensing.sweeps()


def clear_m(sweep: Sweep, *bearings_deg: float) -> Any:
    """How far it is clear towards these bearings."""
    bearings = np.radians(bearings_deg)
    return pytest.approx(sweep.clear_between_m(bearings, np.full(len(bearings), 1e-6)).tolist())


MEANINGS = {UNKNOWN: 0.0, 0: 0.0, 19: 0.0, 20: 0.2, 500: 5.0, 1999: 19.99, 2000: 0.0, 2001: 20.0}
"""Centimetres between 20 and 2000, and how far it is clear.  What is as far as the sensor sees may
be nothing, or a wrong "nothing": it says nothing."""
NORTH = (wire.MAV_FRAME_GLOBAL, wire.MAV_FRAME_LOCAL_NED)
FRAMES = (wire.MAV_FRAME_BODY_FRD, wire.MAV_FRAME_BODY_NED, *NORTH)
WIDTHS_DEG = [*({"increment": width} for width in (1, 3, 10, 90, 255)), {"increment_f": -7.0}]
WIDTHS_DEG += [{"increment": 7, "increment_f": width} for width in (5.0, 2.5, -5.0)]
angles_deg = st.floats(-180.0, 180.0, width=32)
distances_cm = st.lists(st.sampled_from([*MEANINGS]), min_size=72, max_size=72)


@given(
    distances_cm,
    st.sampled_from(WIDTHS_DEG),
    st.sampled_from(FRAMES),
    st.tuples(angles_deg, angles_deg, angles_deg),
)
def test_each_sector_says_how_far_it_is_clear_about_its_own_direction(
    told_cm: list[int], width: dict[str, Any], frame: int, angles: tuple[float, float, float]
) -> None:
    """Of the nose, as it is mounted, or of true north; more than a turn of them is left out."""
    yaw_deg, mounted_deg, offset_deg = angles
    width_deg = width.get("increment_f", width.get("increment", 0.0))
    turn = math.radians(yaw_deg)
    sensor = replace(LIDAR, yaw_rad=math.radians(mounted_deg), forward_m=0.5, right_m=0.2)
    message = obstacle_distance(told_cm, **width, angle_offset=offset_deg, frame=frame)
    [sweep] = swept(sensor, (message, NOW_S), poses=standing(turn))
    first_deg = offset_deg + (0.0 if frame in NORTH else yaw_deg + mounted_deg)
    count = min(72, int(360.0 // abs(width_deg)))
    for k in range(count):
        bearings = (first_deg + (k + aside) * width_deg for aside in (-0.49, 0.0, 0.49))
        assert clear_m(sweep, *bearings) == [MEANINGS[told_cm[k]]] * 3
    if left_deg := 360.0 - count * abs(width_deg):
        half_deg = math.copysign(0.5 * (abs(width_deg) + left_deg), width_deg)
        assert clear_m(sweep, first_deg - half_deg) == [0.0]
    echoes = sum(told in (20, 500, 1999) for told in told_cm[:count])
    assert np.isfinite(sweep.echo_m).sum() == echoes
    north_m = 3.0 + 0.5 * math.cos(turn) - 0.2 * math.sin(turn)
    east_m = 4.0 + 0.5 * math.sin(turn) + 0.2 * math.cos(turn)
    assert sweep.sensor_ne_m == pytest.approx((north_m, east_m))


def test_a_tilted_beam_says_nothing_of_what_lies_beyond_its_slab() -> None:
    tilt = math.radians(20.0)
    down, met = (
        swept(LIDAR, (obstacle_distance([cm]), NOW_S), poses=standing(pitch_rad=-tilt))[0]
        for cm in (2001, 400)
    )
    assert clear_m(down, 0.0) == [LIDAR.speaks_for_m / math.tan(tilt)]
    assert down.clear_m[18] == pytest.approx(20.0, abs=0.1)  # aside
    assert met.echo_m[0] == pytest.approx(4.0 * math.cos(tilt))


def test_a_message_that_cannot_be_understood_says_nothing() -> None:
    frames = (wire.MAV_FRAME_GLOBAL_TERRAIN_ALT, wire.MAV_FRAME_LOCAL_FRD)
    for fields in (
        *({"increment": 0}, {"increment_f": math.nan}, {"increment_f": 361.0}),
        *({"angle_offset": math.inf}, {"min_distance": 2000}, *({"frame": f} for f in frames)),
    ):
        sensing = NearSensing(LIDAR, standing())
        tell(sensing, obstacle_distance([500], **fields), NOW_S)
        assert (sensing.sweeps(), sensing.sight(NOW_S)) == ([], Sight.NEVER_HEARD), fields


def test_sweeps_are_of_their_time_and_no_more_than_thirty_a_second() -> None:
    at_125_hz = [NOW_S + 0.008 * k for k in range(20)]  # else they would prove more than a turn
    for stamps_s, heard_s, taken in (
        (at_125_hz, at_125_hz, range(0, 20, 4)),  # told again at once it is one sweep
        ((0.0, 1.795e9, 15.0), (10.0, 10.1, 10.2), range(3)),  # of another clock: counts as now
    ):
        told = [obstacle_distance([500], time_usec=round(stamp_s * 1e6)) for stamp_s in stamps_s]
        sweeps = swept(LIDAR, *zip(told, heard_s, strict=True))
        expected = [heard_s[number] for number in taken]
        assert [sweep.time_s for sweep in sweeps] == pytest.approx(expected)
    still = [(beam(NOW_S - 0.05, cm), NOW_S + 0.15 * k) for k, cm in enumerate((700, 500, 400))]
    sweeps = swept(BEHIND_AUTOPILOT, *still)  # sectors whose stamp stands still go on
    assert [sweep.echo_m[0] for sweep in sweeps] == pytest.approx([7.0, 5.0])


def test_a_measurement_waits_until_the_pose_of_its_time_is_known_which_is_not_guessed() -> None:
    poses = Poses(FRAME)
    sensing = NearSensing(LIDAR, poses)
    poses.on_position(NOW_S - 0.1, (0.0, 0.0, 0.0))
    poses.on_attitude(attitude(NOW_S - 0.1, 0.0, 0.0, math.radians(175.0)))
    sensing.on_obstacle_distance(obstacle_distance([500]), NOW_S)
    assert sensing.sweeps() == []
    poses.on_position(NOW_S + 0.1, (2.0, 4.0, 6.0))
    assert sensing.sweeps() == []
    poses.on_attitude(attitude(NOW_S + 0.1, 0.0, 0.0, math.radians(-175.0)))
    (sweep,) = sensing.sweeps()
    assert sweep.sensor_ne_m == pytest.approx((1.0, 2.0))
    assert clear_m(sweep, 180.0) == [5.0]
    for at_s in (2.1, 2.2):
        poses.on_position(NOW_S + at_s, (2.0, 4.0, 6.0))
    poses.on_attitude(attitude(NOW_S + 2.1))
    poses.on_attitude(attitude(NOW_S + 2.2, math.nan, 0.0, 0.0))
    known = {after_s: poses.at(NOW_S + after_s) is not None for after_s in (1.0, 2.1, 2.15, 2.2)}
    assert known == {1.0: False, 2.1: True, 2.15: False, 2.2: False}  # or too far apart


def test_one_that_knows_nothing_in_any_direction_does_not_see() -> None:
    sensing = NearSensing(LIDAR, standing())
    for known, sight in ((0, Sight.NEVER_HEARD), (1, Sight.SEES)):
        tell(sensing, obstacle_distance([UNKNOWN] * (72 - known)), NOW_S)
        assert sensing.sight(NOW_S) is sight


def test_a_beam_is_no_sector() -> None:
    for component, number, field_deg, is_taken in (
        (1, 10, 0.0, True),
        (1, 0, 0.0, False),  # a rangefinder of ArduPilot that looks ahead
        (1, 17, 3.0, False),
        (158, 0, 0.0, True),
        (158, 0, 45.0, True),
        (158, 0, 27.0, False),
    ):
        sensing = NearSensing(BEHIND_AUTOPILOT, standing())
        fields = {"id": number, "horizontal_fov": math.radians(field_deg)}
        sensing.on_distance_sensor(beam(NOW_S - 0.05, source=(1, component), **fields), NOW_S)
        assert (sensing.sight(NOW_S) is Sight.SEES) == is_taken


def flown(
    sensor: NearSensor, seconds: float, told: Callable[[int], Iterable[Any]]
) -> tuple[NearSensing, list[Sweep]]:
    """What is made of messages, told k-th of them, at 20 Hz; it flies level."""
    poses, sweeps = Poses(FRAME), list[Sweep]()
    sensing = NearSensing(sensor, poses)
    for k in range(round(seconds * 20.0)):
        now_s = NOW_S + 0.05 * k
        poses.on_position(now_s, (0.0, 0.0, 5.0))
        poses.on_attitude(attitude(now_s))
        for message in told(k):
            message.time_boot_ms = round(1e3 * now_s)
            tell(sensing, message, now_s)
        sweeps += sensing.sweeps()
    return sensing, sweeps


NEVER, ONCE, EACH_SECOND = range(0), range(100, 101), range(0, 200, 20)


@pytest.mark.parametrize(
    ("sectors", "but", "told_then", "seconds", "expected_m"),
    [
        # a sector before the last one that was never told is empty; a link leaves out the high
        # ones (proximity.md 1)
        ((0, 2, 5), NEVER, (), 1.0, "7 0 7 0 0 7 0 0"),
        ((0, 2, 5), NEVER, (), 1.75, "7 16 7 16 16 7 0 0"),
        ((0, 2, 5), NEVER, (), 4.0, "7 16 7 16 16 7 16 16"),
        # what a link has no room for is unknown; what comes once a second needs some of it
        ((0, 2, 5), EACH_SECOND, (0, 2), 6.0, "7 16 7 0 0 7 0 0"),
        ((0, 2, 5), ONCE, (0, 2), 5.0, "7 16 7 16 16 7 16 16"),
        ((0, 2, 5), ONCE, (0, 2), 6.1, "7 16 7 0 0 7 0 0"),
        ((0, 2, 5), ONCE, (0, 2), 9.0, "7 16 7 16 16 7 16 16"),
        # a set that is left out altogether is missed: a thing in the next sector is never told of
        ((0,), EACH_SECOND, (), 6.0, "7 0 0 0 0 0 0 0"),
        ((4,), EACH_SECOND, (), 6.0, "16 16 16 16 7 0 0 0"),
        ((0,), range(20, 200, 2), (), 7.0, "7 16 16 16 16 16 16 16"),
        ((4,), NEVER, (), 7.0, "16 16 16 16 7 16 16 16"),
        # one that is left out now and was told before is unknown
        ((0, 2, 5), range(70, 200), (0, 5), 4.0, "7 16 0 16 16 7 16 16"),
    ],
)
def test_what_silence_about_a_sector_means(
    sectors: Any, but: range, told_then: Any, seconds: float, expected_m: str
) -> None:
    """A thing in these sectors at 20 Hz, but for some sets; of another driver silence says none."""
    expected = [float(each) for each in expected_m.split()]
    for component, clear in ((1, expected), (158, [7.0 * (m == 7.0) for m in expected])):
        sensor = replace(BEHIND_AUTOPILOT, component_id=component)
        beams = lambda k, who=component: [  # noqa: E731
            beam(0.0, orientation=sector, source=(1, who))
            for sector in (told_then if k in but else sectors)
        ]
        assert flown(sensor, seconds, beams)[1][-1].clear_m == pytest.approx(clear)


def test_how_far_it_sees_is_the_least_that_its_newest_messages_say() -> None:
    sensing = NearSensing(LIDAR, standing())
    assert sensing.limits_m == (0.0, math.inf)
    for most_cm, now_s in ((4000, NOW_S), (1200, NOW_S + 0.1), (2500, NOW_S + 0.2)):
        sensing.on_obstacle_distance(obstacle_distance([500], max_distance=most_cm), now_s)
        assert sensing.limits_m == pytest.approx((0.2, 0.01 * most_cm))
    limits_cm = ((20, 900), (50, 800), (20, 4000))  # sectors of unlike ones are clear as far
    beams = [
        beam(0.0, most, orientation=sector, min_distance=least, max_distance=most)
        for sector, (least, most) in enumerate(limits_cm)
    ]
    sensing, sweeps = flown(BEHIND_AUTOPILOT, 2.0, lambda _: beams)
    assert sweeps[-1].clear_m[:3] == pytest.approx([9.0, 8.0, BEHIND_AUTOPILOT.range_m])
    assert sensing.limits_m == pytest.approx((0.5, 8.0))
    # nor does its silence show more, where R is more than it sees: 16 m of 40
    told = lambda k: [beam(0.0)] if k < 2 else [WELL] * (k % 20 == 0)  # noqa: E731
    _, sweeps = flown(replace(BEHIND_AUTOPILOT, range_m=40.0), 5.0, told)
    assert sweeps[-1].clear_m.max() == pytest.approx(16.0)
