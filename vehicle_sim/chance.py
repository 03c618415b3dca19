"""Randomness: one generator for each purpose, so that a new use never disturbs an old one."""

import zlib

import numpy as np


def generator(seed: int, purpose: str) -> np.random.Generator:
    """The generator of one purpose, for example "hardware id"; the same for the same seed."""
    return np.random.default_rng([seed, zlib.crc32(purpose.encode())])
