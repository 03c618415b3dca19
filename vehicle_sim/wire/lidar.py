"""The lidar's driver: a MAVLink component beside the autopilot that sends OBSTACLE_DISTANCE.

As MAVLink has it: element 0 lies at angle_offset from the nose, the others clockwise from there;
max_distance + 1 is "nothing there", 65535 is "not known"; time_usec is the middle of the sweep, in
the autopilot's clock.
"""

import math
from collections import deque
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as mavlink

from vehicle_sim.conditions import LidarConditions
from vehicle_sim.sensors.lidar import Lidar
from vehicle_sim.wire import messages
from vehicle_sim.wire.radio import Radio
from vehicle_sim.world import LidarTable

_UNKNOWN: Final = 65535
_ELEMENTS: Final = 72
_HEARTBEAT_US: Final = 1_000_000


@final
class LidarDriver:
    """Sends what a lidar measures, in the time of the simulation."""

    def __init__(
        self, lidar: Lidar, settings: LidarTable, rng: np.random.Generator, radio: Radio
    ) -> None:
        self._lidar, self._settings, self._rng, self._radio = lidar, settings, rng, radio
        offset_deg, width_deg = settings.angle_offset_deg, settings.increment_deg
        if offset_deg is None and settings.width_deg < 360.0:
            offset_deg = settings.yaw_deg + 0.5 * (width_deg - settings.width_deg)
        self._offset_deg = offset_deg = offset_deg or 0.0
        self._count = min(round(settings.width_deg / width_deg), _ELEMENTS)
        off_edge_deg = np.degrees(lidar.angles_rad) - offset_deg + 0.5 * width_deg
        self._element = np.floor(np.remainder(off_edge_deg + 1e-9, 360.0) / width_deg).astype(int)
        self._waiting = deque[tuple[int, Any]]()
        self._due_us, self._beat_us = 0, _HEARTBEAT_US

    def send_heartbeat(self) -> None:
        """Send a heartbeat now."""
        self._radio.broadcast(messages.component_heartbeat(), self._settings.component_id)

    def step(self, now_us: int, boot_us: int, conditions: LidarConditions) -> list[Any]:
        """Send what is due; returns the messages that the autopilot hears."""
        if now_us >= self._beat_us:
            self._beat_us = now_us + _HEARTBEAT_US
            if not conditions.silent:
                self.send_heartbeat()
        interval_us = round(1e6 / (conditions.rate_hz or self._settings.rate_hz))
        self._due_us = max(self._due_us, now_us - interval_us)  # none to make up for
        while self._due_us <= now_us:
            self._due_us += interval_us
            if not (conditions.dead or conditions.silent):
                late_us = self._lidar.middle_us + round(self._settings.latency_s * 1e6)
                message = self._message(self._lidar.middle_us - boot_us, conditions)
                self._waiting.append((max(late_us, now_us), message))
        heard = []
        while self._waiting and self._waiting[0][0] <= now_us:
            message = self._waiting.popleft()[1]
            if not conditions.frames_lost or self._rng.random() >= conditions.frames_lost:
                self._radio.broadcast(message, self._settings.component_id)
                heard.append(message)
        return heard

    def _message(self, measured_us: int, wrong: LidarConditions) -> Any:
        settings, rng = self._settings, self._rng
        least_cm, most_cm = round(settings.min_m * 100.0), round(settings.range_m * 100.0)
        increment_deg, offset_deg = settings.increment_deg, self._offset_deg
        told_cm = self._told_cm(most_cm)
        if wrong.junk:
            spoilt = rng.random(len(told_cm)) < wrong.junk
            values = np.array([0, 1, most_cm + 2, _UNKNOWN - 1, _UNKNOWN])
            told_cm[spoilt] = values[rng.integers(len(values), size=int(spoilt.sum()))]
            if rng.random() < wrong.junk:
                pairs = ((math.nan, offset_deg), (increment_deg, math.nan))
                increment_deg, offset_deg = pairs[rng.integers(2)]
        stamp_us, most_us = measured_us + wrong.clock_us, wrong.clock_jump_us
        stamp_us += int(rng.integers(-most_us, most_us + 1)) if most_us else 0
        return mavlink.MAVLink_obstacle_distance_message(
            *(max(stamp_us, 0), mavlink.MAV_DISTANCE_SENSOR_LASER, told_cm.tolist()),
            *(int(settings.increment_deg), least_cm, most_cm),
            *(increment_deg, offset_deg, wrong.frame),
        )

    def _told_cm(self, most_cm: int) -> NDArray[np.int64]:
        """The nearest echo of each element, "nothing there" or "not known".  -> (72,)."""
        nearest_m = np.full(_ELEMENTS, np.inf)
        known = np.zeros(_ELEMENTS, dtype=bool)
        use = ~np.isnan(self._lidar.distances_m) & (self._element < self._count)
        np.minimum.at(nearest_m, self._element[use], self._lidar.distances_m[use])
        known[self._element[use]] = True
        cm = np.where(np.isfinite(nearest_m), np.round(nearest_m * 100.0), most_cm + 1.0)
        return np.where(known, cm, _UNKNOWN).astype(np.int64)
