"""What lidars and the like say of near things, as sweeps, and the map of it.

Measured on real autopilots (docs/lab/proximity.md), whose traps decide what is believed here:
the silence of a lidar behind an autopilot means that nothing is in reach, or that it is dead; "max"
does not mean empty; a value is repeated for up to 1.75 s; what we send comes back from others.
"""

import math
from collections import deque
from collections.abc import Callable, Iterator
from typing import Final, NamedTuple, final

import numpy as np

from companion.geodesy import FloatArray
from companion.mavlink.checks import Check, check, remark
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, Message, wire
from companion.mavlink.poses import Pose, Poses
from companion.mission.events import NearSeen, ScanDone, Vector
from companion.mission.mission import Mission
from companion.mission.state import Reason, State
from companion.world.known_map import KnownMap, Window
from companion.world.near_map import NearMap, NearSensor, Sight, Sweep, top_amsl_m

_BODY: Final = (wire.MAV_FRAME_BODY_FRD, wire.MAV_FRAME_BODY_NED)
_NORTH: Final = (wire.MAV_FRAME_GLOBAL, wire.MAV_FRAME_LOCAL_NED)
_UNKNOWN_CM: Final = 65_535
_SECTORS: Final = 8
_HEALTH: Final = wire.MAVLINK_MSG_ID_SYS_STATUS
_SECTOR: Final = wire.MAVLINK_MSG_ID_DISTANCE_SENSOR
_TURN: Final = wire.MAVLINK_MSG_ID_OBSTACLE_DISTANCE
_RATE_HZ: Final = 20.0
_SECTOR_RAD: Final = math.tau / _SECTORS
_HORIZONTAL: Final = range(_SECTORS)  # orientations of DISTANCE_SENSOR, clockwise from the nose
_FIRST_SECTOR_ID: Final = 10  # of ArduPilot's proximity: less are rangefinders, of one beam each
_APART_S = 0.03  # what is nearer in time is one sweep told twice, or a flood
_OTHER_CLOCK_S = 1.0  # a stamp farther from the vehicle's time is none of its clock
_EMPTY_AFTER_S = 1.2  # the longest row of wrong "max" took 0.9 s, the shortest true one 2.9 s
_SILENT_S = 0.6  # several messages at 10 Hz
_SET_S = 0.1  # in which the messages of one stamp come: a stamp may stand still
_SET_MOST = 5000  # messages
_ABOVE_GROUND = 0.8  # of the height: a beam that has come down farther may meet the ground
_HEALTH_S = 2.5  # between two SYS_STATUS, and one of them lost
_EVEN = 1.5  # times the least time between two sets: more, and one is missing (4 % in flights)
_RANGE_ROUNDED_M = 0.0101  # autopilots cut limits off to whole centimetres (proximity.md 2)
_WHOLE_S = 2.5  # in it HEARTBEAT and SYS_STATUS come twice: one fewer sector fits beside them


def _is_sector(message: Message) -> bool:
    """Whether a DISTANCE_SENSOR speaks for one of eight sectors.

    One beam does not: a rangefinder of ArduPilot that looks ahead, or what has a narrow field.
    """
    one_beam = 0.0 < message.horizontal_fov < 0.99 * _SECTOR_RAD
    if message.get_srcComponent() == AUTOPILOT_COMPONENT:
        one_beam |= message.id < _FIRST_SECTOR_ID
    return message.orientation in _HORIZONTAL and not one_beam


class _Look(NamedTuple):
    """What it says of its sectors, before the pose is known."""

    time_s: float
    first_rad: float
    """Where the first sector begins, from the nose or from true north."""
    width_rad: float
    from_nose: bool
    clear_m: FloatArray
    echo_m: FloatArray


