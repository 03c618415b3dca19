"""What logs of all kinds have in common: records, a clock that never falls, what is odd."""

import enum
import itertools
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal, NamedTuple, final

from companion.errors import InputError
from companion.mavlink.dialect import KINDS, wire
from companion.mavlink.link import TO_COMPONENT_1, ids_in_words

YEAR_2000_US: Final = 946_684_800_000_000
YEAR_2100_US: Final = 4_102_444_800_000_000
"""Microseconds since 1970, between which a stamp is a date."""
_BACK_US: Final = 1_000_000
"""A clock that falls by more was set, or replaced."""
_GAP_US: Final = 600_000_000
"""A step ahead by more is doubted."""


@final
class Record(NamedTuple):
    """One MAVLink frame of a log, and when it was logged."""

    time_us: int
    """Microseconds since 1970; it never falls from one record to the next."""
    frame: bytes
    """As it stood in the log, MAVLink 1 or 2, signed or not."""


class Odd(enum.StrEnum):
    """What may be odd about a log: the text, with `{}` for how often."""

    GARBAGE = "{} bytes that belong to nothing were passed over"
    CHECKSUM = "{} messages with a wrong checksum were left out"
    DAMAGED = "{} entries that cannot be what the log says they are were left out"
    UNKNOWN = "{} messages of kinds that this program does not know: their checksum is not checked"
    CUT_SHORT = "the end is cut short: its last {} bytes are no whole entry"
    CORRUPT = "parts of it are damaged, and left out"
    UNREADABLE = "the file could not be read on"
    SECRET = "{} messages with a key or password were left out"
    SIGNED = "{} messages are signed: no signature was checked"
    OTHER_VEHICLE = "{} messages of other vehicles were left out"
    NO_STAMP = "{} messages without a time stamp: each has the time of the one before"
    WRONG_STAMP = "{} time stamps make no sense: not believed"
    NO_DATE = "nothing tells the date: time counts from the vehicle's boot, as if in 1970"
    TIME_BACK = "time falls back by more than a second, {} in all: read on without a step"
    TIME_GAP = "{} gaps of more than ten minutes"
    LOST_TIME = "the vehicle says that it could not write its log for {} milliseconds"
    LOST_ENTRIES = "the vehicle says that it could not write {} entries of its log"
    NO_KIND = "no entry (VER, MSG) tells which kind of vehicle it is: no HEARTBEAT is made"
    CLOCK_IS_DATE = "the vehicle's clock is a date: its boot is taken to be the log's beginning"
    MADE_ESTIMATOR = (
        "ESTIMATOR_STATUS is made of vehicle_local_position and estimator_status_flags: there is "
        "no estimator_status"
    )


# --- a log, opened

HOW_TO_RECORD: Final = "What to record, and how: docs/replay.md"
_NEEDED: Final = {
    "HEARTBEAT": "which autopilot it is, its mode and whether it is armed",
    "GLOBAL_POSITION_INT": "where the vehicle is: nothing is planned",
    "GPS_RAW_INT": "whether its GPS has a fix",
    "EKF_STATUS_REPORT": "whether its estimator may be believed",
    "ESTIMATOR_STATUS": "whether its estimator may be believed",
    "EXTENDED_SYS_STATE": "whether it stands on the ground",
    "HOME_POSITION": "where home is, and how high",
    "GPS_GLOBAL_ORIGIN": "what its local frame is measured from",
    "SYS_STATUS or BATTERY_STATUS": "how much battery is left",
    "PARAM_VALUE": "its parameters: they are not judged",
    "STATUSTEXT": "what it said",
}
"""What is impossible without a message; without the first five it does not fly."""
_NOT_SENT: Final = {
    wire.MAV_AUTOPILOT_ARDUPILOTMEGA: "ESTIMATOR_STATUS",
    wire.MAV_AUTOPILOT_PX4: "EKF_STATUS_REPORT",
}
"""By MAV_AUTOPILOT: that of the other one, which is not missed."""


