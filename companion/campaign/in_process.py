"""A flight of a campaign: a vehicle and its companion in this process, in lockstep, no sockets.

It leaves a run folder and the truth, and only these are looked at afterwards.  The simulator is an
entry point, for the companion imports none.
"""

import errno
import functools
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from importlib.metadata import entry_points, version
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol, final

import numpy as np

from companion.config import read_mission
from companion.errors import InputError
from companion.geodesy import FloatArray
from companion.mission.mission import Mission
from companion.planning import plan
from companion.runtime.in_process import SimulatedVehicle, loop_in_process
from companion.runtime.recorder import Recorder
from companion.session import Session
from companion.telemetry.resume import load_resume_data
from companion.telemetry.run_folder import RunFolder

_KILLED: Final = "companion_off"
"""The fault that befalls the companion, and not its vehicle."""
_EPOCH_US: Final = 1_700_000_000_000_000
"""Stamps of logs begin here, so that a run leaves the same bytes each time."""


class Vehicle(SimulatedVehicle, Protocol):
    """One that flies in this process."""

    def take_truth(self) -> list[str]:
        """Where it really was since the last call: lines of JSON, after a header."""


class Happening(Protocol):
    """A line of a timeline, and what it asks for."""

    at_us: int
    until_us: int
    sets: Mapping[str, Any]
    fault: Any
    """Its row, as `Fault` in vehicle_sim/faults.py: also by what a companion is judged then."""


class Simulator(Protocol):
    """The module that an entry point in the group `companion.vehicles` names."""

    def vehicle(self, world: Path, *, seed: int, faults: str) -> Vehicle:
        """The vehicle of a world.toml, with a timeline of faults."""

    def entries(self, text: str) -> Sequence[Happening]:
        """The lines of a timeline."""

    def ways(self) -> Iterable[tuple[int, str, str, str]]:
        """Ways in which faults are drawn: `drawn_faults.Way`."""


@functools.cache
def simulator() -> Simulator:
    """The one that is installed; InputError if none is."""
    for point in entry_points(group="companion.vehicles"):
        module: Simulator = point.load()
        if hasattr(module, "ways"):  # of an older installation it is not the module
            return module
    rule, remedy = "no package brings one", "Install the project again: pip install ."
    raise InputError("companion.vehicles", None, rule, remedy)


class FlightFiles(NamedTuple):
    """What a flight is flown by; all that it writes is written into the folder."""

    world: Path
    mission: Path
    faults: str
    """A timeline, with when the companion is killed."""
    folder: Path
    drawn: str = ""
    """What the drawn faults are called."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Flight:
    """What a flight left."""

    mission: Mission
    journal: list[dict[str, Any]]
    truth: list[dict[str, Any]]
    """Where the vehicle really was."""
    plans_s: Sequence[float] = ()
    reported: FloatArray = field(default_factory=lambda: np.empty((0, 5)))
    """Positions that the companion was told: when, of what time, north, east, altitude; (K, 5)."""

    def entries(self, **like: str) -> list[dict[str, Any]]:
        """The entries of its journal that have these values."""
        return [e for e in self.journal if all(e.get(key) == like[key] for key in like)]


@final
class Flying:
    """A vehicle and its companion in this process, in lockstep, flown on turn by turn."""

    def __init__(self, files: FlightFiles, *, seed: int, limit_s: float) -> None:
        """Raises what is wrong with a mission, a world or faults, before anything is written."""
        file = read_mission(str(files.mission))
        self._mission, self._text = file.mission(), file.text
        self._vehicle = simulator().vehicle(files.world, seed=seed, faults=files.faults)
        self._files, self._seed, self._limit_s = files, seed, limit_s
        self.flies = True
        """Whether its mission has not ended."""
        self._reported = list[tuple[float, ...]]()
        self._begin()

    def _begin(self, *, again: bool = False) -> None:
        """One life of the companion."""
        mission, folder, seed = self._mission, self._files.folder, self._seed
        resume = load_resume_data(folder, mission).resume if again else None
        made_by = version("companion")
        session = Session(mission, seed=seed, lockstep=True, version=made_by, resume=resume)
        self.loop = loop_in_process(
            session,
            self._vehicle,
            planner=plan,
            stop_asked=lambda: self.loop.clock() >= self._limit_s,
        )
        self._folder = RunFolder(
            folder, mission_toml=self._text, epoch_us=_EPOCH_US, resume=again, durable=False
        )
        profile = mission.task.settings.profile.name
        facts = {"mission": mission.name, "seed": seed, "profile": profile, "lockstep": True}
        self._folder.header(facts)
        self._recorder = Recorder(self._folder, self.loop.clock, self.loop.lost)
        self.loop.record = self._recorder.put
        self._turns = self.loop.turns()

    def die(self, away_s: float) -> None:
        """The companion is killed: nothing more is written; after a time another one resumes."""
        self._turns = iter(())
        self._folder.close()
        for _ in range(round(100.0 * away_s)):
            self._vehicle.step()
            self._vehicle.take_frames()
        self._begin(again=True)

    @property
    def now_s(self) -> float:
        """Vehicle time."""
        return self._vehicle.now_us * 1e-6

    def fly_on(self, until_us: float) -> None:
        """To a time of the vehicle, or to the mission's end."""
        while self.flies and self._vehicle.now_us < until_us:
            self.flies = next(self._turns, self) is not self
            vehicle = self.loop.session.state.vehicle
            is_news = not self._reported or vehicle.position_at_s != self._reported[-1][1]
            if vehicle.position_nea_m is not None and is_news:
                self._reported.append((self.now_s, vehicle.position_at_s, *vehicle.position_nea_m))
            if self.loop.clock() > 2.0 * self._limit_s:
                text = f"the flight did not end when it was stopped after {self._limit_s:g} s"
                raise TimeoutError(text)

    def close(self) -> None:
        """Write what is left, and the truth."""
        self._recorder.close()
        truth = "".join(f"{line}\n" for line in self._vehicle.take_truth())
        (self._files.folder / "truth.jsonl").write_text(truth, encoding="utf-8")
        self._folder.close()
        if (failure := self._folder.failure) is not None:  # what was not recorded is no result
            raise OSError(errno.ENOSPC, failure, str(self._folder.path))

    def flight(self) -> Flight:
        """What it left, once closed."""
        flight = recorded(self._files.folder, self._mission)
        reported = np.array(self._reported).reshape(-1, 5)
        return replace(flight, plans_s=self.loop.flown.plans_s, reported=reported)


def recorded(folder: Path, mission: Mission) -> Flight:
    """The flight of a run folder with the truth in it; what no file tells is empty."""
    journal = _lines_with("kind", folder / "journal.jsonl")
    return Flight(
        mission=mission, journal=journal, truth=_lines_with("t_s", folder / "truth.jsonl")
    )


def _lines_with(key: str, path: Path) -> list[dict[str, Any]]:
    """The lines of a file of JSON but for headers."""
    lines = path.read_text(encoding="utf-8").splitlines()
    return [entry for line in lines if key in (entry := json.loads(line))]


def fly_here(files: FlightFiles, *, seed: int, limit_s: float) -> Flight:
    """Both in this process; a companion that is killed is resumed from its folder."""
    with closing(Flying(files, seed=seed, limit_s=limit_s)) as flying:
        for entry in sorted(simulator().entries(files.faults), key=lambda entry: entry.at_us):
            if entry.fault.name == _KILLED:
                flying.fly_on(entry.at_us)
                if flying.flies:
                    flying.die(1e-6 * (entry.until_us - entry.at_us))
        flying.fly_on(math.inf)
    return flying.flight()
