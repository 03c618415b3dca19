"""Terrain radar client: one scan at a time by TERRAIN_REQUEST, TERRAIN_DATA and TERRAIN_REPORT.

Requests cover 28 x 32 cells: 7 x 8 blocks of 4 x 4 (message definition: "row major 8x7 array of
grids").  One is outstanding; blocks without an answer are requested again, and stay unknown if that
fails too.  Cells run along true north and east of a request's corner, the lattice of the known map
along the local frame: each request is laid so that its middle agrees, and how far its corners are
off is part of the answer (design section 4).
"""

import math
from collections import Counter
from collections.abc import Iterator
from typing import Final, NamedTuple, final

import numpy as np

from companion.geodesy import FloatArray, LocalFrame, deg, deg_e7, offset_deg
from companion.mavlink.checks import Check, check, remark
from companion.mavlink.dialect import Message, wire
from companion.mavlink.poses import Reads
from companion.mission.events import ScanDone, Vector
from companion.mission.mission import Mission
from companion.mission.state import State
from companion.world.known_map import NO_ANSWER, NOT_SEEN, KnownMap, Scan

BLOCK = 4
BLOCK_ROWS, BLOCK_COLUMNS = 7, 8
ROWS, COLUMNS = BLOCK_ROWS * BLOCK, BLOCK_COLUMNS * BLOCK
_UNSEEN_WIRE = -32768
_ANSWER_S = 1.0
_PAUSE_S = 0.4  # between two answers: then the rest is lost
_MAX_REQUESTS = 3  # of one area
_TICKS = 2.0  # a radar's answer may be older by so many positions
_NO_RADAR = (
    "Start it, or correct vehicle.scanner_component_id. Where there is none, say so in a "
    "mission.toml, which may name a .plan: vehicle.scanner = false, and [terrain] with an "
    "elevation file, or with the highest ground there is, highest_amsl_m (docs/files.md)."
)
_ALIKE_M = 0.01  # distances that differ by less are the same: what is asked hangs on no last digit


class Area(NamedTuple):
    """The area of one TERRAIN_REQUEST."""

    row: int
    column: int
    """Lattice index of the south-west cell."""
    mask: int
    latitude_e7: int
    longitude_e7: int
    """South-west corner."""
    registration_m: float


def areas(
    known: KnownMap, centre_ne_m: tuple[float, float], range_m: float, frame: LocalFrame
) -> Iterator[Area]:
    """The requests that cover what is within range of a point and has not been seen yet."""
    centre_row, centre_column = known.cell_of(*centre_ne_m)
    reach = math.ceil(range_m / known.cell_m)
    for row in _starts(centre_row, reach, ROWS):
        for column in _starts(centre_column, reach, COLUMNS):
            mask = _mask(known, row, column, centre_ne_m, range_m)
            if mask:
                yield _placed(known, row, column, mask, frame)


def _starts(centre: int, reach: int, size: int) -> range:
    count = math.ceil(2 * reach / size)
    first = centre - count * size // 2
    return range(first, first + count * size, size)


def _mask(
    known: KnownMap, row: int, column: int, centre_ne_m: tuple[float, float], range_m: float
) -> int:
    """Bits of the blocks that are on the map, within range and not seen entirely."""
    window = slice(row, row + ROWS), slice(column, column + COLUMNS)
    north, east = known.middles_m(window)
    wanted = np.hypot(north - centre_ne_m[0], east - centre_ne_m[1]) <= range_m + _ALIKE_M
    rows, in_rows = _on_map(row, ROWS, known.seen.shape[0])
    columns, in_columns = _on_map(column, COLUMNS, known.seen.shape[1])
    unseen = np.zeros((ROWS, COLUMNS), dtype=bool)
    unseen[in_rows, in_columns] = ~known.seen[rows, columns]
    blocks = (wanted & unseen).reshape(BLOCK_ROWS, BLOCK, BLOCK_COLUMNS, BLOCK).any(axis=(1, 3))
    return sum(1 << int(bit) for bit in np.flatnonzero(blocks.ravel()))


def _on_map(first: int, count: int, size: int) -> tuple[slice, slice]:
    """Those of so many rows or columns that are on the map: as it counts, and from the first."""
    begin = max(first, 0)
    end = max(min(first + count, size), begin)
    return slice(begin, end), slice(begin - first, end - first)


