"""How vehicles move: point masses in moving air, stepped by the autopilot; no clock, no chance."""

from dataclasses import dataclass, field

from vehicle_sim.geodesy import around, metres_per_degree

GRAVITY_M_S2 = 9.80665


@dataclass(slots=True, kw_only=True, eq=False)
class Vehicle:
    """The truth: what every kind of vehicle has.  True north, true east, up; one per run.

    The autopilot never reads the position from here (it has an Estimate): only sensors, the truth
    file and the ground do.  Mutable, with plain floats, on purpose: this is the inner loop, a
    hundred steps for each second of flight, and no arrays are involved.  Position is geographic
    (geodesy.py says why).
    """

    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float
    heading_rad: float = 0.0
    velocity_m_s: complex = field(init=False, default=0j)
    """North + east j, as are acceleration and wind."""
    velocity_up_m_s: float = field(init=False, default=0.0)
    acceleration_m_s2: complex = field(init=False, default=0j)
    acceleration_up_m_s2: float = field(init=False, default=0.0)
    roll_rad: float = field(init=False, default=0.0)
    pitch_rad: float = field(init=False, default=0.0)
    airspeed_m_s: float = field(init=False, default=0.0)
    throttle: float = field(init=False, default=0.0)
    """0 to 1."""
    wind_m_s: complex = field(init=False, default=0j)
    """Where the air goes to; set from outside before each step, as is the other one."""
    wind_up_m_s: float = field(init=False, default=0.0)
    stands: bool = field(init=False, default=True)
    """The ground carries it: at rest, or rolling on its wheels."""
    broken: bool = field(init=False, default=False)
    """It has hit something in the air: it falls, and nothing carries it."""

    @property
    def velocity_neu_m_s(self) -> tuple[float, float, float]:
        """North, east, up."""
        return self.velocity_m_s.real, self.velocity_m_s.imag, self.velocity_up_m_s

    def stand(self, altitude_amsl_m: float) -> None:
        """Come to rest at this height, level and without motion."""
        self.altitude_amsl_m = altitude_amsl_m
        self.velocity_m_s = self.acceleration_m_s2 = 0j
        self.velocity_up_m_s = self.acceleration_up_m_s2 = 0.0
        self.roll_rad = self.pitch_rad = self.throttle = self.airspeed_m_s = 0.0
        self.stands, self.broken = True, False

    def hit(self) -> None:
        """Something stops it in the air."""
        self.broken, self.velocity_m_s = True, 0j

    def fall(self, dt_s: float) -> None:
        """One step without motors: free fall."""
        self._move(self.velocity_m_s, self.velocity_up_m_s - GRAVITY_M_S2 * dt_s, dt_s)

    def _move(self, level_m_s: complex, up_m_s: float, dt_s: float) -> None:
        """Take on this velocity; the position advances by the mean of the old and the new."""
        metres_north, metres_east = metres_per_degree(self.latitude_deg)
        half_s = 0.5 * dt_s
        step_m = (self.velocity_m_s + level_m_s) * half_s
        self.latitude_deg += step_m.real / metres_north
        self.longitude_deg = around(self.longitude_deg + step_m.imag / metres_east)
        self.altitude_amsl_m += (self.velocity_up_m_s + up_m_s) * half_s
        self.velocity_m_s, self.velocity_up_m_s = level_m_s, up_m_s
