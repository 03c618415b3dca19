"""A plane without a leg, and fences about it: it looks, goes elsewhere, or stays and says so."""

import math
from typing import Any

import numpy as np
import pytest
from made_up import MISSION
from numpy.typing import NDArray
from planning import PLANE_TASK
from renewed import replace

from companion.mavlink.autopilots import ARDUPLANE, PX4_FIXED_WING, PX4_MULTICOPTER
from companion.mission import machine
from companion.mission.decisions import Context
from companion.mission.events import (
    Command,
    Event,
    FenceChanged,
    Landed,
    Mode,
    Plan,
    Position,
    ScanDone,
    Setpoint,
    StartScan,
    StatusText,
)
from companion.mission.state import Flight, Phase, Scanning, State, Vehicle
from companion.mission.vehicle_traits import VehicleTraits
from companion.world.known_map import NO_ANSWER, Scan, empty_map
from companion.world.threats import CircleZone, PolygonZone
from companion.world.zone_index import ZoneIndex

FloatArray = NDArray[np.float64]
V, LOITER_M, HOVER = 18.0, 100.0, (0.0, 0.0, 100.0)
TASK = replace(PLANE_TASK, limits=replace(PLANE_TASK.limits, loiter_radius_m=LOITER_M))
PLANES = pytest.mark.parametrize(
    "traits", [ARDUPLANE.traits, PX4_FIXED_WING.traits], ids=lambda d: d.name
)


class Circling:
    """A plane that climbs on a circle about HOVER in guided mode, and has not scanned yet."""

    def __init__(self, traits: VehicleTraits, *, known_m: float | None = None) -> None:
        mission = replace(MISSION, task=TASK, targets_ne_m=((1_500.0, 0.0),), kind="plane")
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

    def draw(self, north_m: float, east_m: float, radius_m: float) -> list[Command]:
        zone = CircleZone(name="new", north_m=north_m, east_m=east_m, radius_m=radius_m)
        return self.take(FenceChanged(time_s=self.now_s, zones=(zone,)))

    def scanned(self, height_m: float) -> list[Command]:
        """The radar has answered for all of the map, or not at all."""
        shape = self.state.flight.known.upper_m.shape
        scan = Scan(
            row=0,
            column=0,
            heights_m=np.full(shape, height_m),
            radar_nea_m=np.broadcast_to(np.array(self.here), (*shape, 3)),
            range_m=1_600.0,
            drift_m=0.0,
            registration_m=0.0,
        )
        answered = int(math.isfinite(height_m))
        return self.take(ScanDone(time_s=self.now_s, scan=scan, asked=1, answered=answered))

    @property
    def hover_gap_m(self) -> float:
        """From the circle about the place where it stays to the nearest zone."""
        hover = self.state.flight.hover_nea_m
        assert hover is not None
        north, east = np.asarray(hover[0]), np.asarray(hover[1])
        gaps = [float(zone.distance_m(north, east)) for zone in self.state.task.zones]
        return min(gaps) - LOITER_M


def warnings(commands: list[Command]) -> list[str]:
    return [c.text for c in commands if isinstance(c, StatusText) and c.warning]


@PLANES
def test_a_fence_about_a_plane_that_has_not_scanned_makes_it_look_then_go(
    traits: VehicleTraits,
) -> None:
    plane = Circling(traits)
    plane.draw(0.0, 60.0, 80.0)
    at = plane.here
    commands = plane.fly(0.1)
    [look] = [c for c in commands if isinstance(c, StartScan)]
    assert math.dist(look.centre_nea_m, at) < V  # now and here, below the band
    assert warnings(commands) == ["looking for a place clear of new"]
    assert not [c for c in plane.fly(2.0) if isinstance(c, StartScan)]
    assert plane.state.flight.hover_nea_m == HOVER  # nothing is known: it stays meanwhile
    commands = [*plane.scanned(0.0), *plane.fly(0.5)]
    assert not [c for c in commands if isinstance(c, Plan)]
    assert plane.hover_gap_m >= TASK.required_clearance_m
    assert "circling elsewhere: too near to new" in warnings(commands)
    last = [c for c in commands if isinstance(c, Setpoint)][-1]
    assert last.stay
    assert last.position_nea_m == plane.state.flight.hover_nea_m
    hover = plane.state.flight.hover_nea_m
    assert hover is not None
    assert hover[2] == HOVER[2]  # the climb goes on


@PLANES
def test_over_known_ground_it_goes_at_once(traits: VehicleTraits) -> None:
    plane = Circling(traits, known_m=0.0)
    plane.draw(0.0, 60.0, 80.0)
    commands = plane.fly(0.1)
    assert not [c for c in commands if isinstance(c, StartScan)]
    assert plane.hover_gap_m >= TASK.required_clearance_m


