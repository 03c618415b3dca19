"""Companion and vehicle in one process: no sockets, no wall clock, exact steps of vehicle time.

    Pair(scene, seed=1).fly() -> Flown

The companion's `Session` and the simulator's `Simulation` exchange bytes and nothing else, as over
a link without delay; a ground station on a link of its own can upload a fence, change the mode and
command the companion.  The session is run as it is in flight, not in its own lockstep: its silence,
its plans' lateness and its time-outs are those of vehicle time, which here is the only time.  Plans
are computed when they are asked for, and are handed over 20 ms later.
"""

import json
import math
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, final

import numpy as np
import pair_processes as processes
from numpy.typing import NDArray
from pair_processes import number_of
from pair_station import CHATTER, COMPONENT, SYSTEM, Station
from pair_worlds import Scene
from pymavlink.dialects.v20 import all as wire

from companion.mavlink.link import Input, Output
from companion.mission.state import Phase
from companion.planner.kernels import Kernel
from companion.planner.plan import plan
from companion.planner.request import PlanOutcome
from companion.session import Session
from vehicle_sim.simulation import Simulation

FloatArray = NDArray[np.float64]

COMPANION_LINK, STATION_LINK = 0, 1
_POLL_S = 0.2
_PLAN_S = 0.02
"""How long a plan takes, in vehicle time."""
_SETTLE_S = 3.0
_AFTER_S = 5.0
"""What is flown on after the companion has ended, to see what it left behind."""
_BOOT_S = 90.0
_PATIENCE_S = 90.0
"""Who has held for so long, and nothing more is going to happen, holds for good."""
_SAMPLE_US = 100_000
_DO_REPOSITION = 192


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """What the companion thought at a moment."""

    t_s: float
    phase: str
    reason: str
    believed_nea_m: tuple[float, float, float] | None
    """Newest position that the vehicle told it."""
    believed_at_s: float
    """When it was told."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Sent:
    """One setpoint, as it left the companion."""

    t_s: float
    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float
    velocity_ned_m_s: tuple[float, float, float] | None


@final
@dataclass(slots=True, kw_only=True)
class Flown:
    """All that is known of a flight afterwards."""

    scene: Scene
    truth: list[dict[str, Any]] = field(default_factory=list)
    samples: list[Sample] = field(default_factory=list)
    sent: list[Sent] = field(default_factory=list)
    journal: list[dict[str, Any]] = field(default_factory=list)
    outcome: str = ""
    """How the companion says that it ended; empty if it did not."""
    reason: str = ""
    died: str = ""
    """What the companion itself died of, if it did."""
    airborne_s: float = math.inf
    """When the companion first flew."""
    ended_s: float = math.inf
    fences: list[tuple[float, tuple[Any, ...]]] = field(default_factory=list)
    """When the vehicle had the whole of a fence, and its zones."""
    done: list[tuple[float, str]] = field(default_factory=list)
    """What was made to happen, and when."""
    texts: list[tuple[int, str]] = field(default_factory=list)
    """What the ground station read: component and text."""
    inputs: list[Input] | None = None
    """All that the companion was told, if a list is there for it."""

    def track(self) -> tuple[FloatArray, FloatArray]:
        """True times (N,) and positions (N, 3)."""
        keys = ("north_m", "east_m", "altitude_amsl_m")
        rows = [[row[key] for key in keys] for row in self.truth]
        return np.array([row["t_s"] for row in self.truth]), np.array(rows)


Happening = Callable[["Pair"], None]
"""Something that is made to happen once the time has come."""


@final
class Brain:
    """One life of the companion: its session, and what its runtime does around it."""

    def __init__(self, session: Session, kernel: Kernel) -> None:
        self.session = session
        self.out_frames: list[bytes] = []
        self.ended_s: float | None = None
        self.over = False
        self.checkpoint: Any = None
        """What it has written to disk, as its known map."""
        self.known: Any = None
        self._kernel = kernel
        self._heard_s = self._polled_s = 0.0
        self._answers: list[tuple[float, PlanOutcome]] = []

    def begin(self, now_s: float) -> None:
        self._heard_s = self._polled_s = now_s

    def on_data(self, data: bytes, now_s: float, flown: Flown) -> None:
        """What the runtime does with a datagram."""
        self._polled_s = now_s
        if self.session.receive(data, now_s):
            self._heard_s = now_s
        else:
            self.session.silence(now_s - self._heard_s)
        self._run(now_s, flown)

    def on_time(self, now_s: float, flown: Flown) -> None:
        """What it does when nothing comes in."""
        if now_s - self._polled_s >= _POLL_S - 1e-9:
            self._polled_s = now_s
            self.session.silence(now_s - self._heard_s)
            self._run(now_s, flown)

    def _run(self, now_s: float, flown: Flown) -> None:
        while self._answers and self._answers[0][0] <= now_s:
            self.session.deliver(self._answers.pop(0)[1])
        self._carry_out(self.session.run(), now_s, flown)
        if self.ended_s is not None and not self.over:
            settled = now_s - self.ended_s > _SETTLE_S
            if settled or self._settled:
                self._carry_out(self.session.farewell(), now_s, flown)
                self.over = True

    def _carry_out(self, out: Output, now_s: float, flown: Flown) -> None:
        self.out_frames += out.frames
        for entry in out.journal:
            entry.setdefault("at_s", round(now_s, 2))
        flown.journal += out.journal
        if flown.inputs is not None:
            flown.inputs += out.inputs
        self._settled = out.settled
        if out.checkpoint is not None:
            self.checkpoint = out.checkpoint
        if out.known is not None:
            self.known = out.known
        if out.plan is not None:
            self._answers.append((now_s + _PLAN_S, plan(out.plan, lambda: False, self._kernel)))
        if out.end is not None and self.ended_s is None:
            self.ended_s = now_s
            flown.outcome, flown.reason = out.end.outcome.value, out.end.reason


@final
class Pair:
    """A companion, a vehicle and a ground station."""

    def __init__(self, scene: Scene, *, seed: int, kernel: Kernel, faults: str = "") -> None:
        self.scene, self.seed = scene, seed
        self.simulation = Simulation(scene.world, seed=seed, links=2, faults=faults)
        self.station = Station(scene.world.frame)
        self.brain: Brain | None = None
        self.flown = Flown(scene=scene)
        self._kernel = kernel
        self._due: list[tuple[float, Happening]] = []
        """Seconds after the companion began to fly, and what then."""
        self._restart_s, self._held_s = math.inf, 0.0
        self._left: tuple[Any, Any] = (None, None)

    @property
    def now_s(self) -> float:
        return self.simulation.now_us * 1e-6

    def at(self, after_s: float, happening: Happening) -> None:
        """Make something happen so long after the companion began to fly."""
        self._due.append((after_s, happening))
        self._due.sort(key=lambda item: item[0])

    def note(self, what: str) -> None:
        self.flown.done.append((self.now_s, what))

    def where(self) -> tuple[float, float, float]:
        """The true position of the vehicle in the local frame."""
        vehicle = self.simulation.vehicle
        place = self.scene.world.frame.to_local(vehicle.latitude_deg, vehicle.longitude_deg)
        return (*place, vehicle.altitude_amsl_m)

    # --- the companion's lives

    def kill(self, away_s: float) -> None:
        """The companion's process is gone at once; another one is started after a while."""
        if self.brain is not None:
            self._left = (self.brain.checkpoint, self.brain.known)
        self.brain = None
        self._restart_s = self.now_s + away_s

    def new_brain(self, *, resume: bool = False) -> Brain:
        """Another life: from nothing, or from what the one before has left."""
        left = self._left if resume and self._left[0] is not None else None
        session = Session(self.scene.mission, seed=self.seed, lockstep=False, resume=left)
        brain = Brain(session, self._kernel)
        if resume:
            brain.checkpoint, brain.known = self._left
        return brain

    # --- time

    def fly(self, *, limit_s: float = 300.0) -> Flown:
        """From the boot to what the companion leaves behind."""
        self._boot()
        self.brain = self.new_brain()
        self.brain.begin(self.now_s)
        until_s = self.now_s + limit_s
        try:
            while self.now_s < until_s:
                self._step()
                self._happen()
                if (self.brain is not None and self.brain.over) or self._waits_in_vain():
                    break
            self._see_what_is_left()
        except Exception as error:  # noqa: BLE001 - whatever it is, it is a finding
            self.flown.died = f"{type(error).__name__}: {error}"
        self.flown.truth = [
            json.loads(line) for line in self.simulation.take_truth() if '"t_s"' in line
        ]
        self.flown.texts = self.station.texts
        return self.flown

    def _boot(self) -> None:
        """Until the vehicle can be armed and has its fence."""
        while not self.simulation.armable and self.now_s < _BOOT_S:
            self.simulation.step()
            self.simulation.take_frames()
        self.station.be_left_alone()
        self._thin_out()
        if self.scene.fence:
            self.upload(self.scene.fence)
            while not self.station.idle:
                self._step()
        self.simulation.take_truth()
        self.simulation.take_notices()

    def _waits_in_vain(self) -> bool:
        """Whether it has held for so long, with nothing to come, that it will go on holding."""
        if self.brain is None or self.brain.session.state.phase is not Phase.HOLDING or self._due:
            self._held_s = self.now_s
        return self.now_s - self._held_s > _PATIENCE_S

    def _thin_out(self) -> None:
        """Stop the streams of the companion's link that it does not listen to: they cost time."""
        codec = wire.MAVLink(None, srcSystem=SYSTEM, srcComponent=COMPONENT)
        for number in CHATTER:
            stop = wire.MAVLink_command_long_message(1, 1, 511, 0, number, -1, 0, 0, 0, 0, 0)
            self.simulation.receive(COMPANION_LINK, stop.pack(codec))

    def _see_what_is_left(self) -> None:
        self.flown.ended_s = self.now_s
        self.brain = None
        for _ in range(round(_AFTER_S * 100)):
            self._step()

    def _step(self) -> None:
        simulation, now_s = self.simulation, self.now_s
        simulation.step()
        heard: list[bytes] = []
        for link, frame in simulation.take_frames():
            if link == COMPANION_LINK:
                heard.append(frame)
            else:
                self.station.hear(frame)
        brain, now_s = self.brain, self.now_s
        if brain is not None:
            if heard:
                brain.on_data(b"".join(heard), now_s, self.flown)
            else:
                brain.on_time(now_s, self.flown)
            for frame in brain.out_frames:
                self._note_setpoint(frame, now_s)
                simulation.receive(COMPANION_LINK, frame)
            brain.out_frames.clear()
        for frame in self.station.say(now_s):
            simulation.receive(STATION_LINK, frame)
        if simulation.now_us % _SAMPLE_US == 0:
            self._sample(now_s)

    def _happen(self) -> None:
        if self.now_s >= self._restart_s:
            self._restart_s = math.inf
            self.brain = self.new_brain(resume=True)
            self.brain.begin(self.now_s)
        flown, brain = self.flown, self.brain
        if brain is not None and math.isinf(flown.airborne_s):
            if brain.session.state.phase is not Phase.FLYING:
                return
            flown.airborne_s = self.now_s
        while self._due and self.now_s - flown.airborne_s >= self._due[0][0]:
            self._due.pop(0)[1](self)

    def _sample(self, now_s: float) -> None:
        state = self.brain.session.state if self.brain is not None else None
        self.flown.samples.append(
            Sample(
                t_s=now_s,
                phase=state.phase.value if state else "",
                reason=state.reason.text if state and state.reason else "",
                believed_nea_m=state.vehicle.position_nea_m if state else None,
                believed_at_s=state.vehicle.position_at_s if state else -math.inf,
            )
        )

    # --- what goes over the links

    def _note_setpoint(self, frame: bytes, now_s: float) -> None:
        match number_of(frame):
            case processes.SETPOINT:
                _, (latitude, longitude, altitude_m, *velocity) = processes.setpoint_of(frame)
            case 75:  # COMMAND_INT
                *_, lat, lon, altitude_m, command = struct.unpack_from(
                    "<4fiifH", processes.payload(frame, 35)
                )
                if command != _DO_REPOSITION:
                    return
                latitude, longitude, velocity = lat * 1e-7, lon * 1e-7, []
            case _:
                return
        self.flown.sent.append(
            Sent(
                t_s=now_s,
                latitude_deg=latitude,
                longitude_deg=longitude,
                altitude_amsl_m=altitude_m,
                velocity_ned_m_s=(velocity[0], velocity[1], velocity[2]) if velocity else None,
            )
        )

    def upload(self, zones: tuple[Any, ...]) -> None:
        """A ground station uploads this fence."""
        self.station.upload(zones, lambda: self.flown.fences.append((self.now_s, zones)))
