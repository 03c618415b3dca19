"""PX4's parameters that only fixed wings have, or have other defaults of.

The values are those of the simulated aeroplane.
Names, types, defaults and limits are PX4's (fw_mode_manager, fw_lateral_longitudinal_control,
runway_takeoff, navigator); FW_AIRSPD_TRIM and NPFG_PERIOD are also in
px4-fixedwing-offboard.tlog.
"""

import math
from typing import Final

from vehicle_sim.parameters import Kind, Parameter


def _real(name: str, default: float, least: float, most: float = math.inf) -> Parameter:
    return Parameter(name=name, default=default, least=least, most=most)


def _whole(name: str, default: int, least: int, most: int) -> Parameter:
    return Parameter(name=name, default=default, kind=Kind.INT32, least=least, most=most)


FIXED_WING_PARAMETERS: Final = (
    _whole("CA_AIRFRAME", 1, 0, 14),
    _real("COM_DISARM_PRFLT", -1.0, -1.0),
    _real("EKF2_GPS_DELAY", 0.0, 0.0, 1000.0),
    _real("FW_AIRSPD_MAX", 20.0, 0.5),
    _real("FW_AIRSPD_MIN", 10.0, 0.5),
    _real("FW_AIRSPD_STALL", 7.0, 0.5),
    _real("FW_AIRSPD_TRIM", 15.0, 0.5),
    _real("FW_GND_SPD_MIN", 5.0, 0.0, 40.0),
    _whole("FW_LND_ABORT", 3, 0, 3),
    _real("FW_LND_AIRSPD", -1.0, -1.0),
    _real("FW_LND_ANG", 5.0, 1.0, 45.0),
    _real("FW_LND_FLALT", 0.5, 0.0),
    _real("FW_LND_FL_SINK", 0.25, 0.0, 2.0),
    _real("FW_LND_FL_TIME", 1.0, 0.1, 5.0),
    _whole("FW_LND_USETER", 1, 0, 2),
    _real("FW_PN_R_SLEW_MAX", 90.0, 0.0),
    _real("FW_P_LIM_MAX", 30.0, 0.0, 80.0),
    _real("FW_P_LIM_MIN", -30.0, -60.0, 0.0),
    _real("FW_R_LIM", 50.0, 35.0, 75.0),
    _real("FW_THR_MAX", 1.0, 0.0, 1.0),
    _real("FW_THR_MIN", 0.0, 0.0, 1.0),
    _real("FW_THR_TRIM", 0.6, 0.0, 1.0),
    _real("FW_TKO_AIRSPD", -1.0, -1.0),
    _real("FW_TKO_PITCH_MIN", 10.0, -5.0, 80.0),
    _real("FW_T_ALT_TC", 5.0, 2.0),
    _real("FW_T_CLMB_MAX", 8.0, 1.0),
    _real("FW_T_CLMB_R_SP", 3.0, 0.1),
    _real("FW_T_SINK_MAX", 5.0, 1.0, 15.0),
    _real("FW_T_SINK_MIN", 2.0, 1.0, 5.0),
    _real("FW_T_SINK_R_SP", 2.0, 0.1),
    _real("FW_T_SPDWEIGHT", 1.0, 0.0, 2.0),
    _real("FW_WING_HEIGHT", 0.5, 0.0),
    _real("FW_WING_SPAN", 3.0, 0.1),
    _real("MIS_TAKEOFF_ALT", 30.0, 0.0),
    _whole("MIS_TKO_LAND_REQ", 2, 0, 5),
    _real("NAV_FW_ALT_RAD", 10.0, 0.05, 200.0),
    _real("NAV_FW_ALTL_RAD", 5.0, 0.05, 200.0),
    _whole("NAV_GPSF_LT", 30, 0, 3600),
    _real("NAV_GPSF_R", 15.0, 0.0, 60.0),
    _real("NPFG_DAMPING", 0.7, 0.1, 1.0),
    _whole("NPFG_LB_PERIOD", 1, 0, 1),
    _real("NPFG_PERIOD", 10.0, 1.0, 100.0),
    _real("NPFG_PERIOD_SF", 1.5, 1.0, 10.0),
    _real("NPFG_ROLL_TC", 0.5, 0.0, 2.0),
    _real("NPFG_SW_DST_MLT", 0.32, 0.1, 1.0),
    _whole("NPFG_UB_PERIOD", 1, 0, 1),
    _real("RTL_DESCEND_ALT", 100.0, 0.0),
    _real("RTL_LAND_DELAY", -1.0, -1.0),
    _real("RTL_RETURN_ALT", 100.0, 0.0),
    _whole("RTL_TYPE", 1, 0, 5),
    _real("RWTO_MAX_THR", 1.0, 0.0, 1.0),
    _real("RWTO_PSP", 0.0, -10.0, 20.0),
    _real("RWTO_RAMP_TIME", 2.0, 1.0, 15.0),
    _real("RWTO_ROT_AIRSPD", -1.0, -1.0),
    _real("RWTO_ROT_TIME", 1.0, 0.1),
    _whole("RWTO_TKOFF", 1, 0, 1),
    _real("SIH_KDV", 0.2, 0.0),
    _real("SIH_MASS", 0.3, 0.0),
    _whole("SYS_AUTOSTART", 10041, 0, 9999999),
)
"""Some replace rows of the table that both PX4 personalities share (rc.fw_defaults)."""
