"""Independent streams of random numbers, one per purpose, so that one part does not disturb another."""

from __future__ import annotations

import zlib

import numpy as np


def stream(seed: int, purpose: str) -> np.random.Generator:
    """Random numbers that depend on the seed and on what they are for."""
    return np.random.default_rng([seed, zlib.crc32(purpose.encode())])
