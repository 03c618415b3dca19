"""The proof behind the certificate: bounds over whole pieces of a curve, in plain scalar code.

A piece of a cubic lies near its chord: its points within `sag` of the segment between its ends (a
bound that falls to a quarter with each halving), its tangents within a cone about the chord.  The
distance of that segment from terrain and zones is exact (`world.columns`, `world.zones`).  Branch
and bound over the pieces does the rest: a piece is done when its lower bound suffices, and halved
when not.

Everything runs as plain Python, and compiles with numba as it is.
"""

import math
from typing import NamedTuple

import numpy as np

from companion.geodesy import FloatArray
from companion.path.envelope import Envelope, beyond_m, ending_m_s, flown_on_m, rising_m_s
from companion.path.proof_shape import extremes, largest
from companion.world.columns import Columns, Segment, terrain_distance
from companion.world.zones import ZoneTable, zone_distance

ROUNDING = 1e-9
"""A bound missed by no more than this, relative, is missed by arithmetic and not by the curve."""
ROUNDING_M = 1e-6  # likewise, in metres: of coordinates up to 10,000 km
_PIECES = 24  # that a curve is cut into at first, about
_PARTS = 50  # of each, near radars: a thousandth of the curve tells how much of it is within range
_BUDGET = 3_000  # pieces for each bound; what is not proven by then is not
_FINEST = 2.0**-24  # of a span: 1 mm of 20 km, below which halving brings nothing
_STACK = 64  # halves that wait, one for each halving: 24 at most
_NEVER = 1e12  # m: no zone is as deep
_INSIDE_M = 1.0  # how deep in a zone a dead-man stretch ends is not looked into
_TERRAIN, _ZONES, _DEAD_MAN = 0, 1, 2


class Surroundings(NamedTuple):
    """What a proof is about: terrain, zones, radars and bounds, as plain numbers and arrays."""

    columns: Columns  # of a plane's terrain its circle is dealt with in `registration_m`
    zones: ZoneTable
    radars: FloatArray  # (N, 4): north, east, altitude, range
    clearance_m: float
    """The curve keeps this from terrain and zones; the dead-man stretches keep `contact_m`."""
    contact_m: float
    motion: Envelope
    stops: bool
    """Whether the vehicle stops at the end of the curve; if not, it may be at full speed there."""
    lowest_nea_m: tuple[float, float, float]
    """The south-western corner of the map, and the floor; `highest_nea_m` likewise."""
    highest_nea_m: tuple[float, float, float]


class Question(NamedTuple):
    """A curve, what it is proven against, and what is made once for both."""

    cubics: FloatArray  # (spans, 4, 3)
    around: Surroundings
    rows: FloatArray  # (N, 5), of `first_pieces`
    from_rest: bool
    scratch: FloatArray  # of `terrain_distance`


class Piece(NamedTuple):
    """A piece of a curve, as its chord and what surrounds that."""

    chord: Segment
    sag: float  # how far the piece may be from its chord, metres
    cosine: float
    """Of the half-angle of the cone about the chord that holds the tangents of the piece."""
    length: float  # at most, metres


class Bounds(NamedTuple):
    """What a whole curve keeps and comes to: `certificate.Certificate` says what each is."""

    clearance_m: float
    keep_out_m: float
    dead_man_m: float
    turn_radius_m: float
    climb_angle_rad: float
    dive_angle_rad: float
    lowest_amsl_m: float
    highest_amsl_m: float
    off_map_m: float
    radar_m: float
    detection: float
    pieces: float


def part_of(
    cubics: FloatArray, span: int, axis: int, start: float, step: float
) -> tuple[float, float, float, float]:
    """Coefficients by 0 <= s <= 1 of a coordinate over a piece of a span."""
    c0, c1 = float(cubics[span, 0, axis]), float(cubics[span, 1, axis])
    c2, c3 = float(cubics[span, 2, axis]), float(cubics[span, 3, axis])
    return (
        c0 + (c1 + (c2 + c3 * start) * start) * start,
        (c1 + (2.0 * c2 + 3.0 * c3 * start) * start) * step,
        (c2 + 3.0 * c3 * start) * step * step,
        c3 * step * step * step,
    )


