"""Whatever comes, in whatever order: no exception in an autopilot, and only sense out of it.

Commands, setpoints, parameters, plans, faults and waiting, with NaN, infinities and the
largest floats that a frame can carry, thrown at each of the four personalities.
"""

import copy
import functools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    rule,
    run_state_machine_as_test,
)
from rig import STRONG

from vehicle_sim.autopilot.core import Autopilot
from vehicle_sim.autopilot.factory import PERSONALITIES
from vehicle_sim.autopilot.px4plane import SIH_AIRPLANE
from vehicle_sim.autopilot.values import (
    Ack,
    Command,
    Place,
    Sender,
    Setpoint,
    Text,
)
from vehicle_sim.conditions import GpsConditions
from vehicle_sim.dynamics.copter import Copter
from vehicle_sim.dynamics.plane import Plane, PlaneLimits
from vehicle_sim.plans import PlanItem, PlanKind, Plans
from vehicle_sim.sensors.gps import Gps, Receiver

GROUND_AMSL_M = 488.0
STEP_US = 10_000
_PLACE = {"latitude_deg": 47.4, "longitude_deg": 8.5, "altitude_amsl_m": GROUND_AMSL_M}

ANY = st.floats(width=32) | st.sampled_from([0.0, 1.0, -1.0, math.nan, math.inf, 3.4e38, 21196.0])
SENSIBLE = st.floats(-200.0, 200.0)
NUMBERS = SENSIBLE | ANY
PLACES = st.tuples(
    st.floats(47.39, 47.41) | ANY, st.floats(8.49, 8.51) | ANY, st.floats(400.0, 700.0) | ANY
)
MODES = st.sampled_from([0, 2, 3, 4, 5, 6, 7, 9, 10, 11, 12, 13, 15, 16, 17, 21])
COMMANDS = (
    st.sampled_from(
        (16, 17, 19, 20, 21, 22, 23, 34, 84, 92, 112, 115, 176, 177, 178, 179, 181, 185, 186, 187)
    )
    | st.sampled_from(
        (189, 192, 193, 195, 201, 205, 206, 207, 208, 211, 212, 214, 220, 222, 223, 224, 241, 245)
    )
    | st.sampled_from(
        (300, 400, 401, 410, 420, 519, 520, 530, 2000, 3000, 42424, 43000, 43001, 43002, 43003)
    )
)
SENDERS = st.builds(
    Sender, system=st.sampled_from([1, 255]), component=st.sampled_from([0, 190, 191, 195])
)
FRAMES = st.sampled_from([0, 1, 2, 3, 5, 6, 7, 8, 9, 10, 11, 12, 20, 255])
ITEMS = st.builds(
    PlanItem,
    frame=FRAMES,
    command=st.sampled_from([16, 17, 18, 19, 20, 21, 22, 31, 112, 177, 178, 201, 206])
    | st.sampled_from([5001, 5002, 5003, 5004, 5100, 0, 65535]),
    parameters=st.tuples(NUMBERS, NUMBERS, NUMBERS, NUMBERS),
    x=st.integers(473_900_000, 474_100_000) | st.integers(-(2**31), 2**31 - 1),
    y=st.integers(84_900_000, 85_100_000) | st.integers(-(2**31), 2**31 - 1),
    z_m=st.floats(0.0, 100.0) | ANY,
)


KINDS: dict[str, tuple[Any, Any]] = {
    "arducopter": ("ardupilot", "copter"),
    "arduplane": ("ardupilot", "plane"),
    "px4-multicopter": ("px4", "copter"),
    "px4-fixed-wing": ("px4", "plane"),
}


def make(kind: str) -> tuple[Autopilot, Receiver]:
    """One of the four, just booted."""
    firmware, flies = KINDS[kind]
    limits = SIH_AIRPLANE if firmware == "px4" else PlaneLimits()
    one = PERSONALITIES[firmware, flies]
    airframe = (
        Copter(**_PLACE, limits=STRONG) if flies == "copter" else Plane(**_PLACE, limits=limits)
    )
    return one.boot(airframe, {}, Plans(), np.random.default_rng(1)), one.receiver


def is_somewhere(place: Place) -> bool:
    """On or near the earth: what the wire can say."""
    return (
        -90.0 <= place.latitude_deg <= 90.0
        and -180.0 <= place.longitude_deg <= 180.0
        and -2e6 <= place.altitude_amsl_m <= 2e6
    )