@PLANES
def test_a_look_that_shows_nothing_leaves_it_where_it_is_and_says_so_once(
    traits: VehicleTraits,
) -> None:
    plane = Circling(traits)
    plane.draw(0.0, 60.0, 80.0)
    plane.fly(1.0)
    commands = [*plane.scanned(NO_ANSWER), *plane.fly(5.0)]
    assert plane.state.flight.hover_nea_m == HOVER
    assert warnings(commands) == ["nowhere to circle clear of new"]
    assert not [c for c in commands if isinstance(c, StartScan | Plan)]
    assert plane.state.phase is Phase.FLYING
    plane.draw(0.0, -60.0, 80.0)  # other rules: another look
    assert [c for c in plane.fly(0.1) if isinstance(c, StartScan)]


@PLANES
def test_a_scan_for_a_plan_becomes_the_look(traits: VehicleTraits) -> None:
    """It is not asked for twice, and its plan, of other rules, is never asked for."""
    plane = Circling(traits)
    flight = replace(plane.state.flight, search=Scanning(HOVER))
    plane.state = replace(plane.state, flight=flight)
    plane.draw(0.0, 60.0, 80.0)
    commands = [*plane.fly(0.5), *plane.scanned(0.0), *plane.fly(0.5)]
    assert not [c for c in commands if isinstance(c, StartScan | Plan)]
    assert plane.hover_gap_m >= TASK.required_clearance_m


@PLANES
@pytest.mark.parametrize("gap_m", [-0.6, 0.6])
def test_a_fence_far_enough_from_its_circle_changes_nothing(
    traits: VehicleTraits, gap_m: float
) -> None:
    """Dense about the limit: the required clearance of the circle, less half a metre."""
    plane = Circling(traits, known_m=0.0)
    distance_m = LOITER_M + TASK.required_clearance_m - 0.5 + gap_m
    plane.draw(distance_m + 70.0, 0.0, 70.0)
    plane.fly(0.5)
    assert (plane.state.flight.hover_nea_m == HOVER) is (gap_m > 0.0)


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


def test_what_hovers_and_what_somebody_else_flies_are_left_alone() -> None:
    for traits, mode in ((PX4_MULTICOPTER.traits, Mode.GUIDED), (ARDUPLANE.traits, Mode.OTHER)):
        craft = Circling(traits, known_m=0.0)
        craft.state = replace(craft.state, vehicle=replace(craft.state.vehicle, mode=mode))
        craft.draw(0.0, 60.0, 80.0)
        assert not warnings(craft.fly(0.1)) or mode is Mode.OTHER
        assert craft.state.flight.hover_nea_m in (HOVER, None)


def a_crowd(about: tuple[float, float]) -> tuple[PolygonZone, ...]:
    """Fifty jagged polygons of a hundred corners, one of them about the plane."""
    rng = np.random.default_rng(3)
    zones = []
    for k in range(50):
        middle = np.array(about) + (rng.uniform(-900.0, 900.0, 2) if k else 0.0)
        turns = np.linspace(0.0, math.tau, 100, endpoint=False)
        reach = rng.uniform(50.0, 90.0, 100)[:, None]
        places = middle + reach * np.stack([np.cos(turns), np.sin(turns)], axis=-1)
        vertices = tuple((n, e) for n, e in places.tolist())
        zones.append(PolygonZone(name=str(k), vertices_ne_m=vertices))
    return tuple(zones)


@PLANES
def test_among_fifty_zones_of_a_hundred_corners_no_event_looks_at_more_than_it_can(
    traits: VehicleTraits, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Counted are pairs of a point and an edge: 30 ns each.  The watchdog allows 0.2 s."""
    looked_at = 0
    far, pairs_of = PolygonZone.distance_m, ZoneIndex._pairs_of

    def whole(zone: PolygonZone, north: FloatArray, east: FloatArray) -> FloatArray:
        nonlocal looked_at
        looked_at += np.broadcast(north, east).size * len(zone.vertices_ne_m)
        return far(zone, north, east)

    def part(index: ZoneIndex, *pairs: Any) -> Any:
        nonlocal looked_at
        found = pairs_of(index, *pairs)
        looked_at += len(found.pair)
        return found

    monkeypatch.setattr(PolygonZone, "distance_m", whole)
    monkeypatch.setattr(ZoneIndex, "_pairs_of", part)
    plane = Circling(traits, known_m=0.0)
    zones = a_crowd(HOVER[:2])
    most = 0
    for event in (FenceChanged(time_s=plane.now_s, zones=zones), None):
        looked_at = 0
        commands = plane.take(event) if event is not None else plane.fly(0.1)
        most = max(most, looked_at)
        assert commands
    assert 0 < most < 300_000
    plane.fly(5.0)
    assert plane.state.phase is Phase.FLYING
    assert plane.hover_gap_m >= TASK.error_m
