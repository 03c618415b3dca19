"""How vehicles move: point masses in moving air, stepped by the autopilot; no clock, no chance."""

from typing import Protocol


class Vehicle(Protocol):
    """The truth: what every kind of vehicle has.  True north, true east, up; mutable, one per run.

    The autopilot never reads the position from here (it has an Estimate): only sensors, the truth
    file and the ground do.
    """

    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float
    velocity_north_m_s: float
    velocity_east_m_s: float
    velocity_up_m_s: float
    acceleration_north_m_s2: float
    acceleration_east_m_s2: float
    acceleration_up_m_s2: float
    roll_rad: float
    pitch_rad: float
    heading_rad: float
    airspeed_m_s: float
    throttle: float
    """0 to 1."""
    wind_north_m_s: float
    """Where the air goes to; set from outside before each step, as are the other two."""
    wind_east_m_s: float
    wind_up_m_s: float

    def stand(self, altitude_amsl_m: float) -> None:
        """Come to rest at this height."""

    def fall(self, dt_s: float) -> None:
        """One step without motors."""
