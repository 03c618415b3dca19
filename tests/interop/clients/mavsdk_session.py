"""MAVSDK-Python, of either kind, mavsdk (4) and mavsdk<4 (gRPC), as a ground station and a pilot.

usage: mavsdk_session.py URL PORT    (of the server program, with gRPC)
What it found is its last line, as JSON.
"""

import asyncio
import importlib
import json
import math
import os
import sys
import traceback
from collections.abc import AsyncIterator, Callable
from typing import Any

import mavsdk

IS_GRPC = not hasattr(mavsdk, "Mavsdk")
PATIENCE_S = 30.0
HOME = (47.397742, 8.545594)


def api(plugin: str) -> Any:
    """The module of a plugin's values and errors."""
    return importlib.import_module(f"mavsdk.{plugin}" if IS_GRPC else f"mavsdk.plugins.{plugin}")


class Drone:
    """One vehicle and its plugins, as attributes: telemetry, action, offboard, ..."""

    def __init__(self, system: Any) -> None:
        self._system = system

    def __getattr__(self, plugin: str) -> Any:
        if IS_GRPC:
            return getattr(self._system, plugin)
        module = importlib.import_module(f"mavsdk.asyncio.plugins.{plugin}")
        name = "".join(part.capitalize() for part in plugin.split("_"))
        self.__dict__[plugin] = getattr(module, f"{name}Async")(self._system)
        return self.__dict__[plugin]

    def stream(self, topic: str, plugin: str = "telemetry") -> AsyncIterator[Any]:
        """What the plugin tells of this, as it comes."""
        return getattr(getattr(self, plugin), topic if IS_GRPC else f"subscribe_{topic}")()

    async def until(
        self, topic: str, reached: Callable[[Any], bool] = lambda _: True, **where: str
    ) -> Any:
        """The first that is so; the next, if nothing is said of that."""

        async def search() -> Any:
            async for value in self.stream(topic, **where):
                if reached(value):
                    return value
            raise EOFError(topic)

        return await asyncio.wait_for(search(), PATIENCE_S)

    async def in_mode(self, name: str) -> str:
        """Wait for a flight mode, by a part of its name."""
        return (await self.until("flight_mode", lambda mode: name in mode.name)).name


async def connected(url: str, port: int) -> Drone:
    """Connect, and wait until the vehicle is there."""
    if IS_GRPC:
        system = mavsdk.System(port=port)
        await system.connect(system_address=url)
        await Drone(system).until("connection_state", lambda it: it.is_connected, plugin="core")
        return Drone(system)
    from mavsdk.asyncio import ComponentType, Configuration, Mavsdk

    whole = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    await whole.add_any_connection(url)
    drone = Drone(await whole.first_autopilot(timeout_s=PATIENCE_S))
    drone.whole = whole  # it ends with its last reference
    return drone


async def refusal(asked: Any, error: type[Exception]) -> str:
    """What is said when it is not done."""
    try:
        await asked
    except error as refused:
        return str(refused)
    return ""


def mission(*places: tuple[float, float]) -> Any:
    """Waypoints: degrees to the north of home, and metres above it."""
    item = api("mission").MissionItem
    unset = [math.nan] * 5
    return api("mission").MissionPlan(
        [
            item(HOME[0] + north_deg, HOME[1], up_m, 8.0, True, math.nan, math.nan,
                 item.CameraAction.NONE, *unset, item.VehicleAction.NONE)
            for north_deg, up_m in places
        ]
    )  # fmt: skip


async def before_the_flight(drone: Drone) -> dict[str, Any]:
    """Telemetry, rates, parameters, plans."""
    version = await drone.info.get_version()
    home = await drone.until("home")
    await drone.telemetry.set_rate_attitude_euler(20.0)
    times_us = []
    async for angle in drone.stream("attitude_euler"):
        times_us.append(angle.timestamp_us)
        if len(times_us) == 22:
            break
    param, every = drone.param, await drone.param.get_all_params()
    found = {
        "version": [version.flight_sw_major, version.flight_sw_minor, version.flight_sw_patch],
        "home": [home.latitude_deg, home.longitude_deg, home.absolute_altitude_m],
        "attitude, Hz": 20e6 / (times_us[-1] - times_us[1]),
        "parameters": [len(every.int_params), len(every.float_params)],
        "float": await param.get_param_float("MIS_TAKEOFF_ALT"),
        "whole": await param.get_param_int("COM_OBL_RC_ACT"),
    }
    await param.set_param_float("MIS_TAKEOFF_ALT", 12.5)
    await param.set_param_int("COM_OBL_RC_ACT", 5)
    found["float then"] = await param.get_param_float("MIS_TAKEOFF_ALT")
    found["whole then"] = await param.get_param_int("COM_OBL_RC_ACT")
    wrong = api("param").ParamError
    found["float as whole"] = await refusal(param.get_param_int("MIS_TAKEOFF_ALT"), wrong)
    found["no such"] = await refusal(param.get_param_int("NO_SUCH_PARAM"), wrong)
    values = api("geofence")
    corners = [
        values.Point(HOME[0] + north, HOME[1] + east)
        for north, east in ((0.01, 0.01), (-0.01, 0.01), (-0.01, -0.01), (0.01, -0.01))
    ]
    circle = values.Circle(values.Point(HOME[0] + 0.003, HOME[1]), 25.0, values.FenceType.EXCLUSION)
    polygon = values.Polygon(corners, values.FenceType.INCLUSION)
    await drone.geofence.upload_geofence(values.GeofenceData([polygon], [circle]))
    back = await drone.geofence.download_geofence()
    found["fence"] = [len(polygon.points) for polygon in back.polygons]
    found["fence"] += [circle.radius for circle in back.circles]
    await drone.geofence.clear_geofence()
    back = await drone.geofence.download_geofence()
    found["fence then"] = [*back.polygons, *back.circles]
    return found