def distance(x: float, y: float, z: float) -> float:
    """Length of a vector."""
    return math.sqrt(x * x + y * y + z * z)


def across(x: float, y: float, z: float, dx: float, dy: float, dz: float, squared: float) -> float:
    """Length of the part of a vector that is across a direction of squared length `squared`."""
    along = (x * dx + y * dy + z * dz) / squared if squared > 0.0 else 0.0
    return distance(x - along * dx, y - along * dy, z - along * dz)


def piece_of(cubics: FloatArray, span: int, start: float, end: float) -> Piece:
    """A piece of one span, start <= t <= end, as its chord and what surrounds it.

    p = p0 + a s + b s^2 + c s^3 over 0 <= s <= 1 is off its chord, at the same s, by
    s (1 - s) |(b + c) (1 - s) + (b + 2c) s|: by a quarter of the longer of the two at most.  While
    it never runs backwards only the part across counts, as it cannot overshoot the chord's ends.
    """
    x, ax, bx, cx = part_of(cubics, span, 0, start, end - start)
    y, ay, by, cy = part_of(cubics, span, 1, start, end - start)
    z, az, bz, cz = part_of(cubics, span, 2, start, end - start)
    dx, dy, dz = ax + bx + cx, ay + by + cy, az + bz + cz
    squared = dx * dx + dy * dy + dz * dz
    chord = math.sqrt(squared)
    least, length = 1.0, 0.0
    # the legs of the control polygon, three times as long: a Bernstein basis
    for u, v in ((0.0, 0.0), (1.0, 0.0), (2.0, 3.0)):
        px, py, pz = ax + u * bx + v * cx, ay + u * by + v * cy, az + u * bz + v * cz
        leg = distance(px, py, pz)
        length += leg / 3.0
        if leg > 0.0:
            along = px * dx + py * dy + pz * dz
            least = min(least, along / (leg * chord)) if chord > 0.0 else -1.0
    if least < 0.0:
        squared = 0.0
    one = across(bx + cx, by + cy, bz + cz, dx, dy, dz, squared)
    two = across(bx + 2.0 * cx, by + 2.0 * cy, bz + 2.0 * cz, dx, dy, dz, squared)
    return Piece((x, y, z, dx, dy, dz), 0.25 * max(one, two), least, length)


def stretch_of(
    around: Surroundings, piece: Piece, flown: float, left: float
) -> tuple[Segment, float]:
    """A segment near all straight stretches that leave a piece, and how near.

    The stretch of length tau from a point is within sag + tau |tangent - chord's direction| of the
    chord drawn on.  Where the path climbs it is level, as a vehicle that brakes upwards at once is
    no lower; that of a chord lies half way up it.  flown, left: length of the curve up to the end
    of the piece, and from its start on, at most: the speed is bounded by both, and its reach by the
    speed.
    """
    segment, sag, cosine, length = piece
    x, y, z, dx, dy, dz = segment
    fastest = ending_m_s(around.motion, left)
    rising = rising_m_s(around.motion, flown)
    farthest = flown_on_m(around.motion, min(fastest, rising))
    chord = distance(dx, dy, dz)
    if cosine <= 0.0 or chord <= 0.0:
        return segment, sag + (farthest if cosine < 1.0 or chord > 0.0 else 0.0)
    ahead = min(length + farthest, left + beyond_m(around.motion))
    grow = max(ahead, chord) / chord
    slack = sag + farthest * math.sqrt(max(2.0 - 2.0 * cosine, 0.0))
    rise = max(dz, 0.0)
    level = x, y, z + 0.5 * rise, dx * grow, dy * grow, (dz - rise) * grow
    return level, slack + 0.5 * rise


