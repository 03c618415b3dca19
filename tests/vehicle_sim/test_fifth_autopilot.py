"""Another autopilot is data: a firmware's value in the list, and a world file that names it.

And what an autopilot does in one step is read in few functions.
"""

from dataclasses import replace

import pytest
from harness import Flown

from vehicle_sim.autopilot import factory
from vehicle_sim.autopilot.arducopter import FIRMWARE
from vehicle_sim.autopilot.values import Result
from vehicle_sim.errors import InputError
from vehicle_sim.parameters import Parameter
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import parse_world

_NUMBERS = {"GUIDED": 40, "LAND": 41, "RTL": 42}
"""custom_mode of its own."""
SPARROW = replace(
    FIRMWARE,
    profile=replace(FIRMWARE.profile, rates_hz={0: 2.0}, autopilot=0),  # MAV_AUTOPILOT_GENERIC
    modes=tuple(replace(m, number=_NUMBERS.get(m.name, m.number)) for m in FIRMWARE.modes),
    table=tuple(
        Parameter(name="WPNAV_SPEED", default=300.0) if row.name == "WPNAV_SPEED" else row
        for row in FIRMWARE.table
    ),
    refused=Result.DENIED,
    prearm_s=2.5,
    arms="Off we go",
)


@pytest.fixture(autouse=True)
def sparrow(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the list."""
    usual = factory.PERSONALITIES["ardupilot", "copter"]
    mine = replace(usual, firmware=SPARROW)
    monkeypatch.setitem(factory.PERSONALITIES, ("sparrow", "copter"), mine)


def test_a_world_names_it_and_it_flies_as_its_data_say() -> None:
    flown = Flown("copter", "sparrow")
    assert flown.command(224, 7) == Result.DENIED  # no such item: ArduPilot says FAILED
    assert [flown.command(176, 1, 40), flown.command(400, 1)] == [0, 0]
    assert flown.texts() == ["Off we go"]
    flown.command(22, *[0.0] * 6, 10.0)
    flown.until(lambda: flown.above_m > 9.5, 30.0)
    beat = flown.last("HEARTBEAT")
    assert (beat.custom_mode, beat.autopilot) == (40, 0)
    flown.go(0.0, 0.0, at_m=(200.0, 0.0, -10.0))
    speeds_m_s = list[float]()
    for _ in range(20):
        flown.run(1.0)
        speeds_m_s.append(flown.simulation.vehicle.velocity_north_m_s)
    assert flown.simulation.mode_name == "GUIDED"
    assert max(speeds_m_s) == pytest.approx(3.0, abs=0.5)
    flown.command(176, 1, 41)
    flown.until(lambda: not flown.simulation.armed, 60.0)
    assert flown.simulation.crash is None


@pytest.mark.parametrize(("name", "kind"), [("sparow", "copter"), ("ideal", "plane")])
def test_one_that_there_is_not_is_refused_with_those_that_there_are(name: str, kind: str) -> None:
    table = {
        "schema": 1,
        "name": "nobody",
        "origin": {"latitude_deg": 47.0, "longitude_deg": 8.0},
        "terrain": {"combine": "maximum", "ground_amsl_m": 0.0},
        "vehicle": {"kind": kind, "autopilot": name},
    }
    with pytest.raises(InputError, match=f"autopilot = '{name}': must be 'ardupilot' or"):
        Simulation(parse_world(table))


# --- one step -------------------------------------------------------------------------------------