@functools.cache
def begun(machine: type["Fuzz"], airborne: bool) -> dict[str, Any]:
    """What such a machine consists of, once it may be armed or flies."""
    one = object.__new__(machine)
    one.boot(airborne)
    return vars(one)


class Fuzz(RuleBasedStateMachine):
    """Everything that can happen to an autopilot."""

    kind = ""

    @initialize(airborne=st.booleans())
    def begin(self, airborne: bool) -> None:
        """Past the boot; perhaps in the air already."""
        vars(self).update(copy.deepcopy(begun(type(self), airborne)))

    def boot(self, airborne: bool) -> None:
        self.autopilot, receiver = make(self.kind)
        self.gps = Gps(receiver, np.random.default_rng(2))
        self.conditions = GpsConditions(fix_type=receiver.fix_type)
        self.ground_amsl_m = GROUND_AMSL_M
        self.now_us = 0
        self.run(45.0)  # ArduPilot uses its GPS from 42 s on
        if airborne:
            self.take_off()
            assert not self.autopilot.landed  # or half of what follows would be tried on the ground

    def take_off(self) -> None:
        """As each of them does it."""
        guided = {"arducopter": 4.0, "arduplane": 13.0}.get(self.kind)
        if guided is not None:
            self.say_all(176, (1.0, guided, 0.0, 0.0, 0.0, 0.0, 0.0))
            self.run(0.5)
        if self.kind != "arducopter":
            self.say_all(22, (0.0, 0.0, 0.0, math.nan, 47.402, 8.5, GROUND_AMSL_M + 30.0))
        self.say_all(400, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        if self.kind == "arducopter":
            self.run(1.0)
            self.say_all(22, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 30.0))
        self.run(20.0)

    def say_all(self, number: int, parameters: tuple[float, ...]) -> None:
        command = Command(
            sender=Sender(system=1, component=191),
            target_component=1,
            number=number,
            parameters=parameters,  # type: ignore[arg-type]
            frame=5 if number == 22 and self.kind != "arducopter" else None,
        )
        self.check(self.autopilot.on_command(command))

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 100.0)):
            self.now_us += STEP_US
            fix = self.gps.step(self.now_us, self.autopilot.vehicle, self.conditions)
            self.check(self.autopilot.step(self.now_us, 0.01, self.ground_amsl_m, fix))

    @staticmethod
    def check(replies: Any) -> None:
        """What is said can be packed."""
        for reply in replies:
            if isinstance(reply, Text):
                assert 0 <= reply.severity <= 7
                assert reply.text.isascii()
            elif isinstance(reply, Ack):
                assert 0 <= reply.result <= 9
                assert 0 <= reply.command <= 65535

    @rule(
        sender=SENDERS,
        number=COMMANDS,
        head=st.tuples(NUMBERS, NUMBERS, NUMBERS, NUMBERS),
        place=PLACES,
        frame=st.none() | FRAMES,
    )
    def command(
        self, sender: Sender, number: int, head: Any, place: Any, frame: int | None
    ) -> None:
        """Anything, with anything in it."""
        self.check(
            self.autopilot.on_command(
                Command(
                    sender=sender,
                    target_component=1,
                    number=number,
                    parameters=(*head, *place),
                    frame=frame,
                )
            )
        )

    @rule(mode=MODES, sub=st.integers(0, 9))
    def mode(self, mode: int, sub: int) -> None:
        """A mode by its number; of PX4 by main and sub number."""
        self.say_all(176, (1.0, float(mode), float(sub), 0.0, 0.0, 0.0, 0.0))

    @rule(
        local=st.booleans(),
        frame=FRAMES,
        mask=st.integers(0, 65535) | st.sampled_from([2496, 3520, 3527, 3576, 3072]),
        place=PLACES,
        ned=st.tuples(NUMBERS, NUMBERS, NUMBERS),
        velocity=st.tuples(NUMBERS, NUMBERS, NUMBERS),
        acceleration=st.tuples(NUMBERS, NUMBERS, NUMBERS),
        yaw=NUMBERS,
        times=st.integers(1, 3),
    )
    def setpoint(
        self,
        local: bool,
        frame: int,
        mask: int,
        place: Any,
        ned: Any,
        velocity: Any,
        acceleration: Any,
        yaw: float,
        times: int,
    ) -> None:
        """One, or a short stream of the same."""
        for _ in range(times):
            self.check(
                self.autopilot.on_setpoint(
                    Setpoint(
                        is_global=not local,
                        frame=frame,
                        type_mask=mask,
                        position=ned if local else place,
                        velocity_ned_m_s=velocity,
                        acceleration_ned_m_s2=acceleration,
                        yaw_rad=yaw,
                        yaw_rate_rad_s=yaw,
                    )
                )
            )
            self.run(0.2)

    @rule(data=st.data(), value=NUMBERS)
    def parameter(self, data: st.DataObject, value: float) -> None:
        """What the wire lets through: a finite value of any size (it refuses the others)."""
        row = data.draw(st.sampled_from(self.autopilot.parameters.rows))
        if math.isfinite(value):
            self.autopilot.parameters[row.name] = value
            self.check(self.autopilot.on_parameter(row.name))

    @rule(kind=st.sampled_from(PlanKind), items=st.lists(ITEMS, max_size=6))
    def plan(self, kind: PlanKind, items: list[PlanItem]) -> None:
        """Another mission, fence or rally list."""
        self.autopilot.plans[kind] = tuple(items)
        self.check(self.autopilot.on_plan(kind))

    @rule(sender=SENDERS, vehicle_type=st.sampled_from([0, 6, 18, 26]))
    def heartbeat(self, sender: Sender, vehicle_type: int) -> None:
        """Somebody else."""
        self.check(self.autopilot.on_heartbeat(sender, vehicle_type))

    @rule(enabled=st.booleans(), up_m=st.sampled_from([0.0, 30.0]))
    def sky(self, enabled: bool, up_m: float) -> None:
        """GPS is lost, jumps, comes back."""
        self.conditions = GpsConditions(
            enabled=enabled, fix_type=self.conditions.fix_type, glitch_up_m=up_m
        )

    @rule(what=st.sampled_from(["pilot", "reset", "origin", "hill"]), size_m=SENSIBLE)
    def fault(self, what: str, size_m: float) -> None:
        """As faults bring them about; and the ground is not flat."""
        if what == "pilot":
            self.check(self.autopilot.pilot_takes())
        elif what == "reset":
            self.check(self.autopilot.reset_estimate(size_m, -size_m))
        elif what == "origin":
            self.check(self.autopilot.move_origin(size_m, size_m, 0.1 * size_m))
        else:
            self.ground_amsl_m = GROUND_AMSL_M + 0.1 * size_m

    @rule(seconds=st.sampled_from([0.01, 0.1, 1.0, 4.0]))
    def wait(self, seconds: float) -> None:
        """Time passes."""
        self.run(seconds)

    @invariant()
    def makes_sense(self) -> None:
        """What it tells of itself is finite and within what the wire can say."""
        if not hasattr(self, "autopilot"):
            return
        status, estimate = self.autopilot.status(), self.autopilot.estimate
        vehicle = self.autopilot.vehicle
        assert 0 <= status.mode < 2**32
        assert 0 <= status.base_mode <= 255
        assert 0 <= status.system_status <= 8
        assert 0 <= status.landed_state <= 4
        assert 0 <= status.mission_current <= 65535
        assert self.autopilot.mode_name
        assert is_somewhere(estimate.place)
        for place in (self.autopilot.home, status.origin):
            assert place is None or is_somewhere(place), place
        if status.waypoint is not None:
            place = status.waypoint.place
            assert is_somewhere(place._replace(altitude_amsl_m=0.0))
            assert math.isfinite(place.altitude_amsl_m)  # it is told as a float
            assert math.isfinite(status.waypoint.distance_m)
        assert all(map(math.isfinite, self.autopilot.local_ned_m() or ()))
        target = self.autopilot.target_echo()
        assert target is None or not any(map(math.isinf, target.position_ned_m or ()))
        assert math.isfinite(estimate.velocity_north_m_s + estimate.velocity_east_m_s)
        assert math.isfinite(estimate.velocity_up_m_s)
        assert not math.isinf(estimate.horizontal_accuracy_m)
        assert math.isfinite(vehicle.roll_rad + vehicle.pitch_rad + vehicle.heading_rad)
        assert math.isfinite(vehicle.airspeed_m_s)
        assert 0.0 <= vehicle.throttle <= 1.0
        assert vehicle.altitude_amsl_m >= self.ground_amsl_m - 41.0


@pytest.mark.parametrize("kind", KINDS)
def test_autopilot_survives_whatever_comes(kind: str) -> None:
    machine = type("Machine", (Fuzz,), {"kind": kind})
    run_state_machine_as_test(
        machine,
        settings=settings(
            max_examples=12,
            stateful_step_count=25,
            deadline=None,
            derandomize=True,
            database=None,
            suppress_health_check=list(HealthCheck),
        ),
    )
