"""ArduCopter's own parameters, its modes, and what it says while it boots."""

from typing import Final

from vehicle_sim.autopilots.ardupilot.autopilot import Due, boot_of
from vehicle_sim.autopilots.ardupilot.ekf3 import Timing
from vehicle_sim.faults.conditions import SIM_PARAMETERS
from vehicle_sim.parameters import table

STABILIZE, ACRO, ALT_HOLD, AUTO, GUIDED, LOITER, RTL, CIRCLE, LAND = 0, 1, 2, 3, 4, 5, 6, 7, 9
POSHOLD, BRAKE, GUIDED_NOGPS, SMART_RTL = 16, 17, 20, 21
MODES: Final = {
    STABILIZE: "STABILIZE",
    ACRO: "ACRO",
    ALT_HOLD: "ALT_HOLD",
    AUTO: "AUTO",
    GUIDED: "GUIDED",
    LOITER: "LOITER",
    RTL: "RTL",
    CIRCLE: "CIRCLE",
    LAND: "LAND",
    POSHOLD: "POSHOLD",
    BRAKE: "BRAKE",
    GUIDED_NOGPS: "GUIDED_NOGPS",
    SMART_RTL: "SMARTRTL",
}
NEED_POSITION: Final = frozenset({AUTO, GUIDED, LOITER, RTL, CIRCLE, POSHOLD, BRAKE, SMART_RTL})
NOT_ARMABLE: Final = frozenset({AUTO, RTL, CIRCLE, LAND, BRAKE, SMART_RTL})

TABLE: Final = (*table("ardupilot/shared", "ardupilot/copter"), *SIM_PARAMETERS)

TIMING: Final = Timing(
    initialised_us=4_460_000,
    attitude_us=5_900_000,
    origin_after_fix_us=10_000_000,
    using_after_fix_us=31_620_000,
    origin_texts=((193_000, "EKF3 IMU1 origin set"),),
)


def boot(pressure_pa: float) -> list[Due]:
    """What it says by itself; the pressure is that of the ground."""
    pressures = (("BARO1_GND_PRESS", pressure_pa), ("BARO2_GND_PRESS", pressure_pa - 0.29))
    return [*((1_930_000, row) for row in pressures), *boot_of("copter")]
