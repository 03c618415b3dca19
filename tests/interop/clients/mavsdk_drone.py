"""MAVSDK-Python of either kind behind the names that both have: mavsdk (4) and mavsdk<4 (gRPC)."""

import asyncio
import importlib
import os
import sys
import traceback
from collections.abc import AsyncIterator, Callable
from typing import Any

import mavsdk

IS_GRPC = not hasattr(mavsdk, "Mavsdk")
PATIENCE_S = 30.0


def api(plugin: str) -> Any:
    """The module of a plugin's values and errors."""
    return importlib.import_module(f"mavsdk.{plugin}" if IS_GRPC else f"mavsdk.plugins.{plugin}")


class Drone:
    """One vehicle and its plugins, as attributes: telemetry, action, offboard, ..."""

    def __init__(self, system: Any) -> None:
        self._system = system
        self._plugins: dict[str, Any] = {}

    def __getattr__(self, plugin: str) -> Any:
        if IS_GRPC:
            return getattr(self._system, plugin)
        if plugin not in self._plugins:
            module = importlib.import_module(f"mavsdk.asyncio.plugins.{plugin}")
            name = "".join(part.capitalize() for part in plugin.split("_"))
            self._plugins[plugin] = getattr(module, f"{name}Async")(self._system)
        return self._plugins[plugin]

    def stream(self, plugin: str, topic: str) -> AsyncIterator[Any]:
        """What the plugin tells of this, as it comes."""
        owner = getattr(self, plugin)
        return getattr(owner, topic if IS_GRPC else f"subscribe_{topic}")()

    async def next(self, topic: str) -> Any:
        """The next that telemetry says of this."""
        return await self.until(topic, lambda _: True)

    async def until(
        self, topic: str, reached: Callable[[Any], bool], plugin: str = "telemetry"
    ) -> Any:
        """The first that is so."""

        async def search() -> Any:
            async for value in self.stream(plugin, topic):
                if reached(value):
                    return value
            raise EOFError(topic)

        try:
            return await asyncio.wait_for(search(), PATIENCE_S)
        except TimeoutError:
            raise TimeoutError(f"{topic}: not within {PATIENCE_S:g} s") from None

    async def arm(self) -> None:
        """Arm when its checks pass, which they do not while it misses our heartbeat."""
        while True:
            await self.until("health_all_ok", bool)
            try:
                return await self.action.arm()
            except api("action").ActionError as error:
                if "DENIED" not in str(error):
                    raise
                say("not armed", error)


async def connected(url: str, port: int) -> Drone:
    """Connect, and wait until the vehicle is there.  `port`: of the server program, with gRPC."""
    if IS_GRPC:
        system = mavsdk.System(port=port)
        await system.connect(system_address=url)
        async for state in system.core.connection_state():
            if state.is_connected:
                break
        return Drone(system)
    from mavsdk.asyncio import ComponentType, Configuration, Mavsdk

    configuration = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    whole = Mavsdk(configuration)
    await whole.add_any_connection(url)
    found = await whole.first_autopilot(timeout_s=PATIENCE_S)
    if found is None:
        sys.exit("no autopilot")
    drone = Drone(found)
    drone.whole = whole  # it ends with its last reference
    return drone


def say(what: str, value: object = "") -> None:
    """One line of the transcript; a value of an enumeration by its name."""
    value = getattr(value, "name", value)
    line = f"{what}: {value}" if value != "" else what
    sys.stdout.write(f"{line}\n")  # in one piece, for others write there too
    sys.stdout.flush()


def run(session: Callable[[Drone], Any]) -> None:
    """Run a session against the URL and with the port that the command line names."""

    def note(level: Any, message: str, *_: object) -> bool:
        say(f"MAVSDK {level.name.lower()}", message.strip())
        return True  # and not by itself, which would mix with our lines

    async def whole() -> None:
        if not IS_GRPC:
            mavsdk.log_subscribe(note)
        drone = await connected(sys.argv[1], int(sys.argv[2]))
        say("connected with mavsdk", getattr(mavsdk, "__version__", "3"))
        await session(drone)
        say("session complete")
        if not IS_GRPC:
            mavsdk.log_unsubscribe()

    complete = False
    try:
        asyncio.run(whole())
        complete = True
    finally:
        if not complete:
            traceback.print_exc()
            os._exit(1)  # threads of the libraries would keep a failed session alive
