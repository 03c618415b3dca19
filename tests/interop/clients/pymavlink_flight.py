"""A flight with the high-level functions of pymavlink's mavutil."""

import sys
import time

from pymavlink import mavutil

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
    flight(vehicle)
    print("flight complete", flush=True)


if __name__ == "__main__":
    main()
