"""The terrain radar as a MAVLink component beside the autopilot, on the same radio.

One request is outstanding, as DESIGN 4 has it: a newer one takes the place of one that has not been
looked at yet.  A request is looked at from where the vehicle is at the end of its tick, or at the
radar's next sweep if it has a rate; all wanted blocks follow, and then the report that says that
this was all.
"""

from collections.abc import Sequence
from typing import Any, final

import numpy as np

from vehicle_sim.autopilots import Ack, Result, Sender
from vehicle_sim.conditions import RadarConditions
from vehicle_sim.dynamics import Vehicle
from vehicle_sim.sensors.terrain_radar import (
    UNSEEN_M,
    ScanRequest,
    TerrainRadar,
    Viewpoint,
)
from vehicle_sim.wire import messages
from vehicle_sim.wire.frames import Prepared, make
from vehicle_sim.wire.radio import Radio

HEARTBEAT_US = 1_000_000
_LOWEST_M, _HIGHEST_M = -32767, 32767


@final
class RadarComponent:
    """Answers one request after the other, in the time of the simulation."""

    def __init__(
        self, radar: TerrainRadar, rng: np.random.Generator, radio: Radio, component_id: int
    ) -> None:
        self._radar, self._rng = radar, rng
        self._radio, self._id = radio, component_id
        self._asked: tuple[Any, int] | None = None
        """TERRAIN_REQUEST or TERRAIN_CHECK, and by which link."""
        self._answer: tuple[Sequence[Any], int] | None = None
        self._answer_us = 0
        self._sweep_us = 0
        self._beat_us = HEARTBEAT_US
        self.due_us = HEARTBEAT_US
        """Nothing is to be done before."""

    def send_heartbeat(self) -> None:
        """Send a heartbeat now."""
        self._radio.broadcast(messages.component_heartbeat(), self._id)

    def receive(self, message: Any, sender: Sender) -> None:
        """Handle a message that is for the radar; commands that name it are refused."""
        match message.get_type():
            case "TERRAIN_REQUEST" | "TERRAIN_CHECK":
                self._asked, self.due_us = (message, sender.link), 0
            case "COMMAND_LONG" | "COMMAND_INT" if message.target_component == self._id:
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
        if (
            self._asked is not None
            and self._answer is None
            and self._looks(now_us, conditions, tick)
        ):
            (asked, link), self._asked = self._asked, None
            view = Viewpoint(vehicle.latitude_deg, vehicle.longitude_deg, vehicle.altitude_amsl_m)
            see = self._scanned if asked.get_type() == "TERRAIN_REQUEST" else self._checked
            self._answer = see(asked, view, conditions), link
            self._answer_us = now_us + round(conditions.delay_s * 1e6)
        if self._answer is not None and now_us >= self._answer_us:
            (replies, link), self._answer = self._answer, None
            for reply in replies:
                self._radio.send(reply, link, self._id)
        idle = self._asked is None and self._answer is None
        self.due_us = self._beat_us if idle else 0

    def _looks(self, now_us: int, conditions: RadarConditions, ends_tick: bool) -> bool:
        """Whether now is the time to look: at the end of a tick, or of a sweep."""
        if not conditions.rate_hz:
            return ends_tick
        if now_us < self._sweep_us:
            return False
        interval_us = max(round(1e6 / conditions.rate_hz), 1)
        self._sweep_us = now_us - now_us % interval_us + interval_us
        return True

    def _scanned(self, asked: Any, view: Viewpoint, conditions: RadarConditions) -> list[Prepared]:
        """TERRAIN_DATA of all blocks, then the report that says that this was all."""
        request = ScanRequest(
            latitude_deg=asked.lat / 1e7,
            longitude_deg=asked.lon / 1e7,
            spacing_m=asked.grid_spacing,
            mask=asked.mask,
        )
        head = (asked.lat, asked.lon, asked.grid_spacing)
        replies = [
            make(
                "TERRAIN_DATA", *head, block.gridbit, self._spoilt(block.heights_amsl_m, conditions)
            )
            for block in self._radar.answer(request, view)
        ]
        count = len(replies)
        if conditions.frames_lost:
            kept = self._rng.random(count) >= conditions.frames_lost
            replies = [reply for reply, keep in zip(replies, kept, strict=True) if keep]
        ground_amsl_m = self._radar.height_amsl_m(request.latitude_deg, request.longitude_deg)
        return [*replies, _report(asked, request.spacing_m, ground_amsl_m, view, count)]

    def _checked(self, asked: Any, view: Viewpoint, conditions: RadarConditions) -> list[Prepared]:
        """The height of one place, with a spacing of 0 if the radar does not see it."""
        place = asked.lat / 1e7, asked.lon / 1e7
        height = UNSEEN_M
        if self._radar.sees(*place, view):
            height_m = self._radar.height_amsl_m(*place)
            height = min(max(-int(-height_m // 1), _LOWEST_M), _HIGHEST_M)
        (height,) = self._spoilt((height,), conditions)
        if height == UNSEEN_M:
            return [make("TERRAIN_REPORT", asked.lat, asked.lon)]
        return [_report(asked, 1, float(height), view, 0)]

    def _spoilt(self, heights_amsl_m: Sequence[int], conditions: RadarConditions) -> list[int]:
        """The heights as a radar in this state has them."""
        if not (conditions.blind or conditions.cells_missed or conditions.noise_m):
            return list(heights_amsl_m)
        heights = np.array(heights_amsl_m)
        seen = heights != UNSEEN_M
        if conditions.blind:
            seen[:] = False
        if conditions.cells_missed:
            seen &= self._rng.random(len(heights)) >= conditions.cells_missed
        if conditions.noise_m:
            error_m = self._rng.standard_normal(len(heights)) * conditions.noise_m
            if conditions.noise_m > 0.0:
                noisy = np.ceil(heights + np.abs(error_m))
            else:
                noisy = np.round(heights + error_m)
            heights = np.clip(noisy, _LOWEST_M, _HIGHEST_M).astype(np.int64)
        heights[~seen] = UNSEEN_M
        spoilt: list[int] = heights.tolist()
        return spoilt


def _report(
    asked: Any, spacing_m: int, ground_amsl_m: float, view: Viewpoint, blocks: int
) -> Prepared:
    """TERRAIN_REPORT: nothing is pending; lost blocks are counted too."""
    heights_m = (ground_amsl_m, view.altitude_amsl_m - ground_amsl_m)
    return make("TERRAIN_REPORT", asked.lat, asked.lon, spacing_m, *heights_m, 0, blocks)