@final
class NearSensing:
    """Reads one sensor."""

    def __init__(
        self,
        sensor: NearSensor,
        poses: Poses,
        ground_amsl_m: Callable[[float, float], float] = lambda _north_m, _east_m: -math.inf,
    ) -> None:
        """ground_amsl_m: how high the ground is at a place, north and east, where that is known."""
        self._sensor, self._poses, self._ground_amsl_m = sensor, poses, ground_amsl_m
        who, at = sensor.component_id, AUTOPILOT_COMPONENT
        self.reads, self.streams_hz = poses.reads.copy(), poses.streams_hz.copy()
        match sensor.kind:
            case "obstacle_distance":
                self.reads[who, _TURN] = self.on_obstacle_distance
            case "distance_sensor":
                self.reads[who, _SECTOR] = self.on_distance_sensor
                self.reads[at, _HEALTH] = self.on_health
                if who == at:
                    self.streams_hz[_SECTOR] = _RATE_HZ
        self._looks: deque[_Look] = deque(maxlen=20)
        self._set: list[Message] = []
        """Messages of one stamp,"""
        self._set_s = -math.inf
        """and when the first of them came."""
        self._sectors: set[int] = set()
        """Those of ArduPilot's eight that were ever told."""
        self._whole_s = -math.inf, -math.inf
        """Since when all of these have come, and until when."""
        self._stamp_s, self._period_s = math.inf, math.inf
        """Of the newest set; and the least time between two since one was missing."""
        self._full_since_s = np.empty(0)
        """Since when each sector, as the sensor counts them, has said "max"; inf: it does not."""
        self._limits_cm: dict[int, tuple[float, float]] = {}
        """Least and greatest distance that the newest message of each sector has told of."""
        self._taken_s = -math.inf, -math.inf
        """The stamp of the newest sweep, and when it came."""
        self._heard_s = self._health_s = -math.inf
        self._well = False
        """By its last word, at `_health_s`."""

    @property
    def limits_m(self) -> tuple[float, float]:
        """Least and greatest distance that it measures in all directions; 0 and inf until told."""
        if not self._limits_cm:
            return 0.0, math.inf
        least_cm, most_cm = zip(*self._limits_cm.values(), strict=True)
        return max(least_cm) * 0.01, min(most_cm) * 0.01

    def sight(self, now_s: float) -> Sight:
        """Whether the sensor sees, or what its silence means.

        A clock that fell counts as silence.
        """
        if 0.0 <= now_s - self._heard_s <= _SILENT_S:
            return Sight.SEES
        if self._well and 0.0 <= now_s - self._health_s <= _HEALTH_S:
            return Sight.NOTHING_THERE
        return Sight.NEVER_HEARD if math.isinf(self._heard_s) else Sight.DEAD

    def sweeps(self) -> list[Sweep]:
        """What has been said of times whose pose is known by now, in order."""
        result = []
        while self._looks and self._poses.is_over(self._looks[0].time_s):
            look = self._looks.popleft()
            pose = self._poses.at(look.time_s)
            if pose is not None:
                north, east, altitude = pose.position_nea_m
                height_m = max(altitude - self._ground_amsl_m(north, east), 0.0)
                result.append(_sweep(look, pose, self._sensor, height_m))
        return result

    # --- messages

    def on_obstacle_distance(self, message: Message, now_s: float) -> None:
        """OBSTACLE_DISTANCE of the sensor's component, at vehicle time now_s."""
        width_deg, offset_deg = message.increment_f or message.increment, message.angle_offset
        least, most = message.min_distance, message.max_distance
        is_fit = 0.0 < abs(width_deg) <= 360.0 and math.isfinite(offset_deg) and 0 <= least < most
        if not is_fit or message.frame not in (*_BODY, *_NORTH):
            return
        count = min(len(message.distances), math.floor(360.0 / abs(width_deg) + 1e-6))
        told_cm = np.array(message.distances[:count], dtype=np.float64)
        if width_deg < 0.0:  # counter-clockwise: the last comes first
            told_cm, offset_deg = told_cm[::-1], offset_deg + (count - 1) * width_deg
        if (told_cm != _UNKNOWN_CM).any():  # one that knows nothing at all is blind
            self._heard_s = now_s
        self._limits_cm[0] = least, most
        width_rad = math.radians(abs(width_deg))
        first_rad = math.radians(offset_deg) - 0.5 * width_rad
        limits_cm = float(least), float(most), most + 1.0
        where = first_rad, width_rad, message.frame in _BODY
        self._take(told_cm, limits_cm, where, message.time_usec * 1e-6, now_s)

    def on_distance_sensor(self, message: Message, now_s: float) -> None:
        """One of ArduPilot's eight sectors; those of one stamp belong together."""
        if not _is_sector(message):
            return
        if self._set and (
            message.time_boot_ms != self._set[0].time_boot_ms
            or not 0.0 <= now_s - self._set_s <= _SET_S
            or len(self._set) >= _SET_MOST
        ):
            self._take_sectors()
        if not self._set:
            self._set_s = now_s
        self._set.append(message)
        self._heard_s = now_s

    def _take_sectors(self) -> None:
        """A sector is told from its first echo on: one that never was has none, as at "max".

        But the high sectors may be what a link had no room for (proximity.md 1).  Where that is so
        the cut moves with what else is sent: those behind the last one were left out for it unless
        all that was ever told has come for a while, at even intervals: a cut before the first one
        leaves out the whole set.
        """
        messages = [m for m in self._set if 0 <= m.min_distance < m.max_distance]
        self._set = []
        if not messages:
            return
        for message in messages:
            self._limits_cm[message.orientation] = message.min_distance, message.max_distance
        told_cm = np.full(_SECTORS, float(_UNKNOWN_CM))
        least_cm = np.full(_SECTORS, max(least for least, _ in self._limits_cm.values()))
        most_cm = np.full(_SECTORS, min(most for _, most in self._limits_cm.values()))
        for message in messages:
            told_cm[message.orientation] = message.current_distance
            least_cm[message.orientation] = message.min_distance
            most_cm[message.orientation] = message.max_distance
        sectors = {message.orientation for message in messages}
        stamp_s = messages[0].time_boot_ms * 1e-3
        whole_s = self._whole_for_s(sectors, stamp_s)
        if self._sensor.component_id == AUTOPILOT_COMPONENT:  # of other drivers that is not known
            end = _SECTORS if whole_s >= _WHOLE_S else max(sectors)
            silent = [k for k in range(end) if k not in self._sectors]
            told_cm[silent] = most_cm[silent]
        where = -0.5 * _SECTOR_RAD, _SECTOR_RAD, True
        self._take(told_cm, (least_cm, most_cm, math.inf), where, stamp_s, self._set_s)

    def _whole_for_s(self, sectors: set[int], stamp_s: float) -> float:
        """For how long all sectors that were ever told have come, at even intervals."""
        since_s, until_s = self._whole_s
        is_cut = max(sectors) < max(self._sectors, default=0)
        gap_s, self._stamp_s = stamp_s - self._stamp_s, stamp_s
        is_late = gap_s > _EVEN * self._period_s
        if is_late or 0.0 < gap_s < self._period_s:
            self._period_s = gap_s
        if is_cut or is_late or not 0.0 <= self._set_s - until_s <= _SILENT_S:
            since_s = self._set_s
        if self._set_s < until_s:  # the autopilot has begun anew, and what it has told
            self._sectors.clear()
        self._whole_s = since_s, self._set_s
        self._sectors |= sectors
        return self._set_s - since_s

    def on_health(self, message: Message, now_s: float) -> None:
        """SYS_STATUS of the autopilot that the sensor is connected to.

        While it is well and says nothing, nothing is in its reach: R, or less by its own word.
        """
        was_well = self._well and self._health_s > self._heard_s
        well = message.onboard_control_sensors_enabled & message.onboard_control_sensors_health
        self._health_s, self._well = now_s, bool(well & wire.MAV_SYS_STATUS_SENSOR_PROXIMITY)
        if self._well and was_well and now_s - self._heard_s > _EMPTY_AFTER_S:
            range_m = min(self._sensor.range_m, self.limits_m[1])
            clear_m, nothing = np.full(_SECTORS, range_m), np.full(_SECTORS, np.inf)
            at_s, first_rad = now_s - self._sensor.latency_s, -0.5 * _SECTOR_RAD
            self._looks.append(_Look(at_s, first_rad, _SECTOR_RAD, True, clear_m, nothing))

    # --- what it says

    def _take(
        self,
        cm: FloatArray,
        limits_cm: tuple[FloatArray | float, FloatArray | float, float],
        where: tuple[float, float, bool],
        stamp_s: float,
        now_s: float,
    ) -> None:
        """Distances of sectors: empty where "max" has stood for long enough, or at the last limit.

        limits_cm: least, greatest, and from which on a sector is empty at once.  Any other value
        outside says nothing.  where: as in `_Look`.  A stamp of another clock counts as now; one
        that stands still is taken all the same.
        """
        least_cm, most_cm, empty_cm = limits_cm
        if abs(stamp_s - now_s) > _OTHER_CLOCK_S:
            stamp_s = now_s
        before_s, came_s = self._taken_s
        if 0.0 <= stamp_s - before_s < _APART_S and 0.0 <= now_s - came_s < _SET_S:
            return
        self._taken_s = stamp_s, now_s
        time_s = stamp_s - self._sensor.latency_s
        beyond = (cm >= empty_cm) & (cm != _UNKNOWN_CM)
        full = (cm == most_cm) | beyond
        if len(self._full_since_s) != len(full):
            self._full_since_s = np.full(len(full), np.inf)
        since_s = np.where(full, np.minimum(self._full_since_s, time_s), np.inf)
        self._full_since_s = since_s
        empty = full & (time_s - since_s >= _EMPTY_AFTER_S) | beyond
        met = (cm >= np.maximum(least_cm, 1.0)) & (cm < most_cm)
        range_m = np.minimum(np.multiply(most_cm, 0.01), self._sensor.range_m)
        echo_m = np.where(met, cm * 0.01, np.inf)
        clear_m = np.where(met, echo_m, np.where(empty, range_m, 0.0))
        self._looks.append(_Look(time_s, *where, clear_m, echo_m))


