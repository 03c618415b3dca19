"""Components beside the autopilot, on the same radio: the terrain radar and the lidar's driver.

Of the radar one request is outstanding: a newer one takes the place of one that has not been looked
at yet.  A request is looked at from where the vehicle is at the end of its tick, or at the radar's
next sweep if it has a rate; all wanted blocks follow, and then the report that this was all.

The lidar's driver sends OBSTACLE_DISTANCE as MAVLink has it: element 0 lies at the nose, the others
clockwise from there; max_distance + 1 is "nothing there", 65535 is "not known"; time_usec is the
middle of the sweep, in the autopilot's clock.
"""

from collections import deque
from collections.abc import Iterable, Sequence
from typing import Any, Final, final

import numpy as np
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.autopilot.values import Sender
from vehicle_sim.dynamics import Vehicle
from vehicle_sim.faults import LidarConditions, RadarConditions
from vehicle_sim.geodesy import LocalFrame
from vehicle_sim.sensors.lidar import Lidar
from vehicle_sim.sensors.terrain_radar import UNSEEN_M, TerrainRadar
from vehicle_sim.wire.frames import Prepared, make
from vehicle_sim.wire.radio import Radio
from vehicle_sim.world import LidarTable

Links = tuple[int, ...]
HEARTBEAT_US: Final = 1_000_000
_UNKNOWN, _HIGHEST_M = 65535, 32767
_ELEMENTS: Final = 72
_WIDTH_DEG: Final = 360.0 / _ELEMENTS
_BEAT: Final = make("HEARTBEAT", mavlink.MAV_TYPE_ONBOARD_CONTROLLER, 8, 0, 0, 4, 3)
"""Of an active component that is no autopilot."""


class _Component:
    """One with its own ids and heartbeat."""

    def __init__(self, radio: Radio, component_id: int) -> None:
        self._radio, self._id = radio, component_id
        self._beat_us = HEARTBEAT_US

    def send_heartbeat(self) -> None:
        """Send a heartbeat now."""
        self._send(_BEAT)

    def _send(self, message: Prepared, links: Iterable[int] | None = None) -> None:
        self._radio.send(message, links, (self._radio.router.ids[0], self._id))

    def _beat(self, now_us: int, *, silent: bool) -> None:
        if now_us >= self._beat_us:
            self._beat_us = now_us + HEARTBEAT_US
            if not silent:
                self.send_heartbeat()


@final
class RadarComponent(_Component):
    """Answers one TERRAIN_REQUEST after the other, in the time of the simulation."""

    def __init__(
        self, radar: TerrainRadar, rng: np.random.Generator, radio: Radio, component_id: int
    ) -> None:
        super().__init__(radio, component_id)
        self.radar, self._rng = radar, rng
        self._asked: tuple[Any, Links] | None = None
        """The request."""
        self._answer: tuple[int, Links, Sequence[Prepared]] | None = None
        """When it is due."""
        self._sweep_us, self.due_us = 0, HEARTBEAT_US
        """When it looks again, if it has a rate; and nothing is to be done before."""

    def receive(self, message: Any, sender: Sender) -> None:
        """Handle a message that is for the radar."""
        if message.get_type() == "TERRAIN_REQUEST":
            self._asked, self.due_us = (message, (sender.link,)), 0

    def step(
        self, now_us: int, vehicle: Vehicle, conditions: RadarConditions, *, tick: bool
    ) -> None:
        """Say what is due; `tick` ends a lockstep tick."""
        self._beat(now_us, silent=conditions.silent)
        if conditions.silent:
            self._asked = self._answer = None
        if self._asked and not self._answer and self._looks(now_us, conditions, tick):
            (asked, links), self._asked = self._asked, None
            due_us = now_us + round(conditions.delay_s * 1e6)
            self._answer = due_us, links, self._scan(asked, vehicle, conditions)
        if self._answer and now_us >= self._answer[0]:
            (_, links, replies), self._answer = self._answer, None
            for reply in replies:
                self._send(reply, links)
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
        radar, height_m = self.radar, vehicle.altitude_amsl_m
        place, spacing_m = (asked.lat / 1e7, asked.lon / 1e7), asked.grid_spacing
        corner = LocalFrame(latitude_deg=place[0], longitude_deg=place[1])
        blocks = radar.answer(corner, spacing_m, asked.mask, vehicle)
        head = (asked.lat, asked.lon, spacing_m)
        answers = [
            make("TERRAIN_DATA", *head, bit, self._spoilt(heights_m, conditions))
            for bit, heights_m in blocks.items()
        ]
        if conditions.frames_lost:
            kept = self._rng.random(len(blocks)) >= conditions.frames_lost
            answers = [answer for answer, keep in zip(answers, kept, strict=True) if keep]
        ground_m = radar.height_amsl_m(*place)
        report = make("TERRAIN_REPORT", *head, ground_m, height_m - ground_m, 0, len(blocks))
        return [*answers, report]

    def _spoilt(self, heights_amsl_m: list[int], conditions: RadarConditions) -> list[int]:
        """The heights as a radar in this state has them."""
        if not (conditions.blind or conditions.cells_missed or conditions.noise_m):
            return heights_amsl_m
        heights = np.array(heights_amsl_m)
        seen = (heights != UNSEEN_M) & (not conditions.blind)
        if conditions.cells_missed:
            seen &= self._rng.random(len(heights)) >= conditions.cells_missed
        if conditions.noise_m:
            error_m = self._rng.standard_normal(len(heights)) * conditions.noise_m
            noisy = np.ceil(heights + np.abs(error_m))
            noisy = np.round(heights + error_m) if conditions.either_way else noisy
            heights = np.clip(noisy, -_HIGHEST_M, _HIGHEST_M)
        spoilt: list[int] = np.where(seen, heights, UNSEEN_M).astype(np.int64).tolist()
        return spoilt


