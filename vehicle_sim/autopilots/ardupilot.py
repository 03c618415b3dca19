"""ArduCopter as measured: boot, modes, arming, take-off, and what it answers.

Times are vehicle time since boot.  Nothing here knows of frames, sockets or clocks.
"""

import math
from typing import final

from vehicle_sim.autopilots import (
    Ack,
    Command,
    Interval,
    Place,
    Reply,
    Report,
    Send,
    Setpoint,
    Text,
)
from vehicle_sim.autopilots.facts import (
    ABOVE_HOME_FRAME,
    EKF_WITH_GPS,
    EKF_WITHOUT_GPS,
    FORCE_DISARM,
    GPS_GLOBAL_ORIGIN,
    GPS_US,
    HEALTHY_US,
    HEARTBEAT,
    HOME_POSITION,
    ORIGIN_US,
    POSITION_US,
    STANDBY_US,
    STREAMABLE,
    CommandNumber,
    Mode,
    Result,
)
from vehicle_sim.autopilots.flight import Flight
from vehicle_sim.autopilots.guided import Tuning
from vehicle_sim.autopilots.setpoints import Bearings, Stop, flat_earth_ned_m, read_setpoint
from vehicle_sim.dynamics import GRAVITY_M_S2, Copter


@final
class ArduCopter:
    """One vehicle's autopilot; steers the copter that it is given."""

    def __init__(
        self, copter: Copter, tuning: Tuning, *, heading_rad: float, hardware_id: int = 1
    ) -> None:
        self._hardware_id = hardware_id
        self._flight = Flight(copter, tuning, heading_rad=heading_rad)
        self._home: Place | None = None
        self._origin: Place | None = None
        self._refused_text: str | None = None

    @property
    def mode_name(self) -> str:
        """The mode it flies in."""
        return self._flight.mode.name

    @property
    def armed(self) -> bool:
        """Whether the motors may turn."""
        return self._flight.armed

    @property
    def landed(self) -> bool:
        """Whether it stands on the ground."""
        return self._flight.landed

    @property
    def _position_ok(self) -> bool:
        """Whether the estimator has a horizontal position."""
        return self._flight.now_us >= POSITION_US

    def step(self, now_us: int, dt_s: float, ground_amsl_m: float) -> list[Reply]:
        """Fly on to now_us, over ground of this height."""
        before_us = self._flight.now_us
        replies = self._flight.step(now_us, dt_s, ground_amsl_m)
        return self._boot(before_us) + replies if before_us < POSITION_US else replies

    def _boot(self, before_us: int) -> list[Reply]:
        """What happens by itself while the estimator starts."""
        if before_us < ORIGIN_US <= self._flight.now_us:
            self._home = self._origin = self._flight.place()
            return [
                Text(severity=6, text="EKF3 IMU0 origin set"),
                Send(message=GPS_GLOBAL_ORIGIN),
                Send(message=HOME_POSITION),
            ]
        if before_us < POSITION_US <= self._flight.now_us:
            return [Text(severity=6, text="EKF3 IMU0 is using GPS")]
        return []

    # --- commands -----------------------------------------------------------------------------

    def on_command(self, command: Command) -> list[Reply]:
        """Do what is asked, or say why not."""
        result, replies = Result.UNSUPPORTED, list[Reply]()
        if command.target_component in (0, 1):
            p = command.parameters
            match command.number:
                case CommandNumber.DO_SET_MODE:
                    result, replies = self._set_mode(p[0], p[1])
                case CommandNumber.COMPONENT_ARM_DISARM:
                    result, replies = self._arm_or_disarm(p[0], p[1])
                case CommandNumber.NAV_TAKEOFF:
                    result, replies = self._take_off(p[6], command.frame)
                case CommandNumber.SET_MESSAGE_INTERVAL:
                    result, replies = _set_interval(p[0], p[1], p[2])
                case CommandNumber.REQUEST_MESSAGE:
                    result, replies = self._send_once(p[0])
                case _:
                    pass
        return [Ack(to=command.sender, command=command.number, result=result), *replies]

    def _set_mode(self, flags: float, number: float) -> tuple[Result, list[Reply]]:
        if not (math.isfinite(flags) and int(flags) & 1):
            return Result.DENIED, []
        mode = next((m for m in Mode if m == number), None)
        if mode is None:
            return Result.FAILED, [Text(severity=4, text=f"Mode {number:.0f} is not simulated")]
        if mode is not self._flight.mode:
            self._flight.change_mode(mode)
        return Result.ACCEPTED, []

    def _arm_or_disarm(self, arm: float, force: float) -> tuple[Result, list[Reply]]:
        if arm == 0.0:
            if not self.landed and force != FORCE_DISARM:
                return Result.FAILED, []
            self._flight.disarm()
            return Result.ACCEPTED, []
        if arm != 1.0:
            return Result.UNSUPPORTED, []
        if self.armed:
            return Result.ACCEPTED, []
        refusal = self._arming_refusal()
        if refusal is not None:
            return Result.FAILED, [Text(severity=2, text=refusal)]
        self._flight.armed = True
        self._home = self._flight.place()
        return Result.ACCEPTED, [Send(message=HOME_POSITION)]

    def _arming_refusal(self) -> str | None:
        mode = self._flight.mode
        if mode in (Mode.LAND, Mode.BRAKE):
            return f"Arm: {mode.name} mode not armable"
        if mode is Mode.GUIDED and not self._position_ok:
            return "Arm: Need Position Estimate"
        if self._flight.now_us < HEALTHY_US:
            return "Arm: Waiting for estimator"
        return None if self.landed else "Arm: Not on the ground"

    def _take_off(self, above_home_m: float, frame: int | None) -> tuple[Result, list[Reply]]:
        if frame not in (None, ABOVE_HOME_FRAME):
            return Result.DENIED, []
        flight, home = self._flight, self._home
        ready = flight.armed and flight.landed and flight.mode is Mode.GUIDED and self._position_ok
        if not ready or flight.taking_off or home is None:
            return Result.FAILED, []
        altitude_amsl_m = home.altitude_amsl_m + above_home_m
        if not flight.place().altitude_amsl_m < altitude_amsl_m < math.inf:
            return Result.FAILED, []
        flight.take_off(altitude_amsl_m)
        return Result.ACCEPTED, []

    def _send_once(self, message: float) -> tuple[Result, list[Reply]]:
        if message not in STREAMABLE:
            return Result.FAILED, []
        if message in (HOME_POSITION, GPS_GLOBAL_ORIGIN) and self._origin is None:
            return Result.FAILED, []
        return Result.ACCEPTED, [Send(message=int(message))]

    # --- setpoints ----------------------------------------------------------------------------

    def on_setpoint(self, setpoint: Setpoint) -> list[Reply]:
        """Steer for this from now on; outside GUIDED it is not even read."""
        flight = self._flight
        if flight.mode is not Mode.GUIDED or self._home is None or self._origin is None:
            return []
        flight.abandon_takeoff()
        bearings = Bearings(
            vehicle=flight.place(),
            heading_rad=flight.heading_rad,
            home=self._home,
            origin=self._origin,
        )
        target = read_setpoint(setpoint, bearings)
        if not isinstance(target, Stop):
            flight.guided.take(target, flight.now_us, flight.copter)
            self._refused_text = None
            return []
        flight.guided.stop()
        told, self._refused_text = self._refused_text, target.text
        if target.text is None or target.text == told:
            return []
        return [Text(severity=2, text=target.text)]

    # --- telemetry ----------------------------------------------------------------------------

    def _base_mode(self) -> int:
        """Custom mode and manual input enabled, stabilised; guided as ArduCopter counts it."""
        guided = self._flight.mode in (Mode.GUIDED, Mode.BRAKE)
        return 0x51 | (0x08 if guided else 0) | (0x80 if self.armed else 0)

    def report(self) -> Report:
        """What there is to tell."""
        flight, copter, origin = self._flight, self._flight.copter, self._origin
        now_us, place = flight.now_us, flight.place()
        sine, cosine = math.sin(flight.heading_rad), math.cos(flight.heading_rad)
        a_n, a_e = copter.acceleration_north_m_s2, copter.acceleration_east_m_s2
        lift = GRAVITY_M_S2 + copter.acceleration_up_m_s2
        positioned = self._position_ok and origin is not None
        status = 1 if now_us < STANDBY_US else 3 if flight.landed else 4
        return Report(
            time_us=now_us,
            place=place,
            velocity_ned_m_s=(
                copter.velocity_north_m_s,
                copter.velocity_east_m_s,
                -copter.velocity_up_m_s,
            ),
            roll_rad=math.atan2(a_e * cosine - a_n * sine, lift),
            pitch_rad=-math.atan2(a_n * cosine + a_e * sine, lift),
            heading_rad=flight.heading_rad % math.tau,
            mode=flight.mode,
            base_mode=self._base_mode(),
            system_status=status,
            landed_state=flight.landed_state(),
            health_ok=now_us >= HEALTHY_US,
            gps_fix=now_us >= GPS_US,
            ekf_flags=EKF_WITH_GPS if positioned else EKF_WITHOUT_GPS,
            position_ok=positioned,
            home=self._home,
            origin=origin,
            local_ned_m=flat_earth_ned_m(origin, place) if positioned and origin else None,
            target=flight.echo(origin) if origin else None,
            hardware_id=self._hardware_id,
        )


def _set_interval(message: float, interval_us: float, p3: float) -> tuple[Result, list[Reply]]:
    """MAV_CMD_SET_MESSAGE_INTERVAL; 0 restores the default, -1 stops."""
    if message not in STREAMABLE:
        return Result.DENIED, [Text(severity=4, text=f"No ap_message for mavlink id {message:.0f}")]
    if p3 != 0.0 or not -1.0 <= interval_us <= 1e9:
        return Result.DENIED, []
    default_us = 1_000_000 if message == HEARTBEAT else 0
    wanted_us = default_us if interval_us == 0.0 else max(int(interval_us), 0)
    return Result.ACCEPTED, [Interval(message=int(message), interval_us=wanted_us)]
