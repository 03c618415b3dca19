"""A scene as the two files that the programs read, mission.toml and world.toml, and flown so."""

from dataclasses import asdict
from pathlib import Path
from typing import Any, final

from pair_processes import Seen, Tap, end, start_companion, start_vehicle
from pair_worlds import Scene

from companion.campaign.drawn_files import mission_table
from companion.sources.files import toml_text


def write(scene: Scene, folder: Path, **vehicle: Any) -> tuple[Path, Path]:
    """mission.toml and world.toml of a scene; `vehicle` overrides keys of the mission's table."""
    folder.mkdir(parents=True, exist_ok=True)
    mission, world = folder / "mission.toml", folder / "world.toml"
    mission.write_text(toml_text(mission_table(scene.mission, vehicle)), encoding="utf-8")
    world.write_text(toml_text(_world(scene)), encoding="utf-8")
    return mission, world


def _world(scene: Scene) -> dict[str, Any]:
    """What is left out is None, or an empty list."""
    return _filled(asdict(scene.world) | {"schema": 1})


def _filled(table: dict[str, Any]) -> dict[str, Any]:
    return {
        key: _filled(value) if isinstance(value, dict) else value
        for key, value in table.items()
        if value is not None and value not in ((), [], {})
    }


@final
class Tapped:
    """A mission flown by both programs with a tap between them; all end with the `with`."""

    def __init__(self, scene: Scene, folder: Path, seen: Seen, **vehicle: Any) -> None:
        self.mission, world = write(scene, folder, **vehicle)
        self.run, self.log = folder / "run", folder / "companion.log"
        self.tap = Tap(seen)
        self.vehicle = start_vehicle(world, self.tap.vehicle_port)
        self.start()

    def start(self, *options: str) -> None:
        """The companion, for the first time or once more."""
        self.companion = start_companion(
            self.mission, self.tap.companion_port, self.run, *options, log=self.log
        )

    def said(self) -> str:
        """The last of what the companion printed."""
        return self.log.read_text(encoding="utf-8")[-3000:]

    def __enter__(self) -> "Tapped":
        return self

    def __exit__(self, *_: object) -> None:
        end(self.companion)
        end(self.vehicle)
        self.tap.close()
