"""A flight with pymavlink's high-level functions: mavutil, mavparm and mavwp."""

import sys
import time

from pymavlink import mavparm, mavutil, mavwp

PATIENCE_S = 30.0


def need(vehicle: mavutil.mavfile, kind: str | list[str], **match: object) -> object:
    """The next message of this kind that is so."""
    end_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s:
        message = vehicle.recv_match(type=kind, blocking=True, timeout=PATIENCE_S)
        if message and all(getattr(message, name) == value for name, value in match.items()):
            return message
    sys.exit(f"no {kind} with {match}")


def parameters(vehicle: mavutil.mavfile) -> None:
    vehicle.param_fetch_all()
    seen: dict[int, str] = {}
    while True:
        value = need(vehicle, "PARAM_VALUE")
        if value.param_index != 65535:
            seen[value.param_index] = value.param_id
        if len(seen) == value.param_count:
            break
    print("parameters:", len(seen), flush=True)
    table = mavparm.MAVParmDict()
    print("mavset:", table.mavset(vehicle, "GUID_TIMEOUT", 1.5, retries=3), flush=True)
    vehicle.param_fetch_one("GUID_TIMEOUT")
    print("GUID_TIMEOUT:", need(vehicle, "PARAM_VALUE", param_id="GUID_TIMEOUT").param_value)


def mission(vehicle: mavutil.mavfile) -> None:
    """Upload a mission with mavwp and download it again."""
    here = vehicle.location(relative_alt=True)
    loader = mavwp.MAVWPLoader(vehicle.target_system, vehicle.target_component)
    for k in range(4):
        loader.add_latlonalt(here.lat + 1e-4 * k, here.lng, 10.0 + k)
    vehicle.waypoint_clear_all_send()
    need(vehicle, "MISSION_ACK", type=0)
    vehicle.waypoint_count_send(loader.count())
    while True:
        asked = need(vehicle, ["MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK"])
        if asked.get_type() == "MISSION_ACK":
            break
        vehicle.mav.send(loader.wp(asked.seq))
    print("upload:", asked.type, flush=True)
    vehicle.waypoint_request_list_send()
    count = need(vehicle, "MISSION_COUNT").count
    for k in range(count):
        vehicle.mav.mission_request_int_send(vehicle.target_system, vehicle.target_component, k)
        item = need(vehicle, "MISSION_ITEM_INT", seq=k)
        print("item:", k, item.command, item.frame, item.x, item.y, item.z, flush=True)
    vehicle.mav.mission_ack_send(vehicle.target_system, vehicle.target_component, 0)


def flight(vehicle: mavutil.mavfile) -> None:
    vehicle.set_mode("GUIDED")
    need(vehicle, "COMMAND_ACK", command=mavutil.mavlink.MAV_CMD_DO_SET_MODE, result=0)
    while not vehicle.motors_armed():
        vehicle.arducopter_arm()
        answer = need(vehicle, "COMMAND_ACK", command=400)
        print("arm:", answer.result, flush=True)
        vehicle.wait_heartbeat()
    vehicle.motors_armed_wait()
    vehicle.mav.command_long_send(
        1, 1, mavutil.mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 0, 15
    )
    need(vehicle, "COMMAND_ACK", command=mavutil.mavlink.MAV_CMD_NAV_TAKEOFF, result=0)
    while vehicle.location(relative_alt=True).alt < 14.5:
        pass
    print("in the air:", f"{vehicle.location(relative_alt=True).alt:.0f} m", vehicle.flightmode)
    vehicle.set_mode_rtl()
    need(vehicle, "COMMAND_ACK", command=mavutil.mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH, result=0)
    vehicle.motors_disarmed_wait()


def main() -> None:
    vehicle = mavutil.mavlink_connection(sys.argv[1])
    vehicle.setup_logfile(sys.argv[2])
    vehicle.wait_heartbeat()
    print("heartbeat of", vehicle.target_system, vehicle.target_component, vehicle.flightmode)
    vehicle.mav.heartbeat_send(6, 8, 0, 0, 0)
    vehicle.mav.request_data_stream_send(1, 1, mavutil.mavlink.MAV_DATA_STREAM_ALL, 2, 1)
    vehicle.wait_gps_fix()
    parameters(vehicle)
    mission(vehicle)
    flight(vehicle)
    print("packet loss:", vehicle.packet_loss())
    print("flight complete", flush=True)


if __name__ == "__main__":
    main()
