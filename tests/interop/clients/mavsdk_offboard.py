"""The offboard example of MAVSDK: positions and velocities, then hold and land."""

import asyncio

from mavsdk_drone import Drone, api, run, say


async def started(drone: Drone) -> bool:
    try:
        await drone.offboard.start()
    except api("offboard").OffboardError as error:
        if "NO_SETPOINT_SET" not in str(error):
            raise
        return False
    return True


async def session(drone: Drone) -> None:
    values = api("offboard")
    await drone.until("health_all_ok", bool)
    try:
        await drone.offboard.start()
    except values.OffboardError as error:
        say("start without a setpoint", error)
    texts: list[str] = []

    async def listen() -> None:
        async for text in drone.stream("telemetry", "status_text"):
            texts.append(text.text)

    listener = asyncio.create_task(listen())
    await drone.arm()
    say("armed", await drone.until("armed", bool))
    up = values.PositionNedYaw(0.0, 0.0, -10.0, 0.0)
    await drone.offboard.set_position_ned(up)
    while not await started(drone):  # a heartbeat in between makes MAVSDK forget the setpoint
        await drone.offboard.set_position_ned(up)
    mode = await drone.until("flight_mode", lambda mode: mode.name == "OFFBOARD")
    say("flight mode", mode)
    await drone.until("position_velocity_ned", lambda now: now.position.down_m < -9.5)
    say("landed state", await drone.until("landed_state", lambda state: "IN_AIR" in state.name))
    await drone.offboard.set_position_ned(values.PositionNedYaw(20.0, 0.0, -10.0, 90.0))
    here = await drone.until("position_velocity_ned", lambda now: now.position.north_m > 19.0)
    say("position", f"{here.position.north_m:.0f} m north, {-here.position.down_m:.0f} m up")
    angle = await drone.until("attitude_euler", lambda angle: abs(angle.yaw_deg - 90.0) < 5.0)
    say("heading", f"{angle.yaw_deg:.0f} deg")
    await drone.offboard.set_velocity_ned(values.VelocityNedYaw(0.0, 4.0, -1.0, 90.0))
    here = await drone.until("position_velocity_ned", lambda now: now.position.east_m > 20.0)
    say("velocity", f"{here.velocity.east_m_s:.0f} m/s east, {-here.velocity.down_m_s:.0f} m/s up")
    say("offboard is active", await drone.offboard.is_active())
    await drone.offboard.stop()
    say("after stop", await drone.until("flight_mode", lambda mode: "HOLD" in mode.name))
    await drone.action.land()
    say("after land", await drone.until("flight_mode", lambda mode: "LAND" in mode.name))
    say("armed", await drone.until("armed", lambda armed: not armed))
    listener.cancel()
    say("texts", texts)


if __name__ == "__main__":
    run(session)
