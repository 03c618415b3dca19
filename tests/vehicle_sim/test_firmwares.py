"""What every autopilot does alike, each by its own figures; another autopilot is data."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest
from harness import KINDS, Rig, flying, item

from vehicle_sim.autopilot.arducopter import FIRMWARE
from vehicle_sim.autopilot.factory import PERSONALITIES
from vehicle_sim.autopilot.legs import Route
from vehicle_sim.autopilot.values import Place, Result
from vehicle_sim.dynamics import GRAVITY_M_S2
from vehicle_sim.plans import PlanItem, PlanKind

ALL_FOUR = pytest.mark.parametrize("kind", KINDS, ids="-".join)
ACCEPTED, REJECTED, FAILED = Result.ACCEPTED, Result.TEMPORARILY_REJECTED, Result.FAILED
approx = pytest.approx


@ALL_FOUR
def test_every_mode_is_flown_or_refused_with_a_word(kind: Any) -> None:
    client, is_px4 = flying(*kind), kind[0] == "px4"
    modes = PERSONALITIES[kind].firmware.modes
    numbers = {mode.name: mode.number for mode in modes}
    back = numbers["Hold" if is_px4 else "GUIDED"]
    for mode in modes:
        since_s = client.now_s
        result, now = client.set_mode(mode.number), client.mode
        client.run(0.3)  # STABILIZE falls
        if result == 0:
            assert numbers[now] == mode.number
            assert client.simulation.armed, mode.name
        else:
            assert is_px4 or client.texts(since_s), mode.name
        assert client.set_mode(back) == 0
        client.run(1.0)
        assert client.last("HEARTBEAT").custom_mode == back


@ALL_FOUR
def test_in_flight_it_is_disarmed_by_force_alone_and_falls(kind: Any) -> None:
    client = flying(*kind)
    assert client.command(400, 0) != 0
    assert client.command(400, 0, 21196) == 0
    free_s = math.sqrt(2.0 * client.height_m / GRAVITY_M_S2)
    fell_s = client.until(lambda: client.simulation.landed, 20.0)
    assert free_s - 0.1 < fell_s < (free_s + 0.1 if kind[1] == "copter" else 15.0)


Leg = tuple[float, ...]
"""Command, north and east, height, parameters."""
HOVERS: tuple[Leg, ...] = (  # at 4 m/s and with a wait of 3 s, twice: it jumps back once
    *((16,), (22, 0, 0, 20.0), (178, 0, 0, 0, 1.0, 4.0), (16, 60.0, 0.0, 25.0)),
    *((16, 60.0, 40.0, 25.0, 3.0), (177, 0, 0, 0, 3.0, 1.0)),
)
GLIDES: tuple[Leg, ...] = (  # with a wait that a plane takes no notice of, and 20 s on a circle
    *((16,), (22, 0.0, 0.0, 50.0, 15.0), (178, 0.0, 0.0, 0.0, 0.0, 20.0), (16, 600.0, 0.0, 80.0)),
    *((16, 600.0, 600.0, 100.0, 300.0), (19, 0.0, 600.0, 80.0, 20.0), (16, -800.0, 0.0, 60.0)),
    *((16, -500.0, 0.0, 40.0), (21,)),
)
PX4_TAKE_OFF = (22, 300.0, 0.0, 40.0)
CORNERS = (PX4_TAKE_OFF, *((16, *place, 60.0) for place in ((500, 0), (500, 400), (100, 400))))
PX4_LEGS = (PX4_TAKE_OFF, (16, 40.0, 0.0, 60.0, 1.0), (16, 40.0, 40.0, 60.0, 1.0))
JUMPS_BACK = (1, 3, 4, 3, 4, 6)
MISSIONS = (
    # in which order legs are flown, how near it comes to each way point; seconds from its begin to
    # disarming, in which are waits, speeds and jumps; north and east of its end, and how near to it
    (KINDS[0], (*HOVERS, (20,)), JUMPS_BACK, 2.0, 128.9, (0.0, 0.0, 1.0)),
    (KINDS[0], (*HOVERS, (21, 30.0, 20.0)), JUMPS_BACK, 2.0, 113.6, (30.0, 20.0, 1.0)),
    # from 40 m above home it sinks wings level; circles are NPFG's switch distance away
    (KINDS[1], GLIDES, (1, *range(3, 9)), 60.0, 250.0, (400.0, 0.0, 400.0)),
    (KINDS[2], (*PX4_LEGS, (20,)), (0, 1, 2, 3), 10.5, 97.5, (0.0, 0.0, 2.0)),
    (KINDS[3], (*CORNERS, (21,)), range(5), 32.0, 184.9, (0.0, 0.0, 110.0)),
)


def on_mission(kind: Any, legs: Sequence[Leg]) -> Rig:
    """Armed, under way."""
    it = Rig(*kind)
    frame = 6 if kind[0] == "px4" else 3
    items = (item(it.home, int(number), *leg, frame=frame) for number, *leg in legs)
    it.plan(PlanKind.MISSION, *items)
    it.armable()
    if kind[0] == "ardupilot":
        it.set_mode("AUTO" if kind[1] == "plane" else "GUIDED")
        assert it.arm() == ACCEPTED
    assert it.mode == "AUTO" or it.command(300) == ACCEPTED
    return it


@pytest.mark.parametrize(("kind", "legs", "order", "near_m", "lasts_s", "ends"), MISSIONS)
def test_a_mission_is_flown_from_take_off_to_landing(
    kind: Any, legs: Sequence[Leg], order: Sequence[int], near_m: float, lasts_s: float, ends: Any
) -> None:
    it, seen = on_mission(kind, legs), list[Any]()
    begun_s = it.now_s
    while it.simulation.armed:
        seen.append((it.autopilot.route.current, it.ne_m))
        it.step()
        assert it.now_s < 400.0
    items = [current for current, _ in seen]
    assert [n for k, n in enumerate(items) if not k or items[k - 1] != n] == [*order]
    for _, north, east, *_ in (leg for leg in legs[2:] if leg[0] == 16):
        assert min(math.dist((north, east), at) for _, at in seen) < near_m
    assert it.now_s - begun_s == approx(lasts_s, rel=0.04)
    assert it.simulation.landed
    assert it.simulation.crash is None
    assert math.dist(it.ne_m, ends[:2]) < ends[2]
    told = [each.message.seq for each in it.all("MISSION_ITEM_REACHED")]
    assert {*told} >= {n for n, leg in enumerate(legs) if leg[0] == 16 and n in order}


def test_the_current_item_may_be_set_and_after_the_last_it_returns_and_circles_home() -> None:
    rig = on_mission(KINDS[1], GLIDES[:7]).run(25.0)
    assert rig.autopilot.mission_state() == 3
    assert [rig.command(224, 20.0), rig.command(224, 6.0)] == [FAILED, ACCEPTED]
    assert rig.autopilot.route.current == 6
    rig.until(lambda: math.dist(rig.ne_m, (-800.0, 0.0)) < 60.0)
    rig.until(lambda: rig.mode == "RTL", 5.0)
    assert rig.autopilot.mission_state() == 5
    assert math.hypot(*rig.run(90.0).ne_m) == approx(97.4, abs=3.0)  # recorded flight, 298 s
    assert rig.height_m == approx(100.0, abs=1.0)


def test_an_endless_jump_between_nothings_ends() -> None:
    nothing = item((47.0, 8.0), 16)
    forever = PlanItem(frame=0, command=177, parameters=(1.0, -1.0, 0.0, 0.0))
    here, route = Place(47.0, 8.0, 488.0), Route(first_item=1)
    assert route.seek((nothing, forever), 1, (here, here, 488.0), now_s=0.0) is None
    assert route.complete


SPARROW = replace(
    FIRMWARE,
    autopilot=0,  # MAV_AUTOPILOT_GENERIC
    modes=tuple(replace(mode, number=40 + mode.number) for mode in FIRMWARE.modes),
    refused=Result.DENIED,
    prearm_s=2.5,
    arms="Off we go",
)


def test_another_autopilot_of_a_world_flies_by_its_data(monkeypatch: pytest.MonkeyPatch) -> None:
    mine = replace(PERSONALITIES["ardupilot", "copter"], firmware=SPARROW)
    monkeypatch.setitem(PERSONALITIES, ("sparrow", "copter"), mine)
    flown = Rig("sparrow").armable()
    assert flown.command(224, 7) == Result.DENIED  # no such item: ArduPilot says FAILED
    flown.climb(10.0)
    assert flown.texts() == ["Off we go"]
    beat = flown.last("HEARTBEAT")
    assert (beat.custom_mode, beat.autopilot, flown.mode) == (44, 0, "GUIDED")
