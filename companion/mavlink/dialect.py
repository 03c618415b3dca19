"""The one place that knows pymavlink: its generated dialect, and who is who on the link."""

from pymavlink.dialects.v20 import all as wire

COMPANION_COMPONENT = wire.MAV_COMP_ID_PATHPLANNER  # 195
AUTOPILOT_COMPONENT = wire.MAV_COMP_ID_AUTOPILOT1

Message = wire.MAVLink_message


def codec(system_id: int) -> wire.MAVLink:
    """A packer and parser that speaks as the companion of a vehicle, and survives garbage."""
    link = wire.MAVLink(None, srcSystem=system_id, srcComponent=COMPANION_COMPONENT)
    link.robust_parsing = True
    return link


__all__ = ["AUTOPILOT_COMPONENT", "COMPANION_COMPONENT", "Message", "codec", "wire"]
