"""What a ground station reads and loads before a flight: telemetry, parameters, mission, fence."""

import asyncio
import math

from mavsdk_drone import Drone, api, run, say

HOME = (47.397742, 8.545594)


async def telemetry(drone: Drone) -> None:
    await drone.until("health_all_ok", bool)
    say("health all ok")
    version = await drone.info.get_version()
    say("version", f"{version.flight_sw_major}.{version.flight_sw_minor}.{version.flight_sw_patch}")
    position = await drone.next("position")
    say("position", f"{position.latitude_deg:.5f} {position.longitude_deg:.5f}")
    home = await drone.next("home")
    say("home", f"{home.latitude_deg:.5f} {home.longitude_deg:.5f} {home.absolute_altitude_m:.0f}")
    for topic in ("flight_mode", "landed_state", "armed", "in_air"):
        say(topic, await drone.next(topic))
    gps = await drone.next("gps_info")
    say("gps", f"{gps.num_satellites} satellites, {gps.fix_type.name}")
    battery = await drone.next("battery")
    say("battery", f"{battery.voltage_v:.1f} V {battery.remaining_percent:.0f} %")
    angle = await drone.next("attitude_euler")
    say("attitude", f"{angle.roll_deg:.0f} {angle.pitch_deg:.0f} {angle.yaw_deg:.0f}")


async def rates(drone: Drone) -> None:
    """Count what comes in a second at the rate that was asked for."""
    await drone.telemetry.set_rate_battery(0.0)
    for rate_hz in (5.0, 20.0):
        await drone.telemetry.set_rate_attitude_euler(rate_hz)
        times_us = []
        async for angle in drone.stream("telemetry", "attitude_euler"):
            times_us.append(angle.timestamp_us)
            if len(times_us) == 22:
                break
        say(f"attitude at {rate_hz:g} Hz", f"{20e6 / (times_us[-1] - times_us[1]):.1f}")


async def parameters(drone: Drone) -> None:
    everything = await drone.param.get_all_params()
    count = len(everything.int_params) + len(everything.float_params)
    say("parameters", f"{count} of which {len(everything.int_params)} whole numbers")
    before = await drone.param.get_param_float("MIS_TAKEOFF_ALT")
    await drone.param.set_param_float("MIS_TAKEOFF_ALT", 12.5)
    after = await drone.param.get_param_float("MIS_TAKEOFF_ALT")
    say("MIS_TAKEOFF_ALT", f"{before} then {after}")
    before = await drone.param.get_param_int("COM_OBL_RC_ACT")
    await drone.param.set_param_int("COM_OBL_RC_ACT", 5)
    say("COM_OBL_RC_ACT", f"{before} then {await drone.param.get_param_int('COM_OBL_RC_ACT')}")
    await drone.action.set_takeoff_altitude(7.5)
    say("take-off altitude", await drone.action.get_takeoff_altitude())
    for name, get in (
        ("NO_SUCH_PARAM", drone.param.get_param_int),
        ("MIS_TAKEOFF_ALT as whole number", drone.param.get_param_int),
    ):
        try:
            await get(name.split()[0])
        except api("param").ParamError as error:
            say(name, error)


def plan() -> tuple[object, object]:
    values = api("geofence")
    corners = [
        values.Point(HOME[0] + north, HOME[1] + east)
        for north, east in ((0.01, 0.01), (-0.01, 0.01), (-0.01, -0.01), (0.01, -0.01))
    ]
    fence = values.GeofenceData(
        [values.Polygon(corners, values.FenceType.INCLUSION)],
        [
            values.Circle(
                values.Point(HOME[0] + 0.003, HOME[1] + 0.003), 25.0, values.FenceType.EXCLUSION
            )
        ],
    )
    item = api("mission").MissionItem
    mission = api("mission").MissionPlan(
        [
            item(
                HOME[0] + 0.001 * k,
                HOME[1],
                10.0 + k,
                5.0,
                True,
                math.nan,
                math.nan,
                item.CameraAction.NONE,
                math.nan,
                math.nan,
                math.nan,
                math.nan,
                math.nan,
                item.VehicleAction.TAKEOFF if k == 0 else item.VehicleAction.NONE,
            )
            for k in range(4)
        ]
    )
    return mission, fence


async def plans(drone: Drone) -> None:
    mission, fence = plan()
    await drone.mission.upload_mission(mission)
    back = await drone.mission.download_mission()
    say(
        "mission",
        [f"{i.latitude_deg:.4f} {i.relative_altitude_m:.0f} m" for i in back.mission_items],
    )
    await drone.geofence.upload_geofence(fence)
    back = await drone.geofence.download_geofence()
    for polygon in back.polygons:
        say(
            "polygon",
            f"{polygon.fence_type.name} {[f'{p.latitude_deg:.4f}' for p in polygon.points]}",
        )
    for circle in back.circles:
        say(
            "circle",
            f"{circle.fence_type.name} {circle.point.latitude_deg:.4f} {circle.radius:.0f} m",
        )
    await drone.geofence.clear_geofence()
    back = await drone.geofence.download_geofence()
    say("after clearing", f"{len(back.polygons)} polygons, {len(back.circles)} circles")
    await drone.mission.clear_mission()
    back = await drone.mission.download_mission()
    say("after clearing", f"{len(back.mission_items)} mission items")


async def session(drone: Drone) -> None:
    await telemetry(drone)
    await rates(drone)
    await parameters(drone)
    await plans(drone)
    await asyncio.sleep(0)


if __name__ == "__main__":
    run(session)