def first_pieces(cubics: FloatArray) -> FloatArray:
    """The pieces to begin with: span, start, end, length flown before and left after, at most."""
    spans = cubics.shape[0]
    per_span = (_PIECES + spans - 1) // spans
    table, flown = np.zeros((spans * per_span, 5)), 0.0
    for k in range(spans * per_span):
        span, piece = k // per_span, k % per_span
        table[k, 0], table[k, 1], table[k, 2] = span, piece / per_span, (piece + 1) / per_span
        table[k, 3] = flown
        flown += piece_of(cubics, span, float(table[k, 1]), float(table[k, 2])).length
    table[:-1, 4] = flown - table[1:, 3]
    return table


def part_distance(
    asked: Question, what: int, k: int, start: float, end: float, limit: float
) -> tuple[float, float, float]:
    """Bounds of a distance over a part, start <= t <= end, of the k-th of the first pieces.

    -> the lower and the upper one, both at most `limit`, and how far off the part is at most from
    the segment that stands for it: the slack.
    """
    cubics, around, row = asked.cubics, asked.around, asked.rows[k]
    span = int(row[0])
    piece = piece_of(cubics, span, start, end)
    segment, slack = piece.chord, piece.sag
    if what == _DEAD_MAN:
        flown, left = math.inf, math.inf
        if around.stops:
            left = row[4] + piece_of(cubics, span, start, float(row[2])).length
        if asked.from_rest:
            flown = row[3] + piece_of(cubics, span, float(row[1]), end).length
        segment, slack = stretch_of(around, piece, flown, left)
    if slack > max(limit, 0.0) + 2.0 * around.clearance_m:
        return (0.0 if what == _TERRAIN else -_NEVER), limit, slack  # too coarse to be worth it
    tolerance = 1e-3 * around.clearance_m
    lower, upper = limit, limit
    if what != _ZONES:
        far = terrain_distance(around.columns, segment, limit + slack, tolerance, asked.scratch)
        lower, upper = max(far - slack, 0.0), far + tolerance + slack
    if what != _TERRAIN:
        within = max(limit + slack + around.motion.loiter_m, 0.0)
        low, high = zone_distance(around.zones, segment, within)
        low, high = low - around.motion.loiter_m, high - around.motion.loiter_m
        if what == _DEAD_MAN:
            low, high = max(low, -_INSIDE_M), max(high, -_INSIDE_M)
        lower, upper = min(lower, low - slack), min(upper, high + slack)
    return min(lower, limit), min(upper, limit), slack


def least_distance(asked: Question, what: int, cap: float) -> tuple[float, int]:
    """Lower bound of a distance over the whole curve, at most `cap`, and the pieces it took.

    A piece is done when its bound is within 1 % of d_s (2 % for the dead man) of what the curve is
    known to come to (five times that if the bound is broken), and suffices; or when nothing is
    left that halving it would bring.
    """
    around, rows = asked.around, asked.rows
    need = around.contact_m if what == _DEAD_MAN else around.clearance_m
    tolerance = (0.02 if what == _DEAD_MAN else 0.01) * around.clearance_m
    smallest = min(0.0015 * around.clearance_m, 0.1 * around.columns.cell_m)
    upper, result, count = cap, cap, len(rows)
    lowers, slacks, stack = np.empty(count), np.empty(count), np.empty((_STACK, 2))
    for k in range(len(rows)):
        start, end = float(rows[k, 1]), float(rows[k, 2])
        lowers[k], high, slacks[k] = part_distance(asked, what, k, start, end, upper)
        upper = min(upper, high)
    for k in range(len(rows)):
        lower, slack, depth = float(lowers[k]), float(slacks[k]), 0
        start, end = float(rows[k, 1]), float(rows[k, 2])
        while True:
            enough = upper - 5.0 * tolerance  # broken: by how much need not be known well
            if upper >= need - ROUNDING_M:
                enough = max(upper - tolerance, need - ROUNDING_M)
            small = slack <= smallest or end - start < _FINEST
            if lower >= enough or small or count >= _BUDGET:
                result = min(result, lower)
                if depth == 0:
                    break
                depth -= 1
                start, end = float(stack[depth, 0]), float(stack[depth, 1])
            else:
                stack[depth, 0], stack[depth, 1] = 0.5 * (start + end), end
                depth, end = depth + 1, 0.5 * (start + end)
            lower, high, slack = part_distance(asked, what, k, start, end, upper)
            upper, count = min(upper, high), count + 1
    return result, count