async def flight(drone: Drone) -> dict[str, Any]:
    """By commands, by a mission, by setpoints, and home."""
    found: dict[str, Any] = {}
    values, unset = api("offboard"), api("offboard").OffboardError
    found["without a setpoint"] = await refusal(drone.offboard.start(), unset)
    await drone.action.set_takeoff_altitude(10.0)
    await drone.action.set_return_to_launch_altitude(20.0)
    found["return, m"] = await drone.action.get_return_to_launch_altitude()
    # its checks do not pass while it misses our heartbeat
    while "DENIED" in await refusal(drone.action.arm(), api("action").ActionError):
        await drone.until("health_all_ok", bool)
    await drone.until("armed", bool)
    await drone.action.takeoff()
    found["modes"] = [await drone.in_mode("TAKEOFF"), await drone.in_mode("HOLD")]
    above = await drone.until("position")
    found["took off, m"] = above.relative_altitude_m
    await drone.action.goto_location(*HOME[:1], HOME[1] + 4e-4, above.absolute_altitude_m + 5, 0.0)
    await drone.until("position", lambda now: now.longitude_deg > HOME[1] + 3.8e-4)

    await drone.mission.upload_mission(mission((2e-4, 15.0), (5e-4, 20.0), (5e-4, 15.0)))
    back = await drone.mission.download_mission()
    found["mission, m"] = [item.relative_altitude_m for item in back.mission_items]
    await drone.mission.start_mission()
    found["modes"].append(await drone.in_mode("MISSION"))
    done = await drone.until(
        "mission_progress", lambda now: now.current == now.total, plugin="mission"
    )
    found["mission"] = [done.total, await drone.mission.is_mission_finished()]

    there = values.PositionNedYaw(20.0, 0.0, -15.0, 90.0)
    await drone.offboard.set_position_ned(there)
    # a heartbeat in between makes MAVSDK forget the setpoint
    while "NO_SETPOINT_SET" in await refusal(drone.offboard.start(), unset):
        await drone.offboard.set_position_ned(there)
    found["modes"].append(await drone.in_mode("OFFBOARD"))
    at = await drone.until(
        "position_velocity_ned", lambda now: abs(now.position.north_m - 20.0) < 1.0
    )
    found["up, m"] = -at.position.down_m
    await drone.until("attitude_euler", lambda angle: abs(angle.yaw_deg - 90.0) < 5.0)
    await drone.offboard.set_velocity_ned(values.VelocityNedYaw(0.0, 4.0, -1.0, 90.0))
    at = await drone.until("position_velocity_ned", lambda now: now.velocity.east_m_s > 3.6)
    found["velocity, m/s"] = [at.velocity.east_m_s, -at.velocity.down_m_s]
    found["offboard"] = await drone.offboard.is_active()
    await drone.offboard.stop()
    found["modes"].append(await drone.in_mode("HOLD"))
    await drone.action.return_to_launch()
    found["modes"].append(await drone.in_mode("RETURN"))
    await drone.until("armed", lambda armed: not armed)
    return found


async def session() -> None:
    drone = await connected(sys.argv[1], int(sys.argv[2]))
    await drone.until("health_all_ok", bool)
    found = await before_the_flight(drone) | await flight(drone)
    sys.stdout.write(f"{json.dumps(found, default=str)}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    if not IS_GRPC:
        mavsdk.log_subscribe(lambda *_: True)  # its own words would mix with ours
    try:
        asyncio.run(session())
    except BaseException:
        traceback.print_exc()
        os._exit(1)  # threads of the libraries would keep a failed session alive
    os._exit(0)
