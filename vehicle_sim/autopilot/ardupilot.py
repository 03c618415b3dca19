"""What ArduCopter and ArduPlane share: arming, modes, commands, failsafes, what there is to tell.

Sources: ardupilot.md 1, 2, 4, 5 and the recorded flights (4.7).
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Final

from vehicle_sim.autopilot import core, values
from vehicle_sim.autopilot.core import GPS_GLOBAL_ORIGIN, HOME_POSITION, Autopilot, Boot
from vehicle_sim.autopilot.earth import FlatEarth
from vehicle_sim.autopilot.estimator import Timing, state_flags
from vehicle_sim.autopilot.guards import Fence, named
from vehicle_sim.autopilot.values import Command, Landed, Place, Result, State
from vehicle_sim.faults import sim_parameters
from vehicle_sim.parameters import table

TOLD: Final = frozenset(
    {0, 1, 2, 24, 30, 31, 32, 33, 42, 49, 62, 74, 85, 87, 132, 147, 148, 162, 164, 168, 173, 193}
    | {242, 245}
)
STREAMABLE: Final = TOLD | {
    *(26, 27, 29, 35, 36, 65, 116, 124, 125, 127, 129, 133, 136, 137, 143, 152, 163, 165, 178, 194),
    *(226, 235, 241, 246, 291, 295, 376, 435, 11020, 11030, 11039),
}
"""The others are taken, as the real one takes them, and not told here."""
_DATA_STREAMS: Final = {
    2: (1, 42, 24, 62, 162, 87),
    6: (33, 32),
    10: (30, 164),
    11: (74,),
    12: (168, 2, 147, 193, 132, 173),
}
"""MAV_DATA_STREAM: EXTENDED_STATUS, POSITION, EXTRA1, EXTRA2, EXTRA3."""


def firmware(
    name: str, *, vehicle_type: int, capabilities: int, rates_hz: Mapping[int, float], **own: Any
) -> core.Firmware:
    """ArduPilot 4.7 for one kind of vehicle: ardupilot.md 1 and the recorded flights."""
    return core.Firmware(
        family="ardupilot",
        vehicle_type=vehicle_type,
        autopilot=3,
        capabilities=capabilities,
        software_version=67567616,
        custom_version=b"2598e9d4",
        first_heartbeat_us=900_000,  # ardupilot.md 1
        rates_hz=rates_hz,
        streamable=STREAMABLE,
        requestable=TOLD,
        data_streams=_DATA_STREAMS,
        table=(*table("ardupilot", name), *sim_parameters("ardupilot")),
        missions="AUTO",
        first_item=1,
        frame=FlatEarth,
        ids=("MAV_SYSID",),
        refused=Result.FAILED,
        cannot_arm="Arm: {}",
        **own,
    )


EKF3: Final = Timing(
    # of ArduCopter (arducopter-gps-loss.tlog, ardupilot.md 5): another vehicle boots otherwise
    stages=((0.0, 0x400), (4.46, 0x000), (5.9, 0x0A7)),
    flags=state_flags(good=0x33F, glitch=0x833F, yields=0x8027, lost=0x025, stopped=0x0A7),
    origin_s=10.0,
    good_s=31.62,
    gate_m=3.75,  # a variance ratio of 13.33 for 50 m at once, 10.53 after 9.5 s
    gate_growth_m_s=0.106,
    glitch_s=0.9,
    yields_s=10.29,
    calm_s=9.85,
    lost_s=7.15,
    stopped_s=15.05,
    back_s=0.09,
    lag_s=0.1,
    follows=0.02,
    drift_m_s2=0.01,
    velocity_ratio=0.012,
)
_BATTERY_LOW_S: Final = 10.0  # BATT_LOW_TIMER
_GCS_LOST_S: Final = 4.9  # FS_GCS_TIMEOUT and FS_LONG_TIMEOUT 5, as measured


class ArduPilot(Autopilot):
    """One vehicle's autopilot."""

    gcs_failsafe: ClassVar[str]
    """The parameter that says whether a lost ground station matters."""
    lands: Callable[[], bool]  # it comes down to land: the fence has no floor then
    climbs_out: Callable[[], bool]  # a take-off goes on
    on_failsafe: Callable[[str, int], None]  # of "GCS", "Battery" or "Fence", its parameter's value

    def __init__(self, boot: Boot) -> None:
        super().__init__(boot)
        self.fence = Fence(self.parameters, self.plans)
        self.failsafe = False
        """Of the estimator, for which the heartbeat says CRITICAL, as for the next two."""
        self.gcs_lost = False
        self.battery_acted = False
        self._was_aiding = False
        self._battery_low_s = math.inf
        self.handlers |= {176: self._set_mode_number, 207: self._fence_enable}

    # --- where the two kinds differ -----------------------------------------------------------

    def can_fly_in(self, name: str) -> bool:
        """Whether it can fly in this mode now: plane can in all that may be chosen."""
        return name != "INITIALISING"

    def base_mode(self) -> int:
        """Of the heartbeat, but for the bit that says whether it is armed."""
        return self.mode.base

    # --- each step ----------------------------------------------------------------------------

    def check(self) -> None:
        """Ten times a second: failsafes, fence."""
        if self.estimate.aiding is not self._was_aiding:
            self._was_aiding = self.estimate.aiding
            self.say(6, f"EKF3 IMU0 {'is using GPS' if self._was_aiding else 'stopped aiding'}")
        self._check_fence()
        enabled = self.parameters[self.gcs_failsafe]
        lost = _GCS_LOST_S <= self.now_s - self.station_s < math.inf
        if self.gcs_lost and not lost:
            self.gcs_lost = False
            self.say(4, "GCS Failsafe Cleared")
        elif enabled and self.armed and lost and not self.gcs_lost:
            self.gcs_lost = True
            self.on_failsafe("GCS", int(enabled))
        self._check_battery()

    def _check_battery(self) -> None:
        battery, p = self.battery, self.parameters
        is_low = battery.voltage_v < p["BATT_LOW_VOLT"] and not self.battery_acted
        self._battery_low_s = min(self._battery_low_s, self.now_s) if is_low else math.inf
        if self.now_s - self._battery_low_s >= _BATTERY_LOW_S:
            self.battery_acted, action = True, int(p["BATT_FS_LOW_ACT"])
            used = f"{battery.voltage_v:.2f}V used {battery.consumed_mah:.0f} mAh"
            self.say(4, f"Battery 1 is low {used}")
            if self.armed and action:
                self.on_failsafe("Battery", action)

    def _check_fence(self) -> None:
        fence, home = self.fence, self.home
        if not fence.enabled or home is None or not self.armed or self.landed:
            fence.breached, fence.has_floor = 0, False
        elif not self.estimate.position_ok:
            fence.breached = 0
        else:
            place, lands = self.estimate.place, self.lands()
            if new := fence.check(place, home, self.frame, lands=lands):
                self.say(5, f"{named(new)} fence breached")
                if action := int(self.parameters["FENCE_ACTION"]):
                    self.on_failsafe("Fence", action)

    def outside_fence(self, place: Place) -> int:
        """Which kinds of fence this place would breach."""
        return self.fence.outside(place, self.home, self.frame)

    # --- modes and arming ---------------------------------------------------------------------

    def set_mode(self, name: str) -> bool:
        """Fly in this mode from now on, if it can be."""
        if name == self.mode.name:
            return True
        if not self.can_fly_in(name):
            self.say(4, f"Mode change to {name} failed")
            return False
        self.mode = self.modes[name]
        self.begin()
        self.send(core.HEARTBEAT)
        return True

    def _set_mode_number(self, command: Command) -> Result:
        flags, number = command.parameters[:2]
        if not (math.isfinite(flags) and int(flags) & 1):
            return Result.DENIED
        name = next((mode.name for mode in self.firmware.modes if mode.number == number), None)
        return self.done(name is not None and self.set_mode(name))

    def refusal(self) -> str | None:
        """Why it may not be armed now."""
        if not self.mode.armable:
            return f"{self.mode.name} mode not armable"
        if self.mode.needs_position and not self.estimate.position_ok:
            return "Need Position Estimate"
        if self.now_s < self.firmware.prearm_s:
            return "AHRS: waiting for home"
        outside = self.outside_fence(self.estimate.place) if self.estimate.position_ok else 0
        return f"Vehicle breaching {named(outside)}" if outside else None

    def on_armed(self) -> None:
        """Home is told; a mission begins where it stands."""
        self.send(HOME_POSITION, GPS_GLOBAL_ORIGIN)
        if self.mode.name == self.firmware.missions:
            self.seek(self.firmware.first_item)

    # --- commands -----------------------------------------------------------------------------

    def _fence_enable(self, command: Command) -> Result:
        if command.parameters[0] not in (0.0, 1.0):
            return Result.FAILED
        self.parameters["FENCE_ENABLE"] = command.parameters[0]
        return Result.ACCEPTED

    # --- the rest of the protocol -------------------------------------------------------------

    def status(self) -> values.Status:
        """The status for telemetry."""
        landed, state = Landed.IN_AIR, State.ACTIVE
        if self.landed:
            landed, state = Landed.ON_GROUND, State.STANDBY
        elif self.lands():
            landed = Landed.LANDING
        elif self.climbs_out():
            landed = Landed.TAKEOFF
        if self.failsafe or self.gcs_lost or self.battery_acted:
            state = State.CRITICAL
        if self.now_s < self.firmware.ready_s:
            state = State.BOOT if self.firmware.vehicle_type == 2 else State.CALIBRATING
        return values.Status(
            mode=self.mode.number,
            base_mode=self.base_mode() | (0x80 if self.armed else 0),
            system_status=state,
            landed_state=landed,
            prearm_ok=self.now_s >= self.firmware.prearm_s,
            waypoint=self.waypoint(),
            fence=self.fence.status,
        )
