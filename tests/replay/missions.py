"""Missions for recorded flights, by vehicle and place."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from companion.config import load_mission
from companion.mission.mission import Mission

MISSION = str(Path(__file__).with_name("mission.toml"))
ZURICH = "origin.latitude_deg=47.397742 origin.longitude_deg=8.545594 "  # PX4's simulations
AEROPLANE = """
    vehicle.kind=plane vehicle.acceleration_m_s2=2.0 vehicle.climb_rate_m_s=2.5
    vehicle.climb_angle_deg=6.0 vehicle.dive_angle_deg=4.0 vehicle.loiter_radius_m=100.0
    vehicle.tracking_error_m=15.0 planner.scan_range_m=2000.0 planner.safety_distance_m=10.0
"""
MISSIONS = {
    "copter-canberra": "",
    "copter-zurich": ZURICH
    + "altitude.floor_amsl_m=492.0 altitude.ceiling_amsl_m=638.0 terrain.highest_amsl_m=476.0 "
    + "vehicle.tracking_error_m=2.0 planner.safety_distance_m=3.0",
    "plane-canberra": AEROPLANE
    + "altitude.floor_amsl_m=609.0 altitude.ceiling_amsl_m=834.0 terrain.highest_amsl_m=554.0 "
    + "vehicle.speed_m_s=22.0 vehicle.turn_radius_m=250.0",
    "plane-zurich": ZURICH
    + AEROPLANE
    + "altitude.floor_amsl_m=508.0 altitude.ceiling_amsl_m=738.0 terrain.highest_amsl_m=458.0 "
    + "vehicle.speed_m_s=14.0 vehicle.turn_radius_m=85.0",
}
"""By vehicle and place, what differs from the copter's mission near Canberra."""


def mission(name: str, **changes: Any) -> Mission:
    """One of them, with a search that takes no time."""
    settings = [*MISSIONS[name].split(), "planner.evaluations=100"]
    return replace(load_mission(MISSION, settings=settings), **changes)