@final
class LidarDriver(_Component):
    """Sends what a lidar measures, in the time of the simulation."""

    def __init__(
        self, lidar: Lidar, settings: LidarTable, rng: np.random.Generator, radio: Radio
    ) -> None:
        super().__init__(radio, settings.component_id)
        self._lidar, self._settings, self._rng = lidar, settings, rng
        off_edge_deg = np.degrees(lidar.angles_rad) + 0.5 * _WIDTH_DEG
        self._element = np.floor(np.remainder(off_edge_deg + 1e-9, 360.0) / _WIDTH_DEG).astype(int)
        self._waiting = deque[tuple[int, Prepared]]()
        self._due_us = 0

    def step(self, now_us: int, boot_us: int, conditions: LidarConditions) -> None:
        """Send what is due."""
        self._beat(now_us, silent=conditions.silent)
        interval_us = round(1e6 / (conditions.rate_hz or self._settings.rate_hz))
        self._due_us = max(self._due_us, now_us - interval_us)  # none to make up for
        while self._due_us <= now_us:
            self._due_us += interval_us
            if not (conditions.dead or conditions.silent):
                late_us = self._lidar.middle_us + round(self._settings.latency_s * 1e6)
                stamp_us = self._lidar.middle_us - boot_us + conditions.clock_us
                self._waiting.append((max(late_us, now_us), self._message(stamp_us)))
        while self._waiting and self._waiting[0][0] <= now_us:
            message = self._waiting.popleft()[1]
            if not conditions.frames_lost or self._rng.random() >= conditions.frames_lost:
                self._send(message)

    def _message(self, stamp_us: int) -> Prepared:
        """The nearest echo of each element, "nothing there" or "not known"."""
        limits_m = self._settings.min_m, self._settings.range_m
        least_cm, most_cm = (round(limit_m * 100.0) for limit_m in limits_m)
        nearest_cm = np.full(_ELEMENTS, np.nan)
        np.fmin.at(nearest_cm, self._element, self._lidar.distances_m * 100.0)
        told_cm = np.minimum(np.round(nearest_cm), most_cm + 1.0)
        told_cm[np.isnan(nearest_cm)] = _UNKNOWN
        what = (max(stamp_us, 0), mavlink.MAV_DISTANCE_SENSOR_LASER, told_cm.astype(int).tolist())
        scale = (int(_WIDTH_DEG), least_cm, most_cm, _WIDTH_DEG, 0.0, mavlink.MAV_FRAME_BODY_FRD)
        return make("OBSTACLE_DISTANCE", *what, *scale)
