"""Import a .plan, upload all of it, and read the mission back from the vehicle."""

import sys
from typing import Any

from mavsdk_drone import Drone, run, say


def told(what: str, items: list[Any]) -> None:
    say(what, [(item.command, item.frame, item.x, item.y, round(item.z, 3)) for item in items])


async def session(drone: Drone) -> None:
    raw = drone.mission_raw
    found = await raw.import_qgroundcontrol_mission(sys.argv[3])
    told("mission", found.mission_items)
    told("geofence", found.geofence_items)
    told("rally", found.rally_items)
    say("radii", [(item.command, item.param1) for item in found.geofence_items])
    await raw.upload_mission(found.mission_items)
    told("downloaded", await raw.download_mission())
    await raw.upload_geofence(found.geofence_items)
    await raw.upload_rally_points(found.rally_items)


if __name__ == "__main__":
    run(session)