def _sweep(look: _Look, pose: Pose, sensor: NearSensor, height_m: float) -> Sweep:
    """In the local frame.  The tilt of the vehicle shortens distances and turns bearings a little.

    What a tilted beam says beyond where it leaves the slab that it speaks for is left out.
    """
    count = len(look.clear_m)
    turn_rad = pose.yaw_rad + sensor.yaw_rad if look.from_nose else -pose.grid_north_rad
    along = look.first_rad + (np.arange(count) + 0.5) * look.width_rad + turn_rad - pose.yaw_rad
    ahead, aside, down = pose.level(np.cos(along), np.sin(along), 0.0)
    level = np.hypot(ahead, aside)
    bent = np.abs(np.mod(np.arctan2(aside, ahead) - along + math.pi, math.tau) - math.pi)
    below_m = min(sensor.speaks_for_m, _ABOVE_GROUND * height_m)
    depth_m = np.where(down > 0.0, below_m, sensor.speaks_for_m)
    stays_m = depth_m / np.maximum(np.abs(down), 1e-9) * level
    echo_m = look.echo_m * level
    return Sweep(
        time_s=look.time_s,
        sensor_ne_m=pose.beside_ne_m(sensor.forward_m, sensor.right_m),
        first_rad=look.first_rad + turn_rad,
        width_rad=look.width_rad,
        clear_m=np.minimum(look.clear_m * level, stays_m),
        echo_m=np.where(echo_m <= stays_m, echo_m, np.inf),
        range_m=sensor.range_m,
        blind_m=sensor.blind_m,
        error_m=sensor.error_m(pose.speed_m_s),
        bearing_error_rad=sensor.bearing_error_rad
        + sensor.latency_error_s * pose.yaw_rate_rad_s
        + float(bent.max(initial=0.0)),
    )


