"""Another autopilot is data: a firmware's value in the list, and a world file that names it.

And what an autopilot does in one step is read in few functions.
"""

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import pytest
from harness import OFFBOARD, Flown
from rigs import ArduCopter, Px4Copter, Rig, circling, cruising, hovering

from vehicle_sim.autopilot import factory
from vehicle_sim.autopilot.arducopter import FIRMWARE
from vehicle_sim.autopilot.values import Result
from vehicle_sim.parameters import Parameter

_NUMBERS = {"GUIDED": 40, "LAND": 41, "RTL": 42}
"""custom_mode of its own."""
SPARROW = replace(
    FIRMWARE,
    rates_hz={0: 2.0},
    autopilot=0,  # MAV_AUTOPILOT_GENERIC
    modes=tuple(replace(m, number=_NUMBERS.get(m.name, m.number)) for m in FIRMWARE.modes),
    table=tuple(
        Parameter(name="WPNAV_SPEED", default=300.0) if row.name == "WPNAV_SPEED" else row
        for row in FIRMWARE.table
    ),
    refused=Result.DENIED,
    prearm_s=2.5,
    arms="Off we go",
)


def test_a_world_names_it_and_it_flies_as_its_data_say(monkeypatch: pytest.MonkeyPatch) -> None:
    mine = replace(factory.PERSONALITIES["ardupilot", "copter"], firmware=SPARROW)
    monkeypatch.setitem(factory.PERSONALITIES, ("sparrow", "copter"), mine)
    flown = Flown("copter", "sparrow")
    assert flown.command(224, 7) == Result.DENIED  # no such item: ArduPilot says FAILED
    assert [flown.command(176, 1, 40), flown.command(400, 1)] == [0, 0]
    assert flown.texts() == ["Off we go"]
    flown.command(22, *[0.0] * 6, 10.0)
    flown.until(lambda: flown.above_m > 9.5, 30.0)
    beat = flown.last("HEARTBEAT")
    assert (beat.custom_mode, beat.autopilot, flown.simulation.mode_name) == (40, 0, "GUIDED")
    flown.go(0.0, 0.0, at_m=(200.0, 0.0, -10.0))
    speeds_m_s = list[float]()
    flown.run(20.0, lambda: speeds_m_s.append(flown.simulation.vehicle.velocity_m_s.real))
    assert max(speeds_m_s) == pytest.approx(3.0, abs=0.5)


FLYING: dict[str, Callable[[], Rig]] = {
    "arducopter": hovering,
    "arduplane": circling,
    "ideal": lambda: ArduCopter(drag=False).airborne(),
    "px4copter": lambda: Px4Copter().take_off(),
    "px4plane": cruising,
}


@pytest.mark.parametrize("name", FLYING)
def test_a_step_that_follows_a_path_calls_at_most_15_functions_of_the_autopilots(name: str) -> None:
    rig, called, counts = FLYING[name](), set[Any](), list[int]()
    rig.aim((300.0, 0.0, -40.0), (5.0, 0.0, 0.0))
    if name == "px4plane":
        assert rig.command(176, 1.0, *OFFBOARD) == Result.ACCEPTED
    where = str(Path(factory.__file__).parent)

    def note(at: Any, event: str, _: Any) -> None:
        if event == "call" and at.f_code.co_filename.startswith(where):
            called.add(at.f_code)

    for k in range(200):
        if name == "arduplane":
            rig.command(192, -1.0, 1.0, 0.0, 0.0, -35.36, 149.17, 80.0, frame=3)
        elif k % 10 == 0:
            rig.aim((300.0, 0.0, -40.0), (5.0, 0.0, 0.0))
        called.clear()
        sys.setprofile(note)
        rig.step()
        sys.setprofile(None)
        counts.append(len(called))
    assert 5 < median(counts) <= 15
