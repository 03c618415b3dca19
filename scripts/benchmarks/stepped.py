"""A companion and a simulated vehicle in this process, in lockstep, step by step."""

import math
from collections.abc import Sequence

from companion.mission.mission import Mission
from companion.mission.state import Phase
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
    def speed_m_s(self) -> float:
        """Over ground, of the vehicle."""
        vehicle = self.simulation.vehicle
        return math.hypot(vehicle.velocity_north_m_s, vehicle.velocity_east_m_s)

    def step(self) -> None:
        """One step of the simulator, and all that the companion says to it."""
        self.simulation.step()
        for _, frame in self.simulation.take_frames():
            self.session.receive(frame, self.now_s)
            out = self.session.run()
            while True:
                self._asked = out.plan or self._asked
                self.said(out.frames)
                if not out.awaits_plan:
                    break
                assert self._asked is not None
                self.session.deliver(self.planned(self._asked))
                out = self.session.run()

    def said(self, frames: Sequence[bytes]) -> None:
        """The companion has sent these."""
        for frame in frames:
            self.simulation.receive(0, frame)

    def planned(self, request: PlanRequest) -> PlanOutcome:
        """What the planner answers."""
        return plan(request)
