"""Faults: SIM_ parameters, the conditions that they make, and the timeline that sets them."""

from vehicle_sim.faults.catalogue import FAULTS, Fault
from vehicle_sim.faults.conditions import (
    SIM_PARAMETERS,
    SIM_PARAMETERS_PX4,
    Conditions,
    EstimatorReset,
    Firmware,
    Happening,
    LinkConditions,
    OriginMove,
    PilotTakes,
    Reboot,
    conditions_of,
    take_happenings,
)
from vehicle_sim.faults.timeline import Timeline, faults_page, faults_table

__all__ = [
    "FAULTS",
    "SIM_PARAMETERS",
    "SIM_PARAMETERS_PX4",
    "Conditions",
    "EstimatorReset",
    "Fault",
    "Firmware",
    "Happening",
    "LinkConditions",
    "OriginMove",
    "PilotTakes",
    "Reboot",
    "Timeline",
    "conditions_of",
    "faults_page",
    "faults_table",
    "take_happenings",
]
