"""A plane without a leg: where it begins one, and a fence that is drawn about it."""

import pytest
from made_up import PLANES
from renewed import replace
from wild import Wild

from companion.mission import events
from companion.mission.events import FenceChanged, Mode, Position, StartScan
from companion.mission.state import Phase
from companion.mission.vehicle_traits import VehicleTraits
from companion.world.zones import CircleZone


def circling(traits: VehicleTraits) -> Wild:
    """A plane in guided mode that has just been told where to wait for its first leg."""
    plane = Wild.calmly(traits).aloft(Mode.GUIDED).fly_to(Phase.FLYING)
    return plane.run_until(lambda plane: plane.state.flight.hover_nea_m is not None)


@PLANES
@pytest.mark.parametrize("beyond", [0.9, 1.1])
def test_no_leg_is_planned_from_a_circle_that_the_plane_is_not_on(
    traits: VehicleTraits, beyond: float
) -> None:
    """Dense about the limit: a tracking error outside of the circle."""
    plane = circling(traits)
    limits, (north, east, up) = plane.mission.task.limits, plane.here
    away_m = limits.loiter_radius_m + beyond * limits.tracking_error_m
    flight = replace(plane.state.flight, hover_nea_m=(north + away_m, east, up), search=None)
    plane.state = replace(plane.state, flight=flight)
    speed, scans = (limits.speed_m_s, 0.0, 0.0), len(plane.sent(StartScan))
    for later_s in (0.1, 0.2):
        at_s = plane.now_s + later_s
        plane.take(Position(time_s=at_s, position_nea_m=plane.here, velocity_nea_m_s=speed))
    assert (len(plane.sent(StartScan)) > scans) is (beyond < 1.0)


@PLANES
@pytest.mark.parametrize("gap_m", [-0.6, 0.6])
def test_a_fence_too_near_to_its_circle_is_said_once_and_it_stays(
    traits: VehicleTraits, gap_m: float
) -> None:
    """Dense about the limit: the required clearance of the circle, less half a metre."""
    plane = circling(traits)
    task, hover = plane.mission.task, plane.state.flight.hover_nea_m
    assert hover is not None
    away_m = task.limits.loiter_radius_m + task.required_clearance_m - 0.5 + gap_m
    zone = CircleZone(name="new", north_m=hover[0] + away_m + 70.0, east_m=hover[1], radius_m=70.0)
    plane.take(FenceChanged(time_s=plane.now_s, zones=(zone,)))
    count = len(plane.said_to)
    plane.run_for(0.9)  # and no plan is there yet
    later = plane.said_to[count:]
    said = [c.text for c in later if isinstance(c, events.StatusText) and c.warning]
    assert said == (["circling too near to zone new"] if gap_m < 0.0 else [])
    setpoints = [c for c in later if isinstance(c, events.Setpoint)]
    assert setpoints
    assert all(each.stay and each.position_nea_m == hover for each in setpoints)
