"""Random generators: one per purpose, so that a new use does not change an old sequence."""

import zlib

import numpy as np


def generator(seed: int, purpose: str) -> np.random.Generator:
    """The generator of one purpose, for example "hardware id"; the same for the same seed."""
    return np.random.default_rng([seed, zlib.crc32(purpose.encode())])
