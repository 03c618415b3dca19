"""Companion and simulator in one process, in lockstep: no sockets, no wall clock."""

import json
from typing import Any

from companion.mission.mission import Mission
from companion.mission.state import OVER
from companion.planner.plan import plan
from companion.runtime.compiler import load_kernel
from companion.session import Session
from vehicle_sim.simulation import Simulation
from vehicle_sim.world import World


class Flight:
    """One flight, as far as it is told to go."""

    def __init__(self, mission: Mission, world: World, *, seed: int = 1, faults: str = "") -> None:
        self.mission = mission
        self.session = Session(mission, seed=seed, lockstep=True)
        self.simulation = Simulation(world, seed=seed, faults=faults)
        self.journal: list[dict[str, Any]] = []
        self.truth: list[dict[str, Any]] = []
        """What the simulator has written of it so far, after `fly`."""
        self._asked: Any = None
        self._kernel = load_kernel()

    @property
    def now_s(self) -> float:
        return self.simulation.now_us * 1e-6

    def step(self) -> None:
        """One step of the simulator, and all that the companion says to it."""
        self.simulation.step()
        for _, frame in self.simulation.take_frames():
            self.session.receive(frame, self.now_s)
            out = self.session.run()
            while True:
                self._asked = out.plan or self._asked
                self.journal += out.journal
                for sent in out.frames:
                    self.sends(sent)
                    self.simulation.receive(0, sent)
                if not out.awaits_plan:
                    break
                self.session.deliver(plan(self._asked, lambda: False, self._kernel))
                out = self.session.run()

    def sends(self, frame: bytes) -> None:
        """What the companion says to the vehicle; for those who want to look at it."""

    def fly(self, *, limit_s: float = 400.0) -> None:
        """Until the companion has ended it."""
        while self.session.state.phase not in OVER:
            self.step()
            assert self.now_s < limit_s, self.session.state.phase
        self.truth += [json.loads(line) for line in self.simulation.take_truth() if "t_s" in line]

    @property
    def says(self) -> list[str]:
        """What people were told."""
        return [entry["text"] for entry in self.journal if entry.get("kind") == "say"]

    @property
    def end(self) -> dict[str, Any]:
        [end] = [entry for entry in self.journal if entry.get("kind") == "end"]
        return end

    @property
    def outcome(self) -> str:
        """How the journal says that it ended."""
        return str(self.end["outcome"])