def _placed(known: KnownMap, row: int, column: int, mask: int, frame: LocalFrame) -> Area:
    """Lay an area so that its middle is on the lattice; measure how far its corners are off."""
    cell = known.cell_m
    south, west = known.north_min_m + row * cell, known.east_min_m + column * cell
    height, width = ROWS * cell, COLUMNS * cell
    middle = frame.to_geodetic_deg(south + 0.5 * height, west + 0.5 * width)
    corner = offset_deg(*middle, -0.5 * height, -0.5 * width)
    latitude_e7, longitude_e7 = deg_e7(corner[0]), deg_e7(corner[1])
    off = 0.0
    for north in (0.0, height):
        for east in (0.0, width):
            place = offset_deg(deg(latitude_e7), deg(longitude_e7), north, east)
            off = max(off, math.dist(frame.to_local_m(*place), (south + north, west + east)))
    return Area(row, column, mask, latitude_e7, longitude_e7, off)


def _order(known: KnownMap, area: Area, point_ne_m: tuple[float, float]) -> int:
    """Areas nearer to a point come first."""
    north = known.north_min_m + (area.row + 0.5 * ROWS) * known.cell_m
    east = known.east_min_m + (area.column + 0.5 * COLUMNS) * known.cell_m
    return round(math.dist((north, east), point_ne_m) / _ALIKE_M)


