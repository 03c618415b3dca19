"""Flights in this process: a vehicle and its companion in lockstep, without sockets."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import version
from typing import Any, Protocol, final

from companion.campaign.drawn_faults import split
from companion.campaign.flight import Flight, FlightFiles, truth_of
from companion.config import load_mission, mission_text
from companion.entry_points import Parts
from companion.errors import InputError
from companion.mavlink.link import Output
from companion.planning import plan
from companion.runtime.in_process import SimulatedVehicle, loop_in_process
from companion.runtime.recorder import Recorder
from companion.session import Session
from companion.telemetry.resume import load_resume_data
from companion.telemetry.run_folder import RunFolder, journal_line

_EPOCH_US = 1_700_000_000_000_000
"""Stamps of logs begin here, so that a run leaves the same bytes each time."""


class Vehicle(SimulatedVehicle, Protocol):
    """Of an entry point in the group `companion.vehicles`."""

    def take_truth(self) -> list[str]:
        """Where it really was since the last call: lines of JSON, after a header."""
        ...


@final
class _Listener:
    """A writer that remembers the journal, and hands all on to one that writes."""

    def __init__(self) -> None:
        self.journal: list[dict[str, Any]] = []
        self.inner: Recorder | None = None

    def put(self, out: Output) -> None:
        self.journal += [json.loads(journal_line(entry)) for entry in out.journal]
        if self.inner is not None:
            self.inner.put(out)

    def heir(self) -> "_Listener":
        """One that goes on with the journal; this one hears nothing more that counts."""
        heir = _Listener()
        heir.journal, self.journal, self.inner = self.journal, [], None
        return heir

    def close(self) -> None:
        if self.inner is not None:
            self.inner.close()


def _wrong_with(maker: Callable[..., Vehicle]) -> str | None:
    return None if callable(maker) else "it cannot be called"


_VEHICLES: Parts[Callable[..., Vehicle]] = Parts(
    "companion.vehicles", {}, what="vehicle", check=_wrong_with
)


def _maker() -> Callable[..., Vehicle]:
    for name in _VEHICLES:
        return _VEHICLES[name]
    rule, remedy = "no package brings one", "Install the project again: pip install ."
    raise InputError("companion.vehicles", None, rule, remedy)


def check(files: FlightFiles) -> None:
    """Raises what is wrong with a mission, a world or faults."""
    load_mission(str(files.mission))
    _maker()(files.world, seed=0, faults=split(files.faults)[0])


@final
class Flying:
    """A vehicle and its companion in this process, in lockstep, flown on turn by turn."""

    def __init__(self, files: FlightFiles, *, seed: int, limit_s: float, recorded: bool) -> None:
        self._files, self._mission = files, load_mission(str(files.mission))
        self._vehicle = _maker()(files.world, seed=seed, faults=files.faults)
        self._seed, self._limit_s, self._recorded = seed, limit_s, recorded
        self._folder: RunFolder | None = None
        self._listener = _Listener()
        self.flies = True
        """Whether its mission has not ended."""
        self._begin()

    def _begin(self, *, again: bool = False) -> None:
        """One life of the companion."""
        resume = load_resume_data(self._files.folder, self._mission).resume if again else None
        session = Session(
            self._mission, seed=self._seed, lockstep=True, version=version("companion"),
            resume=resume,
        )  # fmt: skip
        self.loop = loop_in_process(
            session,
            self._vehicle,
            planner=plan,
            stop_asked=lambda: self.loop.clock() >= self._limit_s,
        )
        self.loop.writer = self._listener
        if self._recorded:
            text = mission_text(str(self._files.mission))
            folder = RunFolder(
                self._files.folder, mission_toml=text, epoch_us=_EPOCH_US, resume=again,
                durable=False,
            )  # fmt: skip
            facts = {
                "mission": self._mission.name,
                "seed": self._seed,
                "profile": self._mission.task.settings.profile.name,
            }
            folder.header(facts | {"lockstep": True})
            self._listener.inner = Recorder(folder, self.loop.clock, lambda _: None)
            self._folder = folder
        self._turns = self.loop.turns()

    def die(self, away_s: float) -> None:
        """The companion is killed: nothing more is written; after a time another one resumes."""
        dead = self._listener
        self._listener = dead.heir()
        self._turns = iter(())  # so the control loop of the dead one ends
        if self._folder is not None:
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
            if self.loop.clock() > 2.0 * self._limit_s:
                text = f"the flight did not end when it was stopped after {self._limit_s:g} s"
                raise TimeoutError(text)

    def close(self) -> None:
        """Write what is left, and the truth."""
        self.loop.writer.close()
        truth = "".join(f"{line}\n" for line in self._vehicle.take_truth())
        (self._files.folder / "truth.jsonl").write_text(truth, encoding="utf-8")
        if self._folder is not None:
            self._folder.close()

    def flight(self) -> Flight:
        """What it left, once closed."""
        return Flight(
            mission=self._mission,
            journal=self._listener.journal,
            truth=truth_of(self._files.folder),
            plans_s=self.loop.flown.plans_s,
            folder=self._files.folder,
        )


def fly_here(files: FlightFiles, *, seed: int, limit_s: float, recorded: bool) -> Flight:
    """Both in this process; a companion that is killed is resumed from its folder."""
    timeline, to_come = split(files.faults)
    flying = Flying(
        replace(files, faults=timeline),
        seed=seed,
        limit_s=limit_s,
        recorded=recorded or bool(to_come),
    )
    try:
        for happening in to_come:
            flying.fly_on(1e6 * happening.at_s)
            if flying.flies:
                flying.die(happening.until_s - happening.at_s)
        flying.fly_on(math.inf)
    finally:
        flying.close()
    return flying.flight()
