"""The downward rangefinder of the autopilot: whether the ground is nearer than the map says."""

import math
from collections import deque
from collections.abc import Iterator
from typing import Final, final

from companion.mavlink.checks import PATIENCE_S, Check, check
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, Message, wire
from companion.mavlink.poses import Poses
from companion.mission.events import GroundSeen
from companion.mission.mission import Mission
from companion.mission.state import State
from companion.world.known_map import KnownMap

_DISTANCE: Final = wire.MAVLINK_MSG_ID_DISTANCE_SENSOR
_DOWN: Final = wire.MAV_SENSOR_ROTATION_PITCH_270
_AGREE = 4  # readings in a row: one, or two, may be wrong
_KEPT_S = 1.0  # for a reading to find its pose, and to agree with others


@final
class Rangefinder:
    """Compares what it measures with the known map.  Sans-IO; times are those of the vehicle.

    Only within its limits: beyond max_distance autopilots send the true value, 65534 or nothing,
    and what is below min_distance is the vehicle itself (proximity.md 3, 4).
    """

    streams_hz: Final = {**Poses.streams_hz, _DISTANCE: 10.0}

    def __init__(self, mission: Mission, poses: Poses) -> None:
        assert mission.rangefinder_error_m is not None
        self._error_m, self._poses = mission.rangefinder_error_m, poses
        self.reads = poses.reads | {(AUTOPILOT_COMPONENT, _DISTANCE): self.on_message}
        self.heard_s = -math.inf
        """When it last said anything."""
        self._readings: deque[tuple[float, float]] = deque(maxlen=_AGREE)
        """Time and distance, until the pose is known."""
        self._above: deque[tuple[float, float]] = deque(maxlen=_AGREE)
        """Time, and how much higher than on the map the ground was."""
        self._is_told = False

    def on_message(self, message: Message, now_s: float) -> None:
        """DISTANCE_SENSOR of the autopilot."""
        if message.orientation == _DOWN:
            self.heard_s = now_s
            told_cm = message.current_distance
            if max(message.min_distance, 1) <= told_cm < message.max_distance:
                self._readings.append((message.time_boot_ms * 1e-3, told_cm * 0.01))

    def seen(self, now_s: float, known: KnownMap) -> GroundSeen | None:
        """What all of the last few readings say: by how much the ground is nearer, or no more."""
        while self._readings and self._poses.is_over(self._readings[0][0]):
            at_s, distance_m = self._readings.popleft()
            above_m = self._above_map_m(at_s, distance_m, known)
            if above_m is not None:
                self._above.append((at_s, above_m))
        if len(self._above) < _AGREE or not 0.0 <= now_s - self._above[0][0] <= _KEPT_S:
            return None
        least_m, most_m = (pick(above_m for _, above_m in self._above) for pick in (min, max))
        self._above.popleft()  # each reading is looked at once as the newest
        if least_m > self._error_m:
            self._is_told = True
            return GroundSeen(time_s=now_s, above_m=least_m)
        if self._is_told and most_m <= self._error_m:
            self._is_told = False
            return GroundSeen(time_s=now_s, above_m=0.0)
        return None

    def checks(self, state: State, *_: object) -> Iterator[Check]:
        """Whether it is heard."""
        heard = state.now_s - self.heard_s <= PATIENCE_S
        what = f"the one that faces down, of component 1: {'' if heard else 'not '}heard"
        remedy = "Set RNGFND1_TYPE and RNGFND1_ORIENT 25, or leave rangefinder_error_m out."
        yield check("rangefinder", heard, what, remedy)

    def _above_map_m(self, at_s: float, distance_m: float, known: KnownMap) -> float | None:
        """How much higher the foot of the beam is than the map about it; None: not known."""
        pose = self._poses.at(at_s)
        if pose is None:
            return None
        ahead_m, right_m, down_m = pose.level(0.0, 0.0, distance_m)
        row, column = known.cell_of(*pose.beside_ne_m(ahead_m, right_m))
        about = known.upper_m[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
        if not about.size or not math.isfinite(highest_m := float(about.max())):
            return None
        return pose.position_nea_m[2] - down_m - highest_m
