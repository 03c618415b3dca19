"""AUTO: missions, item by item."""

import math

import pytest
from tracking_copter import GROUND_M, Flown

from vehicle_sim.autopilot.earth import FlatEarth
from vehicle_sim.autopilot.values import Place
from vehicle_sim.plans import Jumps, PlanItem, PlanKind

HOME = Place(latitude_deg=47.0, longitude_deg=8.0, altitude_amsl_m=GROUND_M)
AUTO = 3


def item(
    command: int, north_m: float = 0.0, east_m: float = 0.0, z_m: float = 0.0, *p: float
) -> PlanItem:
    place = FlatEarth(HOME).place(north_m, east_m, 0.0)
    p1, p2, p3, p4 = (*p, *[0.0] * (4 - len(p)))
    return PlanItem(
        frame=3,
        command=command,
        parameters=(p1, p2, p3, p4),
        x=round(place.latitude_deg * 1e7),
        y=round(place.longitude_deg * 1e7),
        z_m=z_m,
    )


def planned(*items: PlanItem) -> Flown:
    it = Flown(ANGLE_MAX=4500.0)
    it.autopilot.plans[PlanKind.MISSION] = (item(16), *items)
    it.autopilot.on_plan(PlanKind.MISSION)
    it.run(42.5)
    return it


def test_a_mission_is_flown_from_take_off_to_landing() -> None:
    it = planned(
        item(22, z_m=20.0), item(16, 100.0, 0.0, 25.0), item(16, 100.0, 60.0, 25.0, 3.0), item(20)
    )
    assert it.command(176, 1, 4) == 0
    assert it.command(400, 1) == 0
    assert it.command(300) == 0
    assert it.autopilot.mode_name == "AUTO"
    visited = []
    for place in ((100.0, 0.0), (100.0, 60.0)):
        it.run_until(lambda at=place: math.dist(it.local_m()[:2], at) < 2.0, within_s=90.0)
        visited.append(it.local_m()[2])
    assert visited == pytest.approx([25.0, 25.0], abs=1.0)
    it.run_until(lambda: not it.autopilot.armed, within_s=150.0)
    assert math.hypot(*it.local_m()[:2]) < 1.0


def test_a_landing_item_comes_down_where_it_says() -> None:
    it = planned(item(22, z_m=10.0), item(21, 30.0, 0.0))
    it.command(176, 1, 4)
    it.command(400, 1)
    it.command(300)
    it.run_until(lambda: it.autopilot.status().landed_state == 4, within_s=60.0)
    it.run_until(lambda: not it.autopilot.armed, within_s=60.0)
    assert it.local_m()[0] == pytest.approx(30.0, abs=1.0)


def test_the_current_item_can_be_set() -> None:
    it = planned(item(22, z_m=20.0), item(16, 300.0), item(16, 0.0, 300.0, 20.0))
    it.command(176, 1, 4)
    it.command(400, 1)
    it.command(300)
    it.run_until(lambda: it.autopilot.route.current == 2, within_s=60.0)
    assert it.command(224, 3) == 0
    it.run(10.0)
    assert it.local_m()[1] > 10.0
    assert it.command(224, 9) == 4


def test_jumps_are_counted() -> None:
    jump = PlanItem(frame=0, command=177, parameters=(1.0, 2.0, 0.0, 0.0))
    items = (item(16), item(16, 10.0), item(16, 20.0), jump, item(20))
    jumps, visited = Jumps(1), []
    for number, each in jumps.walk(items, 1, 100):
        visited += [number] if each is not jump else []
    assert visited == [1, 2, 1, 2, 1, 2, 4]


def test_an_endless_jump_between_nothings_ends() -> None:
    forever = PlanItem(frame=0, command=177, parameters=(1.0, -1.0, 0.0, 0.0))
    assert len(list(Jumps(1).walk((item(16), forever), 1, 50))) == 50