# --- the map of all that it has seen


@final
class NearScanner:
    """The scanner of a mission that looks about with a lidar: one sensor, and its map.

    Its sweeps come by themselves.  What it has seen becomes part of the known map when the mission
    asks for a scan; in between, the mission is told of every sweep, as something may be in its way.
    """

    def __init__(self, mission: Mission, poses: Poses) -> None:
        """Its map says where the cells are, and as a guess how high the ground is proven to be."""
        sensor, blank = mission.near, mission.known
        assert sensor is not None
        assert blank is not None
        assert blank.guess_m is not None
        self._sensor, self.sensing = sensor, NearSensing(sensor, poses, self._ground_at_m)
        self.reads, self.streams_hz = self.sensing.reads, self.sensing.streams_hz
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

    def seen(self, now_s: float, _known: KnownMap) -> NearSeen | None:
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

    def checks(self, state: State, _scan: ScanDone | None, heard: str) -> Iterator[Check]:
        """Whether it sees, and as far as the mission says."""
        sensor, sight = self._sensor, state.vehicle.sight
        what = f"{sensor.kind.upper()} of component {sensor.component_id}: {sight.value}"
        what += f"; heard: {heard}" if sight.is_blind else ""
        yield check("sensor", not sight.is_blind, what, Reason.SENSOR_SILENT.remedy)
        (least_m, most_m), range_m = self.sensing.limits_m, sensor.range_m
        if math.isinf(most_m):
            what = f"it has not told how far it sees: R = {range_m:g} m is believed"
            yield remark("sensor range", what, "Show it something within its reach.")
            return
        what = f"it sees {most_m:g} m, and planner.scan_range_m is {range_m:g} m"
        remedy = f"Set planner.scan_range_m to {most_m:g} or less, or use one that sees farther."
        yield check("sensor range", most_m >= range_m - _RANGE_ROUNDED_M, what, remedy)
        if least_m > sensor.blind_m + _RANGE_ROUNDED_M:
            what = f"it sees nothing nearer than {least_m:g} m, and scanner.blind_m is less"
            yield remark("sensor range", what, f"Raise scanner.blind_m to {least_m:g}.")

    # --- scans

    def begin(self, _centre_nea_m: Vector, state: State, now_s: float) -> int:
        """A scan: the next sweep ends it, as the one block that is asked for."""
        if self._scanned is not None and state.flight.known is self._before:
            self._near.tell_again(self._scanned)  # nobody has taken it
        self._before, self._scanned = state.flight.known, None
        self._began_s = now_s
        return 1

    def go_on(self, now_s: float, _here_nea_m: Vector | None) -> ScanDone | None:
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
