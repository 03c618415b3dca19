"""The companion and a MAVProxy on two links of one autopilot, as docs/connecting.md has it."""

import sys
from pathlib import Path
from typing import Any

import pytest
from programs import Program, free_port

BIN = Path(sys.executable).parent
_READY_S = 60.0


@pytest.fixture
def companion(programs: Any, tmp_path: Path) -> Any:
    def start(connect: str) -> Program:
        arguments = "fly", "sitl-px4", "--connect", connect, "--out", tmp_path / "run", "--start"
        # at home, where its planner is compiled already
        return programs("companion", BIN / "companion", *arguments, folder=Path.home())

    return start


@pytest.fixture
def vehicle(programs: Any, tmp_path: Path) -> Any:
    def start(*ports: int) -> Program:
        links = [f"--connect=udpout:127.0.0.1:{port}" for port in ports]
        return programs(
            *("vehicle", BIN / "vehicle-sim", "sitl-px4", *links), folder=tmp_path / "vehicle"
        )

    return start


def test_what_is_typed_at_a_mavproxy_on_another_link_of_the_vehicle_is_for_the_companion(
    companion: Any, vehicle: Any, mavproxy: Any
) -> None:
    """As docs/in-flight.md has it typed; the vehicle forwards it."""
    to_companion, to_ground = free_port(), free_port()
    person = mavproxy(f"udpin:127.0.0.1:{to_ground}")
    vehicle(to_companion, to_ground)
    companion(f"udpin:127.0.0.1:{to_companion}")
    person.expect("Detected vehicle 1:195", _READY_S)
    person.type("set target_system 1")
    person.type("set target_component 195")
    person.expect("fence: 0 zones", _READY_S)  # its word, once it knows the vehicle
    person.ask("long DO_PAUSE_CONTINUE 0", "DO_PAUSE_CONTINUE: (TEMPORARILY_REJECTED|ACCEPTED)")
