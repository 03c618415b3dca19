"""What every simulated PX4 has in common, as an autopilot of vehicle_sim.autopilots.

The commander (commander.py) decides what is flown; the vehicle kinds (multicopter.py,
fixed_wing.py) fly it.  All figures are from px4.md and the recorded flights.
"""

import abc
import math
from collections.abc import Sequence
from typing import Final

from vehicle_sim.autopilots import (
    Ack,
    Command,
    Place,
    Reply,
    Result,
    Sender,
    Setpoint,
    Status,
    Sticks,
    TargetEcho,
    Waypoint,
)
from vehicle_sim.autopilots.attitude import AttitudeTarget, attitude_of, finite
from vehicle_sim.autopilots.px4 import commands
from vehicle_sim.autopilots.px4.commander import ARMABLE_US, Commander
from vehicle_sim.autopilots.px4.failsafe import (
    Action,
)
from vehicle_sim.autopilots.px4.health import text
from vehicle_sim.autopilots.px4.modes import (
    CUSTOM_MODES,
    NAMES,
    NAVIGATED,
    Mode,
    base_mode,
)
from vehicle_sim.autopilots.px4.setpoints import (
    Bearings,
    read_setpoint,
)
from vehicle_sim.plans import PlanKind
from vehicle_sim.sensors.gps import Fix

_CHECK_US: Final = 100_000
DO_SET_MODE: Final = 176