def detection_at_most(radars: FloatArray, piece: Piece) -> float:
    """Detection (eq. 3) where a piece is nearest to a radar, at most; 0: out of all ranges."""
    (x, y, z, dx, dy, dz), sag, _, _ = piece
    squared, most = dx * dx + dy * dy + dz * dz, 0.0
    for k in range(radars.shape[0]):
        px, py, pz, span = radars[k, 0] - x, radars[k, 1] - y, radars[k, 2] - z, radars[k, 3]
        at = 0.0
        if squared > 0.0:
            at = min(max((px * dx + py * dy + pz * dz) / squared, 0.0), 1.0)
        nearest = max(distance(px - at * dx, py - at * dy, pz - at * dz) - sag, 0.0)
        if nearest <= span:
            most = max(most, 1.0 / (1.0 + (nearest / span) ** 4))
    return most


def exposure(cubics: FloatArray, radars: FloatArray, rows: FloatArray) -> tuple[float, float]:
    """Length within radar ranges (a stretch in two counts once) and detection, both at most."""
    within, detection = 0.0, 0.0
    for k in range(len(rows)):
        span, start, end = int(rows[k, 0]), float(rows[k, 1]), float(rows[k, 2])
        if detection_at_most(radars, piece_of(cubics, span, start, end)) == 0.0:
            continue
        step = (end - start) / _PARTS
        for j in range(_PARTS):
            piece = piece_of(cubics, span, start + j * step, start + (j + 1) * step)
            most = detection_at_most(radars, piece)
            if most > 0.0:
                within, detection = within + piece.length, max(detection, most)
    return within, detection


def prove(cubics: FloatArray, around: Surroundings, from_rest: bool) -> Bounds:
    """Every bound over the whole curve; finite input is the caller's duty.

    cubics (spans, 4, 3): coefficients of 1, t, t^2, t^3 over 0 <= t <= 1, span after span.
    from_rest: the vehicle hovers at the curve's start, and is the slower for it.  A plane has no
    straight dead-man stretches: it circles wherever it is sent to last.
    """
    rows, scratch = first_pieces(cubics), np.empty((around.columns.blocks_m.size, 3))
    asked = Question(cubics, around, rows, from_rest, scratch)
    far, steep, pieces = np.full(3, math.inf), np.empty(3), 0
    for what in range(3):  # terrain, zones, dead man; in a loop, so that it is compiled once
        cap = 2.0 * around.clearance_m
        if what == _DEAD_MAN:
            cap = around.contact_m + 0.25 * around.clearance_m
        if what == _DEAD_MAN and around.motion.loiter_m > 0.0:
            far[what] = min(cap, min(far[_TERRAIN], far[_ZONES]))
        elif what != _ZONES or around.zones.circles.size + around.zones.polygons.size > 0:
            far[what], more = least_distance(asked, what, cap)
            pieces += more
    it = around.motion
    limits = (
        (1.0 / it.turn_radius_m) ** 2,
        math.tan(it.climb_angle_rad),
        math.tan(it.dive_angle_rad),
    )
    for what in range(3):  # squared curvature, climb, dive
        limit = limits[what] * (1.0 + ROUNDING)
        steep[what], more = largest(cubics, (0, 1, -1)[what], limit, 0.004)
        pieces += more
    lowest, highest = extremes(cubics, 2)
    off = 0.0
    for axis in range(2):
        low, high = extremes(cubics, axis)
        off = max(off, max(around.lowest_nea_m[axis] - low, high - around.highest_nea_m[axis]))
    radar, detection = exposure(cubics, around.radars, rows)
    tightest_m = 1.0 / math.sqrt(steep[0]) if steep[0] > 0.0 else math.inf
    return Bounds(
        *(far[_TERRAIN], far[_ZONES], far[_DEAD_MAN]),
        *(tightest_m, math.atan(steep[1]), math.atan(steep[2])),
        *(lowest, highest, off, radar, detection, pieces),
    )
