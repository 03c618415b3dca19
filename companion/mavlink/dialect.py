"""pymavlink's generated dialect and the component ids: the only import of pymavlink."""

from pymavlink.dialects.v20 import all as wire

COMPANION_COMPONENT = wire.MAV_COMP_ID_PATHPLANNER  # 195
AUTOPILOT_COMPONENT = wire.MAV_COMP_ID_AUTOPILOT1

Message = wire.MAVLink_message


def codec(system_id: int) -> wire.MAVLink:
    """A pymavlink codec with the companion's ids that tolerates invalid bytes."""
    link = wire.MAVLink(None, srcSystem=system_id, srcComponent=COMPANION_COMPONENT)
    link.robust_parsing = True
    return link


__all__ = ["AUTOPILOT_COMPONENT", "COMPANION_COMPONENT", "Message", "codec", "wire"]
