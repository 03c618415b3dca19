"""The terrain radar as a MAVLink component: requests in, blocks and reports out, as values.

One request is outstanding, as DESIGN 4 has it: a newer one takes the place of one that has not been
looked at yet.  A request is looked at from where the vehicle is at the end of its tick, or at the
radar's next sweep if it has a rate; all wanted blocks follow, and then the report that says that
this was all.  Nothing here knows bytes: wire/ packs the replies.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from vehicle_sim.dynamics import Vehicle
from vehicle_sim.sensors.terrain_radar import (
    UNSEEN_M,
    ScanBlock,
    ScanRequest,
    TerrainRadar,
    Viewpoint,
)

HEARTBEAT_US = 1_000_000
_LOWEST_M, _HIGHEST_M = -32767, 32767
_NOTHING: tuple["RadarReply", ...] = ()


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class RadarConditions:
    """What is wrong with the radar.  Shares are 0 to 1."""

    silent: bool = False
    """Answers nothing and has no heartbeat."""
    blind: bool = False
    """Answers, and sees nothing."""
    cells_missed: float = 0.0
    """Share of cells in sight that it does not see all the same."""
    frames_lost: float = 0.0
    """Share of TERRAIN_DATA that is never sent."""
    noise_m: float = 0.0
    """Standard deviation of the normal law that each height's error is drawn from.  Positive: its
    size is added and the sum rounded up, so that no cell is told lower than it is, and on average
    0.8 of this too high: what a radar reports whose maker counts errors against it.  Negative: the
    error goes either way, and a cell may be told lower than it is."""
    delay_s: float = 0.0
    rate_hz: float = 0.0
    """Requests answered a second, at the beats of its own sweep; 0: each at the end of its tick."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class TerrainCheck:
    """A TERRAIN_CHECK: asks for the height of one place."""

    latitude_deg: float
    longitude_deg: float


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class RadarBlock:
    """TERRAIN_DATA, to the link that the request came by."""

    request: ScanRequest
    block: ScanBlock
    link: int


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class RadarReport:
    """TERRAIN_REPORT, likewise: nothing is pending."""

    latitude_deg: float
    longitude_deg: float
    spacing_m: int
    """Of the request; of a check 1, or 0 for a place that the radar does not see."""
    ground_amsl_m: float
    above_ground_m: float
    blocks: int
    """How many the radar made of the request, lost ones included."""
    link: int


@final
@dataclass(frozen=True, slots=True)
class RadarBeat:
    """HEARTBEAT of the component, to every link."""


RadarReply = RadarBlock | RadarReport | RadarBeat


@final
class RadarComponent:
    """Answers one request after the other, in the time of the simulation."""

    def __init__(self, radar: TerrainRadar, rng: np.random.Generator) -> None:
        self._radar = radar
        self._rng = rng
        self._asked: tuple[ScanRequest | TerrainCheck, int] | None = None
        """What, and by which link."""
        self._answer: Sequence[RadarReply] = _NOTHING
        self._answer_us = 0
        self._sweep_us = 0
        self._beat_us = HEARTBEAT_US
        self._idle = True

    def ask(self, what: ScanRequest | TerrainCheck, link: int) -> None:
        """A TERRAIN_REQUEST or TERRAIN_CHECK that is for the radar."""
        self._asked = (what, link)
        self._idle = False

    def step(
        self, now_us: int, *, ends_tick: bool, vehicle: Vehicle, conditions: RadarConditions
    ) -> Sequence[RadarReply]:
        """What there is to say now; a step with nothing to do costs two comparisons."""
        if self._idle and now_us < self._beat_us:
            return _NOTHING
        replies = list[RadarReply]()
        if now_us >= self._beat_us:
            self._beat_us += HEARTBEAT_US * (1 + (now_us - self._beat_us) // HEARTBEAT_US)
            if not conditions.silent:
                replies.append(RadarBeat())
        if conditions.silent:
            self._asked, self._answer = None, _NOTHING
        if self._asked is not None and not self._answer:
            self._look(now_us, ends_tick, vehicle, conditions)
        if self._answer and now_us >= self._answer_us:
            replies += self._answer
            self._answer = _NOTHING
        self._idle = self._asked is None and not self._answer
        return replies

    def _look(
        self, now_us: int, ends_tick: bool, vehicle: Vehicle, conditions: RadarConditions
    ) -> None:
        """Answer what was asked if the time has come; the answer waits for the delay."""
        if conditions.rate_hz:
            if now_us < self._sweep_us:
                return
            interval_us = max(round(1e6 / conditions.rate_hz), 1)
            self._sweep_us = now_us - now_us % interval_us + interval_us
        elif not ends_tick:
            return
        assert self._asked is not None
        what, link = self._asked
        self._asked = None
        view = Viewpoint(
            latitude_deg=vehicle.latitude_deg,
            longitude_deg=vehicle.longitude_deg,
            altitude_amsl_m=vehicle.altitude_amsl_m,
        )
        if isinstance(what, TerrainCheck):
            self._answer = [self._checked(what, link, view, conditions)]
        else:
            self._answer = self._scanned(what, link, view, conditions)
        self._answer_us = now_us + round(conditions.delay_s * 1e6)

    def _scanned(
        self, request: ScanRequest, link: int, view: Viewpoint, conditions: RadarConditions
    ) -> Sequence[RadarReply]:
        """All blocks, then the report that says that this was all."""
        blocks = self._radar.answer(request, view)
        replies: list[RadarReply] = [
            RadarBlock(request=request, block=self._spoilt(block, conditions), link=link)
            for block in blocks
        ]
        if conditions.frames_lost:
            kept = self._rng.random(len(replies)) >= conditions.frames_lost
            replies = [reply for reply, keep in zip(replies, kept, strict=True) if keep]
        ground_amsl_m = self._radar.height_amsl_m(request.latitude_deg, request.longitude_deg)
        report = RadarReport(
            latitude_deg=request.latitude_deg,
            longitude_deg=request.longitude_deg,
            spacing_m=request.spacing_m,
            ground_amsl_m=ground_amsl_m,
            above_ground_m=view.altitude_amsl_m - ground_amsl_m,
            blocks=len(blocks),
            link=link,
        )
        return [*replies, report]

    def _checked(
        self, check: TerrainCheck, link: int, view: Viewpoint, conditions: RadarConditions
    ) -> RadarReport:
        """The height of one place, or nothing if the radar does not see it."""
        height = UNSEEN_M
        if self._radar.sees(check.latitude_deg, check.longitude_deg, view):
            height_m = self._radar.height_amsl_m(check.latitude_deg, check.longitude_deg)
            height = min(max(-int(-height_m // 1), _LOWEST_M), _HIGHEST_M)
        block = ScanBlock(gridbit=0, heights_amsl_m=(height,))
        height = self._spoilt(block, conditions).heights_amsl_m[0]
        seen = height != UNSEEN_M
        return RadarReport(
            latitude_deg=check.latitude_deg,
            longitude_deg=check.longitude_deg,
            spacing_m=1 if seen else 0,
            ground_amsl_m=float(height) if seen else 0.0,
            above_ground_m=view.altitude_amsl_m - height if seen else 0.0,
            blocks=0,
            link=link,
        )

    def _spoilt(self, block: ScanBlock, conditions: RadarConditions) -> ScanBlock:
        """The block as a radar in this state has it."""
        if not (conditions.blind or conditions.cells_missed or conditions.noise_m):
            return block
        heights = np.array(block.heights_amsl_m)
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
        return ScanBlock(gridbit=block.gridbit, heights_amsl_m=tuple(heights.tolist()))
