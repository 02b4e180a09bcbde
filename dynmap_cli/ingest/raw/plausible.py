"""Bounds beyond which a number in a recording is damage rather than a measurement; one place for all formats."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from dynmap_cli.arrays import B1, F32, F64, I64
from dynmap_cli.files.trajectory import parse_stamp

LATEST_NS = 2**62
"""The year 2116; sums and differences of two such stamps still fit into 64 bits."""
FARTHEST_M = 1e8
"""No coordinate of a robot is larger, not even in a global grid."""
LONGEST_RANGE_M = 1e4
"""No laser that sweeps a plane sees farther: larger readings are codes."""
MOST_TURN_RAD = 4.0 * math.pi
"""No sweep starts, or turns, farther than two full circles."""

_LEAST_DEG, _CIRCLE_DEG, _ASIDE = 60.0, 361.0, 0.4
_LONGEST_STAMP = 40
_MOST_SECONDS, _MOST_OF_TEN, _DECIMALS = 10, 3, 9
_LARGEST_F32 = float(np.finfo(np.float32).max)


def is_stamp(stamp_ns: int) -> bool:
    """Whether nanoseconds since the epoch are a time."""
    return 0 <= stamp_ns < LATEST_NS


def are_stamps(stamps_ns: I64) -> B1:
    """(n,) whether nanoseconds since the epoch are times."""
    return np.asarray((stamps_ns >= 0) & (stamps_ns < LATEST_NS))


def stamp_of_word(word: bytes) -> int:
    """Nanoseconds from decimal seconds; ValueError if they are no time."""
    if len(word) > _LONGEST_STAMP:
        msg = "a stamp that long"
        raise ValueError(msg)
    stamp_ns = parse_stamp(word.decode("ascii"))
    if not is_stamp(stamp_ns):
        msg = "a stamp out of range"
        raise ValueError(msg)
    return stamp_ns


def stamps_of_words(words: Sequence[bytes]) -> I64:
    """The same of many words (n,)."""
    size, dot = len(words[0]), words[0].find(b".")
    characters = np.frombuffer(b"".join(words), dtype=np.uint8)
    is_usual = 0 < dot <= _MOST_SECONDS and 0 < size - dot - 1 <= _DECIMALS
    if not is_usual or characters.size != size * len(words) or set(map(len, words)) != {size}:
        return np.array([stamp_of_word(word) for word in words], dtype=np.int64)
    digits = characters.reshape(-1, size) - np.uint8(ord("0"))
    digits[:, dot] = np.where(characters.reshape(-1, size)[:, dot] == ord("."), 0, 255)
    is_late = dot == _MOST_SECONDS and bool((digits[:, 0] > _MOST_OF_TEN).any())
    if is_late or (digits > 9).any():
        return np.array([stamp_of_word(word) for word in words], dtype=np.int64)
    powers = 10 ** np.array(
        [*range(_DECIMALS + dot - 1, _DECIMALS - 1, -1), 0, *range(_DECIMALS - 1, -1, -1)]
    )
    return np.asarray(digits.astype(np.int64) @ powers[:size])


def are_coordinates(values: tuple[float, ...]) -> bool:
    """Whether all are finite metres or radians of a plausible size."""
    return all(map(math.isfinite, values)) and min(values) >= -FARTHEST_M and max(values) <= FARTHEST_M


def is_sweep(first_bearing_rad: float, increment_rad: float, n_beams: int) -> bool:
    """Whether beams lie as those of a laser can: finite, within two circles, and not all in one direction."""
    turn_rad = abs(increment_rad) * (n_beams - 1)
    is_finite = math.isfinite(first_bearing_rad) and math.isfinite(turn_rad)
    is_spread = turn_rad > 0.0 or n_beams == 1
    return is_finite and is_spread and max(abs(first_bearing_rad), turn_rad) <= MOST_TURN_RAD


def are_degrees(first_bearing: float, increment: float, n_beams: int) -> bool:
    """Whether angles that are no sweep in radians are one in degrees: of 60 to 360, from 0 on or mostly ahead."""
    turn = increment * (n_beams - 1)
    is_ahead = first_bearing == 0.0 or abs(first_bearing + turn / 2.0) <= _ASIDE * abs(turn)
    return is_ahead and _LEAST_DEG <= abs(turn) <= _CIRCLE_DEG


def to_ranges_m(values: F64) -> F32:
    """As float32 (n,); what does not fit becomes the largest number that does, which no laser measures."""
    return np.clip(values, -_LARGEST_F32, _LARGEST_F32).astype(np.float32)
