"""Where a vehicle was, and how it was turned, at the time of a measurement of the last seconds."""

import bisect
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, final

from companion.geodesy import LocalFrame, Places, wrap_rad
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, Message, wire
from companion.mission.events import Vector

Reads = dict[tuple[int, int], Callable[[Message, float], None]]
"""Component and kind of a message -> what reads it, at vehicle time."""
ATTITUDE: Final = wire.MAVLINK_MSG_ID_ATTITUDE
_KEPT_S = 3.0
_GAP_S = 0.3  # between two positions or attitudes of which a pose is made


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Pose:
    """Where the vehicle was at a time, and how it was turned."""

    position_nea_m: Vector
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    """Clockwise from grid north."""
    grid_north_rad: float
    """True azimuth of grid north there."""
    speed_m_s: float
    """Over ground."""
    yaw_rate_rad_s: float
    """Without a sign."""

    def level(self, ahead: Places, right: Places, down: float) -> tuple[Places, Places, Places]:
        """A direction of the tilted body, or (...) of them: ahead, right and down of its yaw."""
        sin_r, cos_r = math.sin(self.roll_rad), math.cos(self.roll_rad)
        sin_p, cos_p = math.sin(self.pitch_rad), math.cos(self.pitch_rad)
        below = right * sin_r + down * cos_r
        return (
            ahead * cos_p + below * sin_p,
            right * cos_r - down * sin_r,
            below * cos_p - ahead * sin_p,
        )

    def beside_ne_m(self, ahead_m: float, right_m: float) -> tuple[float, float]:
        """North and east of what is so far ahead and to the right, on a level."""
        north_m, east_m, _ = self.position_nea_m
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return north_m + cos * ahead_m - sin * right_m, east_m + sin * ahead_m + cos * right_m


@final
class Poses:
    """The last few seconds of a vehicle's poses, to be asked for at the time of a measurement.

    What needs them reads their messages, and asks for their streams, beside its own.
    """

    streams_hz: Final = {ATTITUDE: 20.0}

    def __init__(self, frame: LocalFrame) -> None:
        self._frame = frame
        self._positions, self._attitudes = _Track(angles=False), _Track(angles=True)
        self.reads: Reads = {(AUTOPILOT_COMPONENT, ATTITUDE): self.on_attitude}

    def on_position(self, time_s: float, position_nea_m: Vector) -> None:
        """A position in the frame."""
        grid_north_rad = self._frame.grid_north_rad(position_nea_m[0], position_nea_m[1])
        self._positions.keep(time_s, (*position_nea_m, grid_north_rad))

    def on_attitude(self, message: Message, _now_s: float = 0.0) -> None:
        """ATTITUDE of the autopilot, whose yaw is from true north."""
        values = message.roll, message.pitch, message.yaw
        self._attitudes.keep(message.time_boot_ms * 1e-3, values)

    def at(self, time_s: float) -> Pose | None:
        """Between those told before and after; None: there are none, or too far apart."""
        position, attitude = self._positions.at(time_s), self._attitudes.at(time_s)
        if position is None or attitude is None:
            return None
        (north, east, altitude, grid_north_rad), velocity = position
        (roll_rad, pitch_rad, yaw_rad), rates = attitude
        return Pose(
            position_nea_m=(north, east, altitude),
            roll_rad=roll_rad,
            pitch_rad=pitch_rad,
            yaw_rad=wrap_rad(yaw_rad - grid_north_rad),
            grid_north_rad=grid_north_rad,
            speed_m_s=math.hypot(velocity[0], velocity[1]),
            yaw_rate_rad_s=abs(rates[2]),
        )

    def is_over(self, time_s: float) -> bool:
        """Whether what is told from now on is of later times."""
        return min(self._positions.newest_s, self._attitudes.newest_s) >= time_s


@final
class _Track:
    """Values over time."""

    def __init__(self, *, angles: bool) -> None:
        self._angles = angles
        self._kept: list[tuple[float, tuple[float, ...]]] = []

    @property
    def newest_s(self) -> float:
        return self._kept[-1][0] if self._kept else -math.inf

    def keep(self, time_s: float, values: tuple[float, ...]) -> None:
        """In order of time: what is overtaken is left out, a clock that fell begins anew."""
        if time_s < self.newest_s - _KEPT_S:
            self._kept.clear()
        if time_s > self.newest_s and all(map(math.isfinite, values)):
            self._kept.append((time_s, values))
            del self._kept[: bisect.bisect_left(self._kept, (time_s - _KEPT_S,))]

    def at(self, time_s: float) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
        """The values at a time, and how fast they changed."""
        after = bisect.bisect_left(self._kept, (time_s,))
        if after == len(self._kept):
            return None
        (before_s, was), (after_s, is_then) = self._kept[max(after - 1, 0)], self._kept[after]
        span_s, since_s = after_s - before_s, time_s - before_s
        if not 0.0 < span_s <= _GAP_S:
            return (is_then, (0.0,) * len(is_then)) if time_s == after_s else None
        steps = [b - a for a, b in zip(was, is_then, strict=True)]
        rates = tuple((wrap_rad(step) if self._angles else step) / span_s for step in steps)
        return tuple(a + since_s * rate for a, rate in zip(was, rates, strict=True)), rates