@final
class TerrainRadar:
    """Requests a scan around a point, area by area, and collects the answers.

    Pure: time is an argument.  Of a vehicle without a radar a scan is over at once.
    """

    streams_hz: Final = dict[int, float]()

    def __init__(self, mission: Mission) -> None:
        self._mission, who = mission, mission.scanner_component_id
        answers = wire.MAVLINK_MSG_ID_TERRAIN_DATA, wire.MAVLINK_MSG_ID_TERRAIN_REPORT
        self.reads: Reads = {} if who is None else {(who, n): self.on_message for n in answers}
        self._area: Area | None = None
        self._here_nea_m: Vector | None = None

    def begin(self, centre_nea_m: Vector, state: State, now_s: float) -> int:
        """A scan: how many blocks are asked for."""
        mission = self._mission
        known, settings, centre_ne_m = state.flight.known, state.task.settings, centre_nea_m[:2]
        self._cell_m = round(known.cell_m)
        self._range_m = range_m = settings.scan_range_m if self.reads else 0.0
        self._deadline_s = now_s + settings.scan_time_s
        self._drift_m = _TICKS / mission.position_rate_hz * state.task.limits.speed_m_s
        north_m, east_m = np.subtract(state.targets_ne_m[state.flight.target], centre_ne_m)
        share = min(0.5 * range_m / max(math.hypot(north_m, east_m), 1e-9), 1.0)
        ahead_ne_m = centre_ne_m[0] + share * north_m, centre_ne_m[1] + share * east_m  # is first
        self._waiting = sorted(
            areas(known, centre_ne_m, range_m, mission.frame),
            key=lambda area: _order(known, area, ahead_ne_m),
        )
        self._registration_m = max((area.registration_m for area in self._waiting), default=0.0)
        self._tries = Counter[tuple[int, int]]()
        self._area, self._left = None, 0
        self._heard_at_s = self._looked_s = -math.inf  # heard, or asked
        self._heights_m: FloatArray = np.full(known.upper_m.shape, NO_ANSWER)
        self._radar_nea_m: FloatArray = np.zeros((*known.upper_m.shape, 3))
        self.asked = sum(area.mask.bit_count() for area in self._waiting)
        """Blocks asked for."""
        self.answered = 0
        """Blocks answered."""
        return self.asked

    def go_on(self, now_s: float, here_nea_m: Vector | None) -> ScanDone | Message | None:
        """The next request, if it is time for one: the last was answered, or took too long.

        All of it, once each was answered or given up, or the deadline has passed.
        """
        self._here_nea_m = here_nea_m
        if (self._area is None and not self._waiting) or now_s >= self._deadline_s:
            return self._done(now_s)
        if self._area is not None:
            if self._is_answering(now_s):
                return None
            self._requeue()
        if not self._waiting:
            return None
        area = self._waiting.pop(0)
        self._area, self._heard_at_s, self._looked_s = area, now_s, now_s
        self._left = area.mask
        self._tries[area.row, area.column] += 1
        return wire.MAVLink_terrain_request_message(
            area.latitude_e7, area.longitude_e7, self._cell_m, area.mask
        )

    def _is_answering(self, now_s: float) -> bool:
        """Whether answers to the outstanding request may still come."""
        assert self._area is not None
        deaf_s, self._looked_s = now_s - max(self._looked_s, self._heard_at_s), now_s
        if self._left != self._area.mask and deaf_s > _PAUSE_S:
            self._heard_at_s += deaf_s  # nothing came at all: the link was gone
        patience_s = _ANSWER_S if self._left == self._area.mask else _PAUSE_S
        return now_s - self._heard_at_s < patience_s

    def on_message(self, message: Message, now_s: float) -> None:
        """A block, or the report that ends the answers to a request."""
        area = self._area
        if area is None or (message.lat, message.lon) != (area.latitude_e7, area.longitude_e7):
            return
        if message.get_type() == "TERRAIN_REPORT":
            if message.pending == 0:
                self._requeue()
        elif self._left >> message.gridbit & 1 and message.grid_spacing == self._cell_m:
            self._store(area, message, now_s)

    def _store(self, area: Area, message: Message, now_s: float) -> None:
        if self._here_nea_m is None:
            return
        self._heard_at_s = now_s
        self._left &= ~(1 << message.gridbit)
        self.answered += 1
        row = area.row + message.gridbit // BLOCK_COLUMNS * BLOCK
        column = area.column + message.gridbit % BLOCK_COLUMNS * BLOCK
        heights = np.array(message.data, dtype=float).reshape(BLOCK, BLOCK)
        heights[heights == _UNSEEN_WIRE] = NOT_SEEN
        rows, in_rows = _on_map(row, BLOCK, self._heights_m.shape[0])
        columns, in_columns = _on_map(column, BLOCK, self._heights_m.shape[1])
        self._heights_m[rows, columns] = heights[in_rows, in_columns]
        self._radar_nea_m[rows, columns] = self._here_nea_m

    def _requeue(self) -> None:
        """End the outstanding request and queue its missing blocks again."""
        area = self._area
        assert area is not None
        if self._left and self._tries[area.row, area.column] < _MAX_REQUESTS:
            self._waiting.append(area._replace(mask=self._left))
        self._area = None

    def seen(self, _now_s: float, _known: KnownMap) -> None:
        """It says nothing by itself."""

    def checks(self, state: State, scan: ScanDone | None, heard: str) -> Iterator[Check]:
        """Whether it has answered."""
        who = self._mission.scanner_component_id
        if who is None:
            yield remark("radar", "none: only terrain that is known in advance is flown over")
        elif not state.targets_ne_m or state.vehicle.position_nea_m is None:
            yield remark("radar", "not asked: where from and where to is not known")
        elif scan is None or not scan.answered:
            what = f"the terrain radar, component {who}, did not answer TERRAIN_REQUEST"
            yield check("radar", False, f"{what}; heard: {heard}", _NO_RADAR)
        else:
            # what is left out stays unknown, and is asked for again in flight
            yield check("radar", True, f"{scan.answered} of {scan.asked} blocks answered in time")

    def _done(self, now_s: float) -> ScanDone:
        """What was answered, on the part of the map that has answers: no more of it is kept."""
        rows, columns = np.nonzero(~np.isnan(self._heights_m))
        if rows.size == 0:
            rows = columns = np.zeros(1, dtype=np.intp)
        window = np.s_[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
        scan = Scan(
            row=int(rows.min()),
            column=int(columns.min()),
            heights_m=self._heights_m[window].copy(),
            radar_nea_m=self._radar_nea_m[window].copy(),
            range_m=self._range_m,
            drift_m=self._drift_m,
            registration_m=self._registration_m,
            complete=self._mission.scanner_complete,
        )
        self._area = None
        self._heights_m = self._radar_nea_m = np.empty(0)
        return ScanDone(time_s=now_s, scan=scan, asked=self.asked, answered=self.answered)
