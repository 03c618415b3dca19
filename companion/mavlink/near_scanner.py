"""The scanner of a mission that looks about with a lidar: keeps the map of near things.

Its sweeps come by themselves.  What it has seen becomes part of the known map when the mission asks
for a scan; in between, the mission is told of every sweep, as something may be in its way.
"""

import math
from typing import Final, final

from companion.mavlink import rangefinder
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, Message, wire
from companion.mavlink.near_sensing import HEALTH, MESSAGES, SECTORS, NearSensing
from companion.mavlink.poses import Poses
from companion.mission.events import NearSeen, ScanDone, Vector
from companion.mission.mission import Mission
from companion.mission.state import State
from companion.world.known_map import KnownMap, Window
from companion.world.near_map import NearMap, Sight, top_amsl_m

ATTITUDE: Final = wire.MAVLINK_MSG_ID_ATTITUDE
OF_AUTOPILOT: Final = (HEALTH, *MESSAGES.values())
_RATE_HZ: Final = 20.0


def messages_of(mission: Mission) -> frozenset[int]:
    """What is read of the autopilot and of the sensor, for all that the mission reads."""
    sensor = () if mission.near is None else (MESSAGES[mission.near.kind],)
    return frozenset({*streams_hz(mission), *sensor})


def streams_hz(mission: Mission) -> dict[int, float]:
    """What the autopilot has to send for all sensors that the mission reads, and how often."""
    sensor, wanted = mission.near, dict[int, float]()
    if mission.rangefinder_error_m is not None:
        wanted = {ATTITUDE: _RATE_HZ, SECTORS: rangefinder.RATE_HZ}
    if sensor is not None:
        wanted[ATTITUDE] = _RATE_HZ
        if (sensor.kind, sensor.component_id) == ("distance_sensor", AUTOPILOT_COMPONENT):
            wanted[SECTORS] = _RATE_HZ
    return wanted


@final
class NearScanner:
    """One sensor and its map.  Sans-IO; times are those of the vehicle."""

    def __init__(self, mission: Mission, poses: Poses) -> None:
        """Its map says where the cells are, and as a guess how high the ground is proven to be."""
        sensor, blank = mission.near, mission.known
        assert sensor is not None
        assert blank is not None
        assert blank.guess_m is not None
        self._component = sensor.component_id
        self.sensing = NearSensing(sensor, poses, self._ground_at_m)
        free_for_s = sensor.free_for_s(mission.task.limits.navigation_error_m)
        self._near = NearMap(blank.bare(), free_for_s)
        self._known, self._ground_m = blank, blank.guess_m
        limits, settings = mission.task.limits, mission.task.settings
        self._top_m = top_amsl_m(limits.ceiling_amsl_m, settings.scan_range_m)
        self._scan_time_s = settings.scan_time_s
        self._began_s = self._swept_s = -math.inf
        self._scanned: Window | None = None
        """What the last scan has told."""
        self._before: KnownMap | None = None
        """The map of the mission before it."""
        self._sight = Sight.NEVER_HEARD

    def _ground_at_m(self, north_m: float, east_m: float) -> float:
        row, column = self._known.cell_of(north_m, east_m)
        rows, columns = self._ground_m.shape
        return float(self._ground_m[min(max(row, 0), rows - 1), min(max(column, 0), columns - 1)])

    # --- what is heard

    def on_message(self, message: Message, now_s: float) -> None:
        """A message of the sensor, or SYS_STATUS of the autopilot."""
        if message.get_msgId() == HEALTH or message.get_srcComponent() == self._component:
            self.sensing.on_message(message, now_s)

    def seen(self, now_s: float) -> NearSeen | None:
        """What is new: sweeps, or what the silence means; None: nothing."""
        sweeps, sight = self.sensing.sweeps(), self.sensing.sight(now_s)
        for sweep in sweeps:
            self._near.add(sweep)
            self._swept_s = now_s
        if not sweeps and sight is self._sight:
            return None
        self._sight = sight
        _, sees_m = self.sensing.limits_m
        return NearSeen(time_s=now_s, sight=sight, near=self._near, sees_m=sees_m)

    # --- scans

    asked = 1
    """Blocks of a scan."""

    def begun(self, _centre_nea_m: Vector, state: State, now_s: float) -> "NearScanner":
        """A scan: the next sweep ends it."""
        if self._scanned is not None and state.flight.known is self._before:
            self._near.tell_again(self._scanned)  # nobody has taken it
        self._before, self._scanned = state.flight.known, None
        self._began_s = now_s
        return self

    def on_time(self, _now_s: float) -> None:
        """Nothing has to be asked for."""

    def done(self, now_s: float) -> ScanDone | None:
        """The scan, once it is over: with the next sweep, or without any in time.

        A sensor that is well and silent has answered: what it saw before is all that there is.
        """
        self._near.expire(now_s)
        swept = self._swept_s > self._began_s
        if not (swept or now_s - self._began_s >= self._scan_time_s):
            return None
        answered = swept or not self._sight.is_blind
        self._scanned = self._near.changed
        scan = self._near.scan(self._ground_m, self._top_m)
        return ScanDone(time_s=now_s, scan=scan, asked=1, answered=int(answered))
