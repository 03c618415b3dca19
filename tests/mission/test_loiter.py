"""A plane without a leg: where it begins one, and a fence that is drawn about it."""

import math

import numpy as np
import pytest
from made_up import MISSION
from numpy.typing import NDArray
from planning import PLANE_TASK
from renewed import replace

from companion.mavlink.autopilots import ARDUPLANE, PX4_FIXED_WING
from companion.mission import events, machine
from companion.mission.decisions import Context
from companion.mission.events import Command, Event, FenceChanged, Landed, Mode, Position, StartScan
from companion.mission.state import Flight, Phase, State, Vehicle
from companion.mission.vehicle_traits import VehicleTraits
from companion.world.known_map import empty_map
from companion.world.zones import CircleZone

FloatArray = NDArray[np.float64]
V, LOITER_M, HOVER = 18.0, 100.0, (0.0, 0.0, 100.0)
TASK = replace(PLANE_TASK, limits=replace(PLANE_TASK.limits, loiter_radius_m=LOITER_M))
PLANES = pytest.mark.parametrize(
    "traits", [ARDUPLANE.traits, PX4_FIXED_WING.traits], ids=lambda d: d.name
)


class Circling:
    """A plane that climbs on a circle about HOVER in guided mode, and has not scanned yet."""

    def __init__(self, traits: VehicleTraits, *, known_m: float | None = None) -> None:
        mission = replace(MISSION, task=TASK, targets_ne_m=((1_500.0, 0.0),))
        self.context = Context(mission=mission, seed=1, go=True)
        known = empty_map(TASK.cell_m, TASK.limits.north_m, TASK.limits.east_m)
        if known_m is not None:
            known.upper_m[:], known.seen[:] = known_m, True
        self.now_s, self.turned, self.said = 100.0, 0.0, list[Command]()
        vehicle = Vehicle(
            traits=traits,
            mode=Mode.GUIDED,
            armed=True,
            status_at_s=1e6,
            landed=Landed.IN_AIR,
            fix_good=True,
            fix_at_s=1e6,
            estimator_good=True,
            estimator_at_s=1e6,
        )
        flight = Flight(known=known, hover_nea_m=HOVER, progress_at_s=100.0, echoed_at_s=1e6)
        self.state = replace(
            State.of(mission, known),
            phase=Phase.FLYING,
            vehicle=vehicle,
            flight=flight,
            airborne=True,
            now_s=100.0,
        )
        self.fly(0.3)

    @property
    def here(self) -> tuple[float, float, float]:
        return LOITER_M * math.cos(self.turned), LOITER_M * math.sin(self.turned), 70.0

    def take(self, event: Event) -> list[Command]:
        self.state, commands = machine.step(self.state, event, self.context)
        self.said += commands
        return commands

    def fly(self, seconds: float) -> list[Command]:
        """Round and round HOVER, whatever it is told."""
        commands: list[Command] = []
        for _ in range(round(seconds / 0.1)):
            self.now_s += 0.1
            self.turned += 0.1 * V / LOITER_M
            across = (-V * math.sin(self.turned), V * math.cos(self.turned), 0.0)
            commands += self.take(
                Position(time_s=self.now_s, position_nea_m=self.here, velocity_nea_m_s=across)
            )
        return commands


@PLANES
@pytest.mark.parametrize("beyond", [0.9, 1.1])
def test_no_leg_is_planned_from_a_circle_that_the_plane_is_not_on(
    traits: VehicleTraits, beyond: float
) -> None:
    """Dense about the limit: a tracking error outside of the circle."""
    plane = Circling(traits, known_m=0.0)
    plane.fly(1.0)
    away_m = LOITER_M + beyond * TASK.limits.tracking_error_m
    north, east, _ = plane.here
    hover = (north + away_m, east, plane.here[2])
    flight = replace(plane.state.flight, hover_nea_m=hover)
    plane.state = replace(plane.state, flight=flight)
    commands: list[Command] = []
    for time_s in (plane.now_s + 0.1, plane.now_s + 0.2):
        commands += plane.take(
            Position(time_s=time_s, position_nea_m=plane.here, velocity_nea_m_s=(V, 0.0, 0.0))
        )
    assert any(isinstance(c, StartScan) for c in commands) is (beyond < 1.0)


@PLANES
@pytest.mark.parametrize("gap_m", [-0.6, 0.6])
def test_a_fence_too_near_to_its_circle_is_said_once_and_it_stays(
    traits: VehicleTraits, gap_m: float
) -> None:
    """Dense about the limit: the required clearance of the circle, less half a metre."""
    plane = Circling(traits, known_m=0.0)
    distance_m = LOITER_M + TASK.required_clearance_m - 0.5 + gap_m
    zone = CircleZone(name="new", north_m=distance_m + 70.0, east_m=0.0, radius_m=70.0)
    plane.take(FenceChanged(time_s=plane.now_s, zones=(zone,)))
    commands = plane.fly(1.0)
    said = [c.text for c in commands if isinstance(c, events.StatusText) and c.warning]
    assert said == (["circling too near to zone new"] if gap_m < 0.0 else [])
    setpoints = [c for c in commands if isinstance(c, events.Setpoint)]
    assert setpoints
    assert all(each.stay and each.position_nea_m == HOVER for each in setpoints)
