"""Take off by command, fly somewhere, fly a mission, come home."""

import asyncio
import math

from mavsdk_drone import Drone, api, run, say

HOME = (47.397742, 8.545594)


def waypoint(north_deg: float, height_m: float) -> object:
    item = api("mission").MissionItem
    return item(
        HOME[0] + north_deg,
        HOME[1],
        height_m,
        8.0,
        True,
        math.nan,
        math.nan,
        item.CameraAction.NONE,
        math.nan,
        math.nan,
        math.nan,
        math.nan,
        math.nan,
        item.VehicleAction.NONE,
    )


async def session(drone: Drone) -> None:
    await drone.until("health_all_ok", bool)
    await drone.action.set_takeoff_altitude(10.0)
    await drone.action.set_return_to_launch_altitude(20.0)
    say("return altitude", await drone.action.get_return_to_launch_altitude())
    await drone.arm()
    await drone.action.takeoff()
    say("flight mode", await drone.until("flight_mode", lambda mode: "TAKEOFF" in mode.name))
    say("then", await drone.until("flight_mode", lambda mode: "HOLD" in mode.name))
    above = await drone.next("position")
    say("height", f"{above.relative_altitude_m:.0f} m")
    await drone.action.goto_location(
        HOME[0], HOME[1] + 0.0004, above.absolute_altitude_m + 5.0, 0.0
    )
    there = await drone.until("position", lambda now: now.longitude_deg > HOME[1] + 0.00038)
    say("went to", f"{there.longitude_deg:.4f}")

    items = [waypoint(0.0002, 15.0), waypoint(0.0005, 20.0), waypoint(0.0005, 15.0)]
    await drone.mission.upload_mission(api("mission").MissionPlan(items))
    await drone.mission.start_mission()
    say("flight mode", await drone.until("flight_mode", lambda mode: "MISSION" in mode.name))
    seen: list[str] = []

    async def follow() -> None:
        async for progress in drone.stream("mission", "mission_progress"):
            seen.append(f"{progress.current}/{progress.total}")
            if progress.current == progress.total:
                return

    await asyncio.wait_for(follow(), 40.0)
    say("progress", list(dict.fromkeys(seen)))
    say("finished", await drone.mission.is_mission_finished())
    await drone.action.return_to_launch()
    say("then", await drone.until("flight_mode", lambda mode: "RETURN_TO_LAUNCH" in mode.name))
    await drone.until("armed", lambda armed: not armed)
    say("landed", await drone.next("landed_state"))


if __name__ == "__main__":
    run(session)