class Px4(Commander):
    """An autopilot of vehicle_sim.autopilots.Autopilot: all of it but how the vehicle flies.

    A kind of vehicle implements _begin (a mode begins) and _fly (one step), and may override the
    rest.  What it may read: mode, armed, landed, local_m, target, estimate, home, and what was
    commanded (takeoff_place, reposition, land_place, speed_m_s, mission).
    """

    # --- what a kind of vehicle does ----------------------------------------------------------

    @abc.abstractmethod
    def _fly(self, dt_s: float) -> None:
        """One step: steer by self.estimate, advance self.vehicle; on the ground too."""

    def _echo(self) -> TargetEcho | None:
        """POSITION_TARGET_LOCAL_NED."""
        return None

    def _waypoint(self) -> Waypoint | None:
        """POSITION_TARGET_GLOBAL_INT, in AUTO modes only."""
        return None

    def _above_ground_m(self) -> float | None:
        """What a distance sensor says: SIH has one."""
        return max(self.vehicle.altitude_amsl_m - self.ground_amsl_m, 0.0)

    # --- Autopilot ----------------------------------------------------------------------------

    @property
    def mode_name(self) -> str:
        """The mode it flies in, as its users call it."""
        return NAMES[self.mode]

    def step(self, now_us: int, dt_s: float, ground_amsl_m: float, fix: Fix) -> Sequence[Reply]:
        """Fly on to now_us."""
        self.now_us = now_us
        self.ground_amsl_m = ground_amsl_m
        if self._pending:
            self._said, self._pending = self._said + self._pending, []
        self.ekf.step(now_us, dt_s, self.vehicle, fix, still=self._still, low=self._low)
        estimate = self.estimate
        if self.origin is None:
            self._find_origin()
        else:
            north_m, east_m = self.projection.to_local(
                estimate.latitude_deg, estimate.longitude_deg
            )
            down_m = self.origin.altitude_amsl_m - estimate.altitude_amsl_m
            self.local_m = (north_m, east_m, down_m)
        if self._select_due:
            self._select_due = False
            self._select()
        if now_us >= self._next_check_us:
            self._next_check_us = now_us + _CHECK_US
            self._check()
        self._fly(dt_s)
        self._feel_turning(dt_s)
        if self.armed:
            self._disarm_by_itself()
        if self.gimbal.due(now_us):
            self.say(*self.gimbal.take(now_us))
        if not self._said:
            return ()
        said, self._said = self._said, []
        return said

    def _feel_turning(self, dt_s: float) -> None:
        """Angular rates, as gyroscopes feel them; a point mass has none of its own."""
        vehicle = self.vehicle
        roll, pitch, yaw = vehicle.roll_rad, vehicle.pitch_rad, vehicle.heading_rad
        roll_before, pitch_before, yaw_before = self._attitude_rad
        turn = yaw - yaw_before
        if turn > math.pi or turn < -math.pi:
            turn = math.remainder(turn, math.tau)
        self._attitude_rad = (roll, pitch, yaw)
        self._turning_rad = (roll - roll_before, pitch - pitch_before, turn)
        self._turning_s = dt_s

    @property
    def _rates_rad_s(self) -> tuple[float, float, float]:
        roll, pitch, yaw = self._turning_rad
        most, scale = 10.0, 1.0 / self._turning_s
        return tuple(min(max(turn * scale, -most), most) for turn in (roll, pitch, yaw))  # type: ignore[return-value]

    def on_setpoint(self, setpoint: Setpoint) -> Sequence[Reply]:
        """Take a setpoint as a sign of life, and in OFFBOARD as what to fly."""
        if self.origin is None and setpoint.is_global:
            return ()
        target = read_setpoint(
            setpoint,
            Bearings(
                projection=self.projection,
                origin_amsl_m=self._reference.altitude_amsl_m,
                home_amsl_m=(self.home or self._reference).altitude_amsl_m,
                ground_amsl_m=self.ground_amsl_m,
                heading_rad=self.vehicle.heading_rad,
            ),
        )
        if target is not None:
            self._hear_offboard(by_attitude=False)
            if self.mode is Mode.OFFBOARD:
                self.target, self.attitude = target, None
        return ()

    def on_attitude(self, target: AttitudeTarget) -> Sequence[Reply]:
        """The same of a SET_ATTITUDE_TARGET, which asks for no position to fly by.

        Source: MavlinkReceiver::handle_message_set_attitude_target; not measured.
        """
        known = target.by_rates or (
            target.by_attitude and attitude_of(target.quaternion) is not None
        )
        if known and finite(target):
            self._hear_offboard(by_attitude=True)
            if self.mode is Mode.OFFBOARD:
                self.target, self.attitude = None, target
        return ()

    def _hear_offboard(self, *, by_attitude: bool) -> None:
        """A setpoint counts as a sign of life, whatever the mode."""
        self._signal_us, self.needs_no_position = self.now_us, by_attitude
        if not self.offboard_signal:  # the arming checks run at once for it
            self.offboard_signal = self._select_due = True
            self._next_check_us = self.now_us

    def on_heartbeat(self, sender: Sender, vehicle_type: int) -> Sequence[Reply]:
        """Somebody else is there."""
        ours = sender.system == int(self.parameters["MAV_SYS_ID"])
        self.pilot.hear(vehicle_type, self.now_us, ours=ours)
        return ()

    def on_sticks(self, sticks: Sticks) -> Sequence[Reply]:
        """The pilot moves the sticks."""
        first = self.pilot.take(sticks, self.now_us)
        if first and not self.armed and self.intended is Mode.LOITER:
            self.command_mode(Mode.POSCTL)
        elif self._overrides():
            self.command_mode(Mode.POSCTL)
            self.say(text(6, "Pilot took over using sticks"))
        return ()

    def on_parameter(self, name: str) -> Sequence[Reply]:  # noqa: ARG002 - read live
        """A parameter has been set from outside."""
        return ()

    def on_plan(self, kind: PlanKind) -> Sequence[Reply]:
        """A mission, fence or rally list has been replaced from outside."""
        if kind is PlanKind.MISSION:
            self.mission.restart()
        return ()

    def pilot_takes(self) -> Sequence[Reply]:
        """Fault: the pilot changes to Position mode and holds the sticks centred."""
        self.pilot.hold(self.now_us)
        self.command_mode(Mode.POSCTL)
        return ()

    def reset_estimate(self, north_m: float, east_m: float) -> Sequence[Reply]:
        """Fault: the estimator's position jumps."""
        self.ekf.shift(north_m, east_m)
        return ()

    def move_origin(self, north_m: float, east_m: float, up_m: float) -> Sequence[Reply]:
        """Fault: the estimator's origin moves."""
        if self.origin is None:
            return ()
        latitude_deg, longitude_deg = self.projection.to_geographic(north_m, east_m)
        self._set_origin(
            Place(
                latitude_deg=latitude_deg,
                longitude_deg=longitude_deg,
                altitude_amsl_m=self.origin.altitude_amsl_m + up_m,
            )
        )
        return ()

    def status(self) -> Status:
        """What there is to tell."""
        mode, armed = self.mode, self.armed
        return Status(
            mode=CUSTOM_MODES[mode],
            base_mode=base_mode(mode, armed=armed),
            system_status=self._system_status(),
            landed_state=self._landed_state(),
            prearm_ok=self.now_us >= ARMABLE_US
            and self._can_arm(self._checks.reported_position_ok, self._checks.reported_signal),
            home=self.home,
            origin=self.origin,
            local_ned_m=self.local_m,
            target=self._echo(),
            waypoint=self._waypoint() if armed and mode in NAVIGATED else None,
            intended_mode=CUSTOM_MODES[self.intended],
            mission_current=self.mission.current,
            mission_state=self.mission.state,
            mission_total=self.mission.total,
            above_ground_m=self._above_ground_m(),
            rates_rad_s=self._rates_rad_s,
            fusing=self._checks.reported_fusing,
            logs_always=self._checks.logs_always,
            position_reported=self._checks.reported_position_ok,
            fence_breached=self.fence.breached,
            fence_breaches=self.fence.breaches,
            failsafe=armed and self.action > Action.WARN,
        )

    # --- commands -----------------------------------------------------------------------------

    def on_command(self, command: Command) -> Sequence[Reply]:
        """Do what is asked, or say why not."""
        result = self._obey(command)
        said, self._said = self._said, []
        if result is None:
            return said
        ack = Ack(to=command.sender, command=command.number, result=result)
        if command.number == DO_SET_MODE:
            # The receiver accepts whatever comes; the real result follows (px4.md 1, item 1).
            self._pending += [ack, *said]
            return [Ack(to=command.sender, command=command.number, result=Result.ACCEPTED)]
        return [ack, *said]

    def _obey(self, command: Command) -> Result | None:
        """The result; None: nobody answers."""
        return commands.obey(self, command)
