"""A known map as bytes (numpy's compressed .npz), and back."""

import io

import numpy as np

from companion.world.known_map import KnownMap


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
