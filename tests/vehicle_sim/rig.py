"""An autopilot over level ground, without links: told what to do by values."""

import math
from collections.abc import Callable, Sequence
from typing import Any

from vehicle_sim.autopilot.values import Ack, Command, Reply, Sender, Setpoint, Text
from vehicle_sim.conditions import GpsConditions
from vehicle_sim.dynamics.copter import Limits
from vehicle_sim.sensors.gps import Fix, Gps

STEP_US, STEP_S = 10_000, 0.01
COMPANION = Sender(system=1, component=191)
ZERO = (0.0, 0.0, 0.0)
Vector = tuple[float, float, float]
GENTLE = Limits(
    speed_m_s=50.0,
    acceleration_m_s2=9.0,
    speed_vertical_m_s=5.0,
    acceleration_vertical_m_s2=5.0,
)
STRONG = Limits(
    speed_m_s=40.0,
    acceleration_m_s2=30.0,
    speed_vertical_m_s=10.0,
    acceleration_vertical_m_s2=9.0,
)
"""What airframes can do: one for sensors and weather, one for autopilots."""


class Rig:
    """What all four have in common; a vehicle's own adds how it gets into the air."""

    def __init__(
        self,
        autopilot: Any,
        ground_amsl_m: float,
        gps: Gps | None = None,
        conditions: GpsConditions | None = None,
    ) -> None:
        self.autopilot = autopilot
        self.ground_amsl_m = ground_amsl_m
        self.gps, self.gps_conditions = gps, conditions or GpsConditions()
        self.now_us = 0
        self.fix = Fix()
        self.said: list[tuple[float, Reply]] = []
        """With the time in seconds."""

    @property
    def now_s(self) -> float:
        """Since boot."""
        return self.now_us * 1e-6

    @property
    def height_m(self) -> float:
        """Above the ground, truly."""
        return self.autopilot.vehicle.altitude_amsl_m - self.ground_amsl_m

    @property
    def speed_m_s(self) -> float:
        """Over the ground, truly."""
        vehicle = self.autopilot.vehicle
        return math.hypot(vehicle.velocity_north_m_s, vehicle.velocity_east_m_s)

    @property
    def texts(self) -> list[str]:
        return [reply.text for _, reply in self.said if isinstance(reply, Text)]

    def when(self, text: str) -> list[float]:
        """The times at which this was said."""
        return [at for at, reply in self.said if isinstance(reply, Text) and reply.text == text]

    def receive(self) -> Fix:
        """The newest fix."""
        assert self.gps is not None
        return self.gps.step(self.now_us, self.autopilot.vehicle, self.gps_conditions)

    def take(self, replies: Sequence[Reply]) -> Sequence[Reply]:
        self.said.extend((self.now_s, reply) for reply in replies)
        return replies

    def step(self) -> None:
        """One hundredth of a second."""
        self.now_us += STEP_US
        self.fix = self.receive()
        self.take(self.autopilot.step(self.now_us, STEP_S, self.ground_amsl_m, self.fix))

    def run(self, seconds: float, each: Callable[[], None] | None = None) -> None:
        """Fly on, with something to do before each step."""
        for _ in range(round(seconds / STEP_S)):
            if each is not None:
                each()
            self.step()

    def run_until(self, reached: Callable[[], bool], within_s: float = 300.0) -> float:
        """Fly until this is so; returns how long it took, in seconds."""
        start_us = self.now_us
        while not reached():
            assert self.now_us - start_us < within_s * 1e6, "it never came to that"
            self.step()
        return (self.now_us - start_us) * 1e-6

    def answers(
        self,
        number: int,
        *parameters: float,
        frame: int | None = None,
        target_component: int = 1,
    ) -> list[int]:
        """What a command is answered at once."""
        command = Command(
            sender=COMPANION,
            target_component=target_component,
            number=number,
            parameters=(*parameters, *(0.0,) * (7 - len(parameters))),
            frame=frame,
        )
        acks = [r for r in self.take(self.autopilot.on_command(command)) if isinstance(r, Ack)]
        assert all((ack.to, ack.command) == (COMPANION, number) for ack in acks)
        return [ack.result for ack in acks]

    def command(self, number: int, *parameters: float, **fields: Any) -> int:
        """The only answer."""
        (answer,) = self.answers(number, *parameters, **fields)
        return answer

    def give(
        self,
        position: Vector = ZERO,
        velocity: Vector = ZERO,
        acceleration: Vector = ZERO,
        *,
        mask: int,
        frame: int = 1,
        is_global: bool = False,
        yaw_rad: float = 0.0,
    ) -> None:
        """A setpoint."""
        setpoint = Setpoint(
            is_global=is_global,
            frame=frame,
            type_mask=mask,
            position=position,
            velocity_ned_m_s=velocity,
            acceleration_ned_m_s2=acceleration,
            yaw_rad=yaw_rad,
        )
        self.take(self.autopilot.on_setpoint(setpoint))
