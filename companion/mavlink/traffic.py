"""Others in the air, from the messages on the link, and the claims of our own vehicles.

ADSB_VEHICLE of any sender, GLOBAL_POSITION_INT of other systems' autopilots, and claims:
POSITION_TARGET_GLOBAL_INT of component 195 of other systems (docs/decisions/0023).  Bounded: so
many tracks, each so often; what is refused or too much is counted, and told once.
"""

import math
from typing import Final, final

import numpy as np

from companion.geodesy import rotate
from companion.mavlink.autopilots.messages import POSITION_VELOCITY, aim, place_of, position
from companion.mavlink.dialect import AUTOPILOT_COMPONENT, COMPANION_COMPONENT, Message, wire
from companion.mavlink.frames import Incoming
from companion.mission import events
from companion.mission.events import OthersHeard, Setpoint, Vector
from companion.mission.mission import Mission
from companion.world.traffic import CLAIM_FORGOTTEN_S, FORGOTTEN_S, Claim, Track

_ADSB: Final = wire.MAVLINK_MSG_ID_ADSB_VEHICLE
_POSITION: Final = wire.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
_CLAIM: Final = wire.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT
_HEARTBEAT: Final = wire.MAVLINK_MSG_ID_HEARTBEAT
MESSAGES: Final = frozenset({_ADSB, _POSITION, _CLAIM, _HEARTBEAT})
_MOST: Final = 64
_MOST_BETWEEN: Final = 16 * _MOST  # between two positions of our own
_PERIOD_S = 0.05  # between two reports of one aircraft that are read
_SPAN_S = 10.0  # a claim is sent as the velocity that covers it in this time
_LONGEST_M = 5000.0
_FASTEST_M_S = 350.0
_UNKNOWN_M_S = 100.0
"""What an aircraft may fly that does not say how fast it is."""
_HEIGHTS_M = -500.0, 30_000.0
_ADSB_ERROR_M, _SYSTEM_ERROR_M, _SYSTEM_ERROR_UP_M = 50.0, 5.0, 10.0
_PRESSURE_ERROR_M, _GEOMETRIC_ERROR_M = 300.0, 120.0
_GROWTH_M_S, _GROWTH_SHARE = 1.0, 0.1
_GROWTH_UP_M_S, _GROWTH_UP_ADSB_M_S, _GROWTH_UP_UNKNOWN_M_S = 0.5, 2.0, 15.0
_SAME_M, _SAME_M_S = 50.0, 5.0
_MOVES_M_S = 1.0


