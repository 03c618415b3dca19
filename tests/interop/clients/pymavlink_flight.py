"""A flight with pymavlink's high-level functions: mavutil, mavparm and mavwp."""

import sys
import time

from pymavlink import mavparm, mavutil, mavwp

PATIENCE_S = 30.0
wire = mavutil.mavlink


def need(vehicle: mavutil.mavfile, kind: str | list[str], **match: object) -> object:
    """The next message of this kind that is so."""
    end_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s:
        message = vehicle.recv_match(type=kind, blocking=True, timeout=PATIENCE_S)
        if message and all(getattr(message, name) == value for name, value in match.items()):
            return message
    sys.exit(f"no {kind} with {match}")


def parameters(vehicle: mavutil.mavfile) -> None:
    """All of them, and one that is set."""
    vehicle.param_fetch_all()
    seen, count = set(), None
    while len(seen) != count:
        value = need(vehicle, "PARAM_VALUE")
        seen, count = seen | {value.param_index} - {65535}, value.param_count
    if not mavparm.MAVParmDict().mavset(vehicle, "GUID_TIMEOUT", 1.5, retries=3):
        sys.exit("GUID_TIMEOUT is not set")
    vehicle.param_fetch_one("GUID_TIMEOUT")
    need(vehicle, "PARAM_VALUE", param_id="GUID_TIMEOUT", param_value=1.5)


def mission(vehicle: mavutil.mavfile) -> None:
    """Upload a mission with mavwp and download it again."""
    here = vehicle.location(relative_alt=True)
    us = (vehicle.target_system, vehicle.target_component)
    loader = mavwp.MAVWPLoader(*us)
    for k in range(4):
        loader.add_latlonalt(here.lat + 1e-4 * k, here.lng, 10.0 + k)
    vehicle.waypoint_clear_all_send()
    need(vehicle, "MISSION_ACK", type=0)
    vehicle.waypoint_count_send(loader.count())
    asks = ["MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK"]
    while (asked := need(vehicle, asks)).get_type() != "MISSION_ACK":
        vehicle.mav.send(loader.wp(asked.seq))
    vehicle.waypoint_request_list_send()
    for k in range(need(vehicle, "MISSION_COUNT").count):
        vehicle.mav.mission_request_int_send(*us, k)
        item = need(vehicle, "MISSION_ITEM_INT", seq=k)
        if k and (item.command, item.z) != (16, 10.0 + k):
            sys.exit(f"another item came back: {item}")
    vehicle.mav.mission_ack_send(*us, 0)


def flight(vehicle: mavutil.mavfile) -> None:
    """Up to 15 m, and home."""
    vehicle.set_mode("GUIDED")
    need(vehicle, "COMMAND_ACK", command=wire.MAV_CMD_DO_SET_MODE, result=0)
    while not vehicle.motors_armed():
        vehicle.arducopter_arm()
        need(vehicle, "COMMAND_ACK", command=wire.MAV_CMD_COMPONENT_ARM_DISARM)
        vehicle.wait_heartbeat()
    vehicle.motors_armed_wait()
    vehicle.mav.command_long_send(1, 1, wire.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 0, 15)
    need(vehicle, "COMMAND_ACK", command=wire.MAV_CMD_NAV_TAKEOFF, result=0)
    while vehicle.location(relative_alt=True).alt < 14.5:
        pass
    vehicle.set_mode_rtl()
    need(vehicle, "COMMAND_ACK", command=wire.MAV_CMD_NAV_RETURN_TO_LAUNCH, result=0)
    vehicle.motors_disarmed_wait()


def main() -> None:
    vehicle = mavutil.mavlink_connection(sys.argv[1])
    vehicle.setup_logfile(sys.argv[2])
    vehicle.wait_heartbeat()
    vehicle.mav.heartbeat_send(6, 8, 0, 0, 0)
    vehicle.mav.request_data_stream_send(1, 1, wire.MAV_DATA_STREAM_ALL, 2, 1)
    vehicle.wait_gps_fix()
    parameters(vehicle)
    mission(vehicle)
    flight(vehicle)
    print("flight complete", flush=True)


if __name__ == "__main__":
    main()
