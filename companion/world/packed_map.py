"""A known map as bytes (numpy's compressed .npz), and back; and what tells it from others."""

import hashlib
import io

import numpy as np
from numpy.typing import ArrayLike, NDArray

from companion.world.known_map import KnownMap

_NO_LENGTH = -(2**52)


def packed_map(known: KnownMap) -> bytes:
    """The map, without what was given in advance."""
    buffer = io.BytesIO()
    lattice = [known.cell_m, known.north_min_m, known.east_min_m, known.registration_m]
    np.savez_compressed(buffer, lattice=lattice, upper_m=known.upper_m, seen=known.seen)
    return buffer.getvalue()


def unpacked_map(data: bytes) -> KnownMap:
    """The map that they were made of.  ValueError if they cannot be read."""
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as held:
            cell_m, north_m, east_m, registration_m = held["lattice"].tolist()
            return KnownMap(
                cell_m=cell_m,
                north_min_m=north_m,
                east_min_m=east_m,
                upper_m=held["upper_m"],
                seen=held["seen"],
                registration_m=registration_m,
            )
    except Exception as error:  # whatever damaged bytes lead numpy to: a SyntaxError, too
        raise ValueError("it is cut short or damaged") from error


def digest_of(known: KnownMap) -> str:
    """What tells a map from any other, to the millimetre: the same on every computer."""
    lattice = known.cell_m, known.north_min_m, known.east_min_m, known.registration_m
    digest = hashlib.sha256(repr((known.upper_m.shape, _millimetres(lattice).tolist())).encode())
    digest.update(_millimetres(known.upper_m).astype("<i8").tobytes())
    for cells in (known.seen, known.firm):
        digest.update(np.packbits(cells).tobytes())
    if known.guess_m is not None:
        digest.update(_millimetres(known.guess_m).astype("<i8").tobytes())
    return digest.hexdigest()


def _millimetres(lengths_m: ArrayLike) -> NDArray[np.int64]:
    """Whole ones; of what is infinite, none that a length could have."""
    lengths = np.asarray(lengths_m, dtype=np.float64)
    known = np.isfinite(lengths)
    return np.where(known, np.rint(np.where(known, lengths, 0.0) * 1e3), _NO_LENGTH).astype(
        np.int64
    )