@final
class Listener:
    """What is known of others, from what was heard."""

    def __init__(self, mission: Mission) -> None:
        assert mission.traffic is not None
        self._rules, self._frame, self._task = mission.traffic, mission.frame, mission.task
        self._tracks: dict[str, Track] = {}
        self._claims: dict[int, Claim] = {}
        self._disarmed: set[int] = set()
        self._read_at_s: dict[str, float] = {}
        self.refused = self.dropped = 0
        """Reports that make no sense, or of aircraft that are too many."""
        self._told: set[str] = set()

    def on_message(self, heard: Incoming, now_s: float, ours: int) -> None:
        """One of `MESSAGES`; ours: our own system id."""
        if heard.number == _ADSB:
            self._on_aircraft(heard.message, now_s)
        elif heard.system == ours:
            pass
        elif heard.number == _CLAIM:
            if heard.component == COMPANION_COMPONENT:
                self._on_claim(heard, now_s)
        elif heard.component != AUTOPILOT_COMPONENT:
            if heard.number == _HEARTBEAT and heard.component == COMPANION_COMPONENT:
                self._on_farewell(heard)
        elif heard.number == _POSITION:
            self._on_system(heard, now_s)
        elif heard.message.base_mode & wire.MAV_MODE_FLAG_SAFETY_ARMED:
            self._disarmed.discard(heard.system)
        else:
            self._disarmed.add(heard.system)
            self._claims.pop(heard.system, None)
            self._tracks.pop(f"system {heard.system}", None)

    def others(self, position: events.Position, ours: int) -> OthersHeard:
        """All that is known now; what is too old is forgotten."""
        now_s = position.time_s
        tracks = [(k, t) for k, t in self._tracks.items() if _lasts(t.time_s, now_s)]
        if len(tracks) > _MOST:
            self.dropped += len(tracks) - _MOST
            here, speed_m_s = position.position_nea_m, self._task.limits.speed_m_s
            tracks.sort(key=lambda kept: kept[1].reach_s(here, speed_m_s, now_s))
        self._tracks = dict(tracks[:_MOST])
        self._read_at_s = {k: at for k, at in self._read_at_s.items() if _lasts(at, now_s)}
        self._claims = {
            k: claim
            for k, claim in self._claims.items()
            if _lasts(claim.heard_s, now_s, CLAIM_FORGOTTEN_S)
        }
        systems = [each for each in self._tracks.values() if each.system is not None]
        alone = (
            each
            for each in self._tracks.values()
            if each.system is not None or not any(_is_same(each, other) for other in systems)
        )
        return OthersHeard(
            time_s=now_s, ours=ours, tracks=tuple(alone), claims=tuple(self._claims.values())
        )

    def news(self) -> list[str]:
        """What a person should be told, once each."""
        texts = []
        if self.refused:
            texts.append("traffic: reports that make no sense are left out")
        if self.dropped:
            texts.append(f"traffic: more than {_MOST} aircraft, the nearest are watched")
        fresh = [text for text in texts if text not in self._told]
        self._told.update(fresh)
        return fresh

    def _on_aircraft(self, message: Message, now_s: float) -> None:
        flags, icao = message.flags, message.ICAO_address
        key = f"ADS-B {icao:06X}" if icao else f"ADS-B {message.callsign}"
        if icao and icao == self._rules.icao_address:
            return
        if not flags & wire.ADSB_FLAGS_VALID_COORDS or message.tslc > FORGOTTEN_S:
            return
        if not self._is_due(key, now_s):
            return
        place = place_of(message.lat, message.lon, message.altitude * 1e-3, self._frame)
        if place is None:
            self.refused += 1
            return
        error_up_m = math.inf
        if not flags & wire.ADSB_FLAGS_VALID_ALTITUDE:
            pass
        elif not _HEIGHTS_M[0] <= place[2] <= _HEIGHTS_M[1]:
            self.refused += 1
        else:
            geometric = message.altitude_type == wire.ADSB_ALTITUDE_TYPE_GEOMETRIC
            error_up_m = _GEOMETRIC_ERROR_M if geometric else _PRESSURE_ERROR_M
        velocity, growth_m_s, growth_up_m_s = self._velocity_of(message, place)
        self._keep(
            key,
            Track(
                name=key,
                time_s=now_s - message.tslc,
                position_nea_m=place,
                velocity_nea_m_s=velocity,
                error_m=_ADSB_ERROR_M,
                error_up_m=error_up_m,
                growth_m_s=growth_m_s,
                growth_up_m_s=growth_up_m_s,
            ),
        )

    def _velocity_of(self, message: Message, place: Vector) -> tuple[Vector, float, float]:
        """Velocity in the local frame; how fast the place grows uncertain, level and up, m/s."""
        flags, speed, up = message.flags, message.hor_velocity * 0.01, message.ver_velocity * 0.01
        growth_up_m_s = _GROWTH_UP_ADSB_M_S + _GROWTH_SHARE * abs(up)
        if not flags & wire.ADSB_FLAGS_VERTICAL_VELOCITY_VALID:
            up, growth_up_m_s = 0.0, _GROWTH_UP_UNKNOWN_M_S
        if not flags & wire.ADSB_FLAGS_VALID_VELOCITY or speed > _FASTEST_M_S:
            return (0.0, 0.0, up), _UNKNOWN_M_S, growth_up_m_s
        if not flags & wire.ADSB_FLAGS_VALID_HEADING or message.heading > 36_000:
            return (0.0, 0.0, up), _GROWTH_M_S + speed, growth_up_m_s
        course = math.radians(message.heading * 0.01) - self._frame.grid_north_rad(*place[:2])
        along = speed * math.cos(course), speed * math.sin(course)
        return (*along, up), _GROWTH_M_S + _GROWTH_SHARE * speed, growth_up_m_s

    def _on_system(self, heard: Incoming, now_s: float) -> None:
        name = f"system {heard.system}"
        if heard.system in self._disarmed or not self._is_due(name, now_s):
            return
        place = position(heard.message, now_s, self._frame)
        if place is None or not _HEIGHTS_M[0] <= place.position_nea_m[2] <= _HEIGHTS_M[1]:
            self.refused += 1
            return
        speed = math.hypot(*place.velocity_nea_m_s[:2])
        self._keep(
            name,
            Track(
                name=name,
                time_s=now_s,
                position_nea_m=place.position_nea_m,
                velocity_nea_m_s=place.velocity_nea_m_s,
                error_m=_SYSTEM_ERROR_M,
                error_up_m=_SYSTEM_ERROR_UP_M,
                growth_m_s=_GROWTH_M_S + _GROWTH_SHARE * speed,
                growth_up_m_s=_GROWTH_UP_M_S + _GROWTH_SHARE * abs(place.velocity_nea_m_s[2]),
                system=heard.system,
            ),
        )

    def _on_claim(self, heard: Incoming, now_s: float) -> None:
        message = heard.message
        if message.type_mask != POSITION_VELOCITY or heard.system in self._disarmed:
            return
        place = place_of(message.lat_int, message.lon_int, message.alt, self._frame)
        covers_m = math.hypot(message.vx, message.vy, message.vz) * _SPAN_S  # not a number, perhaps
        high = _HEIGHTS_M[0] <= message.alt <= _HEIGHTS_M[1]
        if place is None or not (high and covers_m <= _LONGEST_M):
            self.refused += 1
            return
        turn = -self._frame.grid_north_rad(*place[:2])
        ahead, aside = rotate(message.vx * _SPAN_S, message.vy * _SPAN_S, turn)
        self._claims[heard.system] = Claim(  # of 255 systems at most
            system=heard.system,
            heard_s=now_s,
            begin_nea_m=place,
            end_nea_m=(place[0] + ahead, place[1] + aside, place[2] - message.vz * _SPAN_S),
        )

    def _on_farewell(self, heard: Incoming) -> None:
        """A companion that ends claims nothing any more: its vehicle is a track from then on."""
        if heard.message.system_status == wire.MAV_STATE_POWEROFF:
            self._claims.pop(heard.system, None)

    def _is_due(self, key: str, now_s: float) -> bool:
        """Whether to read another report of this aircraft: not those of a flood."""
        if 0.0 <= now_s - self._read_at_s.get(key, -math.inf) < _PERIOD_S:
            return False
        if len(self._read_at_s) < _MOST_BETWEEN:
            self._read_at_s[key] = now_s
        return True

    def _keep(self, key: str, track: Track) -> None:
        """Keep a track until `others` is asked, which leaves those that can be met first."""
        before = self._tracks.get(key)
        if before is not None:
            moves = math.hypot(*track.velocity_nea_m_s[:2]) > _MOVES_M_S
            resent = moves and before.position_nea_m == track.position_nea_m  # by ArduPilot, 5 s
            if resent or before.time_s > track.time_s:
                return
        if before is not None or len(self._tracks) < _MOST_BETWEEN:
            self._tracks[key] = track
        else:
            self.dropped += 1


