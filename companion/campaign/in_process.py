"""Flights in this process: a vehicle and its companion in lockstep, without sockets."""

import json
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import version
from typing import Any, Protocol, final

from companion.campaign.drawn_faults import split
from companion.campaign.flight import Flight, FlightFiles, truth_of
from companion.campaign.growth import Growth
from companion.config import load_mission, mission_text
from companion.entry_points import Parts
from companion.errors import InputError
from companion.planner.plan import plan
from companion.runtime.in_process import SimulatedVehicle, loop_in_process
from companion.runtime.recorder import Batch, InlineWriter, Recorder
from companion.session import Session
from companion.telemetry.resume import load_resume_data
from companion.telemetry.run_folder import RunFolder, journal_line

_EPOCH_US = 1_700_000_000_000_000
"""Stamps of logs begin here, so that a run leaves the same bytes each time."""
_LOOK_S = 60.0


class Vehicle(SimulatedVehicle, Protocol):
    """Of an entry point in the group `companion.vehicles`."""

    def take_truth(self) -> list[str]:
        """Where it really was since the last call: lines of JSON, after a header."""
        ...


@final
class _Listener:
    """A writer that remembers journal and frames, and hands all on to one that writes."""

    def __init__(self, shared: frozenset[int], system: int | None) -> None:
        self.journal: list[dict[str, Any]] = []
        self.said: list[bytes] = []
        """Frames of MAVLink 2 by this system with these numbers."""
        self.inner: InlineWriter | None = None
        self._shared, self._system = shared, system

    def put(self, batch: Batch) -> None:
        self.journal += [json.loads(journal_line(entry)) for entry in batch.journal]
        if self._shared:
            said = (frame for _, frame in batch.record if frame[5] == self._system)
            self.said += [f for f in said if int.from_bytes(f[7:10], "little") in self._shared]
        if self.inner is not None:
            self.inner.put(batch)

    def heir(self) -> "_Listener":
        """One that goes on with the journal; this one hears nothing more that counts."""
        heir = _Listener(self._shared, self._system)
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

    def __init__(
        self,
        files: FlightFiles,
        *,
        seed: int,
        limit_s: float,
        recorded: bool,
        shared: frozenset[int] = frozenset(),
    ) -> None:
        """shared: numbers of the messages of its own that `take_said` gives."""
        self._files, self._mission = files, load_mission(str(files.mission))
        self._vehicle = _maker()(files.world, seed=seed, faults=files.faults)
        self._seed, self._limit_s, self._recorded = seed, limit_s, recorded
        self._folder: RunFolder | None = None
        self._listener = _Listener(shared, self._mission.system_id)
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
            recorder = Recorder(folder, self.loop.clock, persist=None)
            self._listener.inner, self._folder = InlineWriter(recorder, lambda _: None), folder
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

    def take_said(self) -> list[bytes]:
        """The frames to share since the last call."""
        said, self._listener.said = self._listener.said, []
        return said

    def write_truth(self) -> None:
        """What there is of it."""
        with (self._files.folder / "truth.jsonl").open("a", encoding="utf-8") as file:
            file.writelines(f"{line}\n" for line in self._vehicle.take_truth())

    def close(self) -> None:
        """Write what is left."""
        self.loop.writer.close()
        self.write_truth()
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
    growth = Growth()
    try:
        while flying.flies:
            look_s = flying.now_s + _LOOK_S
            if to_come and to_come[0].at_s < look_s:
                flying.fly_on(1e6 * to_come[0].at_s)
                happening = to_come.pop(0)
                if flying.flies:
                    flying.die(happening.until_s - happening.at_s)
                continue
            flying.fly_on(1e6 * look_s)
            flying.write_truth()
            growth.look(flying.now_s)
    finally:
        flying.close()
    return replace(flying.flight(), growth=growth if growth.is_known else None)
