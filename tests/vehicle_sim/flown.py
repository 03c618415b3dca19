"""A vehicle of any kind without links, told what to do in messages: into the air, and on."""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.dynamics.plane import Plane
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import parse_world

GROUND_M = 400.0
ALL = [(kind, autopilot) for kind in ("copter", "plane") for autopilot in ("ardupilot", "px4")]


class Flown:
    """Ready to be armed, on a plain at GROUND_M with these peaks and near things."""

    def __init__(
        self,
        kind: str,
        autopilot: str,
        *,
        parameters: Mapping[str, float] | None = None,
        peaks: Sequence[Mapping[str, float]] = (),
        longitude_deg: float = 8.0,
        north_m: float = 0.0,
        heading_deg: float = 0.0,
        faults: str = "",
        **things: Any,
    ) -> None:
        vehicle = {"kind": kind, "autopilot": autopilot, "parameters": dict(parameters or {})}
        vehicle |= {"north_m": north_m, "east_m": 0.0, "heading_deg": heading_deg}
        terrain = {"combine": "maximum", "ground_amsl_m": GROUND_M, "peaks": list(peaks)}
        table = {
            "schema": 1,
            "name": "flown",
            "origin": {"latitude_deg": 47.0, "longitude_deg": longitude_deg},
            "terrain": terrain,
            "vehicle": vehicle,
        }
        self.simulation = Simulation(parse_world(table | things), faults=faults)
        self.mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=195)
        self.is_px4 = autopilot == "px4"
        while not self.simulation.armable:
            self.simulation.step()

    @property
    def above_m(self) -> float:
        """Above the plain."""
        return self.simulation.vehicle.altitude_amsl_m - GROUND_M

    def command(self, number: int, *values: float) -> None:
        padded = [*values, *[0.0] * (7 - len(values))]
        message = mavlink.MAVLink_command_long_message(1, 1, number, 0, *padded)
        self.simulation.receive(0, message.pack(self.mav))

    def go(
        self,
        north_m_s: float,
        down_m_s: float,
        east_m_s: float = 0.0,
        *,
        at_m: tuple[float, float, float] | None = None,
    ) -> None:
        """A velocity, from where it is or through a place of the local frame."""
        mask = 0xDC7 if at_m is None else 0xDC0
        way = (*(at_m or (0.0, 0.0, 0.0)), north_m_s, east_m_s, down_m_s)
        fields = [0, 1, 1, 1, mask, *way, *[0] * 5]
        message = mavlink.MAVLink_set_position_target_local_ned_message(*fields)
        self.simulation.receive(0, message.pack(self.mav))

    def until(self, reached: Callable[[], bool], within_s: float, *aim: float) -> None:
        for k in range(round(within_s * 100.0)):
            if reached():
                return
            if aim and k % 20 == 0:
                self.go(*aim)
            self.simulation.step()
        raise AssertionError(f"it never came to that: {self.simulation.outcome()}")

    def into_the_air(self, height_m: float) -> None:
        simulation = self.simulation
        up = lambda: self.above_m > height_m - 0.5  # noqa: E731
        if isinstance(simulation.vehicle, Plane):
            if self.is_px4:
                self.command(22, 0, 0, 0, *[math.nan] * 4)  # for good straight on
            else:
                self.command(176, 1, 13)
            self.command(400, 1)
            self.until(up, 60.0)
            if not self.is_px4:
                self.command(176, 1, 7)  # CRUISE: straight on
        elif not self.is_px4:
            self.command(176, 1, 4)
            self.command(400, 1)
            self.command(22, *[0.0] * 6, height_m)
            self.until(up, 60.0)
        else:
            self.until(lambda: simulation.now_us % 1_000_000 == 0, 1.1, 0.0, 0.0)
            self.command(176, 1, 6)
            self.command(400, 1)
            self.until(up, 60.0, 0.0, -2.0)

    def truth(self) -> Sequence[dict[str, Any]]:
        return [json.loads(line) for line in self.simulation.take_truth()][1:]
