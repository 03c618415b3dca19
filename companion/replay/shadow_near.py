"""What the sensors of near things in a log have seen: a map of it, and what their silence meant."""

import math
from collections import Counter
from typing import Final, final

from companion.geodesy import LocalFrame
from companion.mavlink.autopilots.messages import position
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, COMPANION_COMPONENT, Message, wire
from companion.mavlink.frames import Receiver
from companion.mavlink.near_sensing import HEALTH, SECTORS, NearSensing, Poses, is_sector
from companion.mavlink.near_sensing import MESSAGES as KIND_MESSAGES
from companion.replay.shadow_report import NearThings
from companion.world.near_map import Kind, NearMap, NearSensor, Rules
from companion.world.rays import Lattice

_ATTITUDE: Final = wire.MAVLINK_MSG_ID_ATTITUDE
_POSITION: Final = wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
_KINDS: Final = {number: kind for kind, number in KIND_MESSAGES.items()}
MESSAGES: Final = frozenset({_ATTITUDE, _POSITION, HEALTH, *_KINDS})
"""All that is read here."""
_CELLS_PER_RANGE: Final = 64
_LEAST_CELL_M: Final = 0.25
_REACHES: Final = 4.0  # ranges from the middle of the map to its edge; moved at half of that
_LATENCY_S: Final = 0.04  # measured behind ArduPilot (docs/reference/proximity.md)
_FARTHEST_M: Final = 655.35
_LONGEST_S: Final = 1.0  # between two positions: a longer time is none of any sight


@final
class _Sensor:
    """One sensor that was heard."""

    def __init__(self, name: str, sensor: NearSensor, poses: Poses) -> None:
        self.sensing = NearSensing(sensor, poses)
        self.found = NearThings(sensor=name, range_m=sensor.range_m)
        self.map: NearMap | None = None
        self._reach_m = _REACHES * sensor.range_m
        self._cell_m = max(sensor.range_m / _CELLS_PER_RANGE, _LEAST_CELL_M)
        self._left = Counter[str]()

    def take(self) -> None:
        """Put the sweeps of which the pose is known by now on the map."""
        for sweep in self.sensing.sweeps():
            self.found.sweeps += 1
            north_m, east_m = sweep.sensor_ne_m
            if self.map is None:
                size = 2 * round(self._reach_m / self._cell_m)
                self.map = NearMap.empty(
                    Lattice(
                        cell_m=self._cell_m,
                        north_min_m=north_m - self._reach_m,
                        east_min_m=east_m - self._reach_m,
                        shape=(size, size),
                    ),
                    Rules(),
                )
            lattice = self.map.lattice
            aside_m = max(
                abs(north_m - lattice.north_min_m - self._reach_m),
                abs(east_m - lattice.east_min_m - self._reach_m),
            )
            if aside_m > 0.5 * self._reach_m:
                before, self.map = self.map, self.map.about(sweep.sensor_ne_m)
                self._left += _counts(before)
                self._left -= _counts(self.map)
            self.map.add(sweep)

    def finish(self) -> NearThings:
        """All of it, at the end of the log."""
        cells = self._left + (Counter() if self.map is None else _counts(self.map))
        self.found.free_m2 = cells["free"] * self._cell_m**2
        self.found.occupied_m2 = cells["occupied"] * self._cell_m**2
        self.found.refused = dict(self.sensing.refused)
        return self.found


def _counts(near: NearMap) -> Counter[str]:
    free, occupied = int(near.free().sum()), int(near.occupied().sum())
    return Counter(free=free, occupied=occupied)


@final
class NearWatch:
    """Reads the sensors of one vehicle's near things, each by the kind of its messages.

    What we send ourselves comes back from others, and is left out.
    """

    def __init__(self, frame: LocalFrame, system_id: int, stated: NearSensor | None = None) -> None:
        """stated: by the mission, how the sensor of its kind and component is mounted."""
        self._frame, self._system_id, self._stated = frame, system_id, stated
        self._poses, self._receiver = Poses(), Receiver()
        self.here: tuple[float, tuple[float, float]] = -math.inf, (0.0, 0.0)
        """Vehicle time, and north and east in the local frame, of the newest position."""
        self.sensors: dict[tuple[Kind, int], _Sensor] = {}

    def on_frame(self, frame: bytes, sender: tuple[int, int], number: int) -> None:
        """The next frame of a log, of any sender."""
        system_id, component = sender
        if system_id != self._system_id or component == COMPANION_COMPONENT:
            return
        if component != AUTOPILOT_COMPONENT and (number == SECTORS or number not in _KINDS):
            return
        if not self.sensors and number in (_ATTITUDE, HEALTH):
            return  # most logs are without a sensor
        for message in self._receiver.feed(frame):
            if number == _ATTITUDE:
                at_s = message.time_boot_ms * 1e-3
                self._poses.on_attitude(at_s, message.roll, message.pitch, message.yaw)
            elif number == _POSITION:
                self._on_position(message)
            elif math.isfinite(now_s := self.here[0]):
                self._on_sensor(message, number, component, now_s)
        for sensor in self.sensors.values():
            sensor.take()

    def _on_position(self, message: Message) -> None:
        if (told := position(message, 0.0, self._frame)) is None:
            return
        now_s, (north_m, east_m, _) = told.time_s, told.position_nea_m
        grid_north_rad = self._frame.grid_north_rad(north_m, east_m)
        self._poses.on_position(now_s, told.position_nea_m, grid_north_rad)
        before_s, self.here = self.here[0], (now_s, (north_m, east_m))
        if 0.0 < now_s - before_s < _LONGEST_S:
            for sensor in self.sensors.values():
                sensor.found.seconds[sensor.sensing.sight(now_s).name] += now_s - before_s

    def _on_sensor(self, message: Message, number: int, component: int, now_s: float) -> None:
        if number == HEALTH:
            for sensor in self.sensors.values():
                sensor.sensing.on_message(message, now_s)
        elif number != SECTORS or is_sector(message):
            sensor = self._sensor(_KINDS[number], component, message)
            sensor.sensing.on_message(message, now_s)

    def _sensor(self, kind: Kind, component: int, message: Message) -> _Sensor:
        if (kind, component) not in self.sensors:
            least_m, most_m = 0.01 * message.min_distance, 0.01 * message.max_distance
            mounted = NearSensor(
                kind=kind,
                component_id=component,
                range_m=min(_FARTHEST_M, max(0.01, most_m)),
                blind_m=min(_FARTHEST_M, max(0.0, least_m)),
                latency_s=_LATENCY_S,
            )
            of = self._stated
            if of is not None and (of.kind, of.component_id) == (kind, component):
                mounted = of
            name = f"{message.get_type()} of component {component}"
            self.sensors[kind, component] = _Sensor(name, mounted, self._poses)
        return self.sensors[kind, component]