@final
@dataclass(slots=True, kw_only=True)
class Log:
    """A log of any kind, opened."""

    kind: Literal["tlog", "bin", "ulg"]
    """tlog: MAVLink frames; bin: ArduPilot's own log; ulg: PX4's own."""
    path: Path
    autopilots: dict[int, int]
    """MAV_AUTOPILOT by system id, of all autopilots in it."""
    read: Callable[["Log"], Iterator[Record]]
    """One pass through it: notes in the log how far it is, what is odd and what it heard."""
    elsewhere: frozenset[tuple[int, int]] = frozenset()
    """System and component of what sends an autopilot's heartbeat and is not component 1."""
    system_id: int | None = None
    """The vehicle that is read; None: there is no heartbeat of an autopilot in it."""
    odd: Counter[Odd] = field(default_factory=Counter)
    """How often each oddity was met, as far as `records` has come."""
    heard: set[int] = field(default_factory=set)
    """Message numbers of the autopilot, likewise."""

    def choose(self, asked: int | None) -> None:
        """Select the vehicle that is asked for; None: the only one.  InputError if it is not."""
        those = ", ".join(map(str, self.systems))
        if asked is None and len(self.systems) > 1:
            rule = f"several vehicles are in it, systems {those}"
            raise InputError("log", str(self.path), rule, "Choose one with --system.")
        self.system_id = next(iter(self.systems), None) if asked is None else asked
        if asked is None or asked in self.systems:
            return
        rule = f"there is no such vehicle in {self.path.name}"
        if of_it := sorted(sender for sender in self.elsewhere if sender[0] == asked):
            rule += f": its autopilot is {ids_in_words(of_it)}, not component 1"
            raise InputError("--system", asked, rule, TO_COMPONENT_1)
        none = "There is no autopilot's heartbeat in it: leave --system out."
        raise InputError("--system", asked, rule, f"Its vehicles: {those}." if those else none)

    @property
    def systems(self) -> tuple[int, ...]:
        """System ids of all autopilots in it."""
        return tuple(sorted(self.autopilots))

    @property
    def findings(self) -> tuple[str, ...]:
        """What is odd about it, as far as `records` has come."""
        return tuple(odd.format(f"{count:,}") for odd, count in self.odd.items() if count)

    def missing(self) -> dict[str, str]:
        """What never came of what the companion listens to, once `records` has come to the end.

        MAVLink names (of several that serve alike, joined by "or"), and what is impossible without.
        """
        heard = {KINDS[number].msgname for number in self.heard & KINDS.keys()}
        heard.add(_NOT_SENT.get(self.autopilots.get(self.system_id or 0, 0), ""))
        return {
            message: without
            for message, without in _NEEDED.items()
            if heard.isdisjoint(message.split(" or "))
        }

    def records(self) -> Iterator[Record]:
        """All of it, in order; each call begins again, and so do the findings.

        Frames of other vehicles, and those with secrets, are left out.
        """
        self.odd.clear()
        self.heard.clear()
        try:
            yield from self.read(self)
        except OSError:
            self.odd[Odd.UNREADABLE] = 1


# --- its time


@final
class Clock:
    """Makes a time that never falls of a log's stamps.

    A stamp that leaps is believed once the next one agrees with it; until then the last time
    goes on.  After a fall time continues from where it was.
    """

    def __init__(self, odd: Counter[Odd], *, start_us: int, last_us: int) -> None:
        """start_us: the first stamp, from which others are doubted; none is beyond last_us."""
        self._odd, self._last_us = odd, last_us
        self._stamp_us = self.now_us = start_us
        self._shift_us = 0
        self._doubted_us: int | None = None

    def read(self, stamp_us: int) -> bool:
        """Go on to a stamp, in microseconds; whether it is believed."""
        if stamp_us >= self._last_us:
            self._odd[Odd.WRONG_STAMP] += 1
            return False
        if not _agree(self._stamp_us, stamp_us):
            if self._doubted_us is None or not _agree(self._doubted_us, stamp_us):
                self._doubted_us = stamp_us
                self._odd[Odd.WRONG_STAMP] += 1
                return False
            self._odd[Odd.WRONG_STAMP] -= 1
            self._odd[Odd.TIME_BACK if stamp_us < self._stamp_us else Odd.TIME_GAP] += 1
            # no more of a shift than keeps it from falling: what leaps on and on stays bounded
            self._shift_us = max(self.now_us - stamp_us, 0)
        self._stamp_us, self._doubted_us = stamp_us, None
        self.now_us = max(self.now_us, stamp_us + self._shift_us)
        return True


def earliest(stamps_us: list[int]) -> int:
    """Where a log begins, by its first stamps: the first that the one after it agrees with."""
    pairs = itertools.pairwise(stamps_us)
    return next((now for now, after in pairs if _agree(now, after)), next(iter(stamps_us), 0))


def _agree(stamp_us: int, next_us: int) -> bool:
    """Whether a stamp may follow another."""
    return -_BACK_US <= next_us - stamp_us <= _GAP_US