def _lasts(at_s: float, now_s: float, longest_s: float = FORGOTTEN_S) -> bool:
    """Whether it is not too old, nor of a clock that has begun again since."""
    return -1.0 <= now_s - at_s <= longest_s


def _is_same(aircraft: Track, system: Track) -> bool:
    """Whether an ADS-B track and a system on the link are one aircraft."""
    differs = math.dist(aircraft.velocity_nea_m_s[:2], system.velocity_nea_m_s[:2])
    if differs > _SAME_M_S:
        return False
    times_s = np.array([max(aircraft.time_s, system.time_s)])
    ([here], _, [up_m]), ([there], _, [also_m]) = aircraft.at(times_s), system.at(times_s)
    north, east, over = (here - there).tolist()
    return math.hypot(north, east) <= _SAME_M and abs(over) <= up_m + also_m


def claim_message(claim: events.ClaimWay, mission: Mission) -> Message | None:
    """A claim of ours; None if it is out of range."""
    begin, end = claim.begin_nea_m, claim.end_nea_m
    velocity = tuple((b - a) / _SPAN_S for a, b in zip(begin, end, strict=True))
    setpoint = Setpoint(
        time_s=claim.time_s,
        position_nea_m=begin,
        velocity_nea_m_s=(velocity[0], velocity[1], velocity[2]),
        yaw_rad=0.0,
    )
    if (aimed := aim(setpoint, mission.frame)) is None:
        return None
    place_e7, velocity_ned, _ = aimed
    unused = (0.0,) * 5
    return wire.MAVLink_position_target_global_int_message(
        round(claim.time_s * 1e3),
        wire.MAV_FRAME_GLOBAL_INT,
        POSITION_VELOCITY,
        *place_e7,
        begin[2],
        *velocity_ned,
        *unused,
    )
