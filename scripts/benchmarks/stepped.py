"""A companion and a simulated vehicle in this process, in lockstep, step by step."""

import math
import sys
from types import FrameType

from companion.mission.mission import Mission
from companion.mission.phases import OVER, Phase
from companion.planner.plan import plan
from companion.planner.request import PlanOutcome, PlanRequest
from companion.session import Session
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import World


class Flight:
    """One flight."""

    def __init__(self, mission: Mission, world: World, seed: int, faults: str = "") -> None:
        self.mission = mission
        self.session = Session(mission, seed=seed, lockstep=True)
        self.simulation = Simulation(world, seed=seed, faults=faults)
        self._asked: PlanRequest | None = None

    @property
    def now_s(self) -> float:
        return self.simulation.now_us * 1e-6

    @property
    def phase(self) -> Phase:
        return self.session.state.phase

    @property
    def is_over(self) -> bool:
        return self.phase in (Phase.ARRIVED, *OVER)

    @property
    def speed_m_s(self) -> float:
        """Over ground, of the vehicle."""
        vehicle = self.simulation.vehicle
        return math.hypot(*vehicle.velocity_neu_m_s[:2])

    def step(self) -> None:
        """One step of the simulator, and all that the companion says to it."""
        self.simulation.step()
        for _, frame in self.simulation.take_frames():
            for answer in self.answers(frame):
                self.simulation.receive(0, answer)

    def answers(self, frame: bytes) -> list[bytes]:
        """What the companion says to a frame."""
        self.session.receive(frame, self.now_s)
        out, frames = self.session.run(), list[bytes]()
        while True:
            self._asked = out.plan or self._asked
            frames += out.frames
            if not out.awaits_plan:
                return frames
            assert self._asked is not None
            self.session.deliver(self.planned(self._asked))
            out = self.session.run()

    def planned(self, request: PlanRequest) -> PlanOutcome:
        """What the planner answers."""
        return plan(request)


class Called:
    """The calls of a package's functions while it is entered, and the files that these are in."""

    def __init__(self, package: str) -> None:
        self._package = package
        self.calls, self.files = 0, set[str]()

    def _noted(self, frame: FrameType, event: str, _: object) -> None:
        file = frame.f_code.co_filename
        if event == "call" and self._package in file and frame.f_code.co_name[0] != "<":
            self.calls += 1
            self.files.add(file)

    def __enter__(self) -> "Called":
        sys.setprofile(self._noted)
        return self

    def __exit__(self, *_: object) -> None:
        sys.setprofile(None)
