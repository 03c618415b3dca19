"""The terrain radar as a MAVLink component beside the autopilot, on the same radio.

One request is outstanding, as DESIGN 4 has it: a newer one takes the place of one that has not been
looked at yet.  A request is looked at from where the vehicle is at the end of its tick, or at the
radar's next sweep if it has a rate; all wanted blocks follow, and then the report that says that
this was all.
"""

from collections.abc import Sequence
from typing import Any, final

import numpy as np

from vehicle_sim.autopilot.values import Ack, Result, Sender
from vehicle_sim.conditions import RadarConditions
from vehicle_sim.dynamics import Vehicle
from vehicle_sim.sensors.terrain_radar import UNSEEN_M, ScanRequest, TerrainRadar, Viewpoint
from vehicle_sim.wire import messages
from vehicle_sim.wire.frames import Prepared, make
from vehicle_sim.wire.radio import Radio

HEARTBEAT_US = 1_000_000
_LOWEST_M, _HIGHEST_M = -32767, 32767


@final
class RadarComponent:
    """Answers one TERRAIN_REQUEST after the other, in the time of the simulation."""

    def __init__(
        self, radar: TerrainRadar, rng: np.random.Generator, radio: Radio, component_id: int
    ) -> None:
        self._radar, self._rng = radar, rng
        self._radio, self._id = radio, component_id
        self._asked: tuple[Any, int] | None = None
        """The request, and by which link."""
        self._answer: tuple[int, int, Sequence[Prepared]] | None = None
        """When it is due, and by which link."""
        self._sweep_us, self._beat_us = 0, HEARTBEAT_US
        self.due_us = HEARTBEAT_US
        """Nothing is to be done before."""

    def send_heartbeat(self) -> None:
        """Send a heartbeat now."""
        self._radio.broadcast(messages.component_heartbeat(), self._id)

    def receive(self, message: Any, sender: Sender) -> None:
        """Handle a message that is for the radar; commands that name it are refused."""
        kind = message.get_type()
        if kind == "TERRAIN_REQUEST":
            self._asked, self.due_us = (message, sender.link), 0
        elif kind in ("COMMAND_LONG", "COMMAND_INT") and message.target_component == self._id:
            refusal = Ack(to=sender, command=message.command, result=Result.UNSUPPORTED)
            self._radio.send(messages.ack(refusal), sender.link, self._id)

    def step(
        self, now_us: int, vehicle: Vehicle, conditions: RadarConditions, *, tick: bool
    ) -> None:
        """Say what is due; `tick` ends a lockstep tick."""
        if now_us >= self._beat_us:
            self._beat_us += HEARTBEAT_US * (1 + (now_us - self._beat_us) // HEARTBEAT_US)
            if not conditions.silent:
                self.send_heartbeat()
        if conditions.silent:
            self._asked = self._answer = None
        if self._asked and not self._answer and self._looks(now_us, conditions, tick):
            (asked, link), self._asked = self._asked, None
            due_us = now_us + round(conditions.delay_s * 1e6)
            self._answer = due_us, link, self._scan(asked, vehicle, conditions)
        if self._answer and now_us >= self._answer[0]:
            (_, link, replies), self._answer = self._answer, None
            for reply in replies:
                self._radio.send(reply, link, self._id)
        self.due_us = 0 if self._asked or self._answer else self._beat_us

    def _looks(self, now_us: int, conditions: RadarConditions, ends_tick: bool) -> bool:
        """Whether now is the time to look: at the end of a tick, or of a sweep."""
        if not conditions.rate_hz:
            return ends_tick
        if now_us < self._sweep_us:
            return False
        interval_us = max(round(1e6 / conditions.rate_hz), 1)
        self._sweep_us = now_us - now_us % interval_us + interval_us
        return True

    def _scan(self, asked: Any, vehicle: Vehicle, conditions: RadarConditions) -> list[Prepared]:
        """TERRAIN_DATA of all blocks; then TERRAIN_REPORT: nothing is pending, this was all.

        The report counts the blocks that get lost, too.
        """
        radar, height_m = self._radar, vehicle.altitude_amsl_m
        place, spacing_m = (asked.lat / 1e7, asked.lon / 1e7), asked.grid_spacing
        request = ScanRequest(
            latitude_deg=place[0], longitude_deg=place[1], spacing_m=spacing_m, mask=asked.mask
        )
        view = Viewpoint(vehicle.latitude_deg, vehicle.longitude_deg, height_m)
        blocks, head = radar.answer(request, view), (asked.lat, asked.lon, spacing_m)
        heights = [self._spoilt(block.heights_amsl_m, conditions) for block in blocks]
        cells = zip((block.gridbit for block in blocks), heights, strict=True)
        told, count = [make("TERRAIN_DATA", *head, *each) for each in cells], len(blocks)
        if conditions.frames_lost:
            kept = self._rng.random(count) >= conditions.frames_lost
            told = [each for each, keep in zip(told, kept, strict=True) if keep]
        ground_m = radar.height_amsl_m(*place)
        return [*told, make("TERRAIN_REPORT", *head, ground_m, height_m - ground_m, 0, count)]

    def _spoilt(self, heights_amsl_m: Sequence[int], conditions: RadarConditions) -> list[int]:
        """The heights as a radar in this state has them."""
        if not (conditions.blind or conditions.cells_missed or conditions.noise_m):
            return list(heights_amsl_m)
        heights = np.array(heights_amsl_m)
        seen = (heights != UNSEEN_M) & (not conditions.blind)
        if conditions.cells_missed:
            seen &= self._rng.random(len(heights)) >= conditions.cells_missed
        if conditions.noise_m:
            error_m = self._rng.standard_normal(len(heights)) * conditions.noise_m
            if conditions.either_way:
                noisy = np.round(heights + error_m)
            else:
                noisy = np.ceil(heights + np.abs(error_m))
            heights = np.clip(noisy, _LOWEST_M, _HIGHEST_M).astype(np.int64)
        spoilt: list[int] = np.where(seen, heights, UNSEEN_M).tolist()
        return spoilt
