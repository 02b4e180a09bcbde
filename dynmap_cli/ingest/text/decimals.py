"""Decimal numbers from text, thousands of lines at a time: range readings make up most of a text log."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray

from dynmap_cli.arrays import F64
from dynmap_cli.ingest.messages.blocks import columns_of

U64 = NDArray[np.uint64]

_SPACE, _DOT, _ZERO = ord(" "), ord("."), ord("0")
_LONGEST = 8
_KEPT = np.array([(1 << 64) - (1 << 8 * (_LONGEST - size)) for size in range(_LONGEST + 1)], dtype=np.uint64)
"""The last characters of a word of eight bytes, by their count."""
_EACH_DOT, _EACH_ONE, _EACH_TOP = (np.uint64(byte * 0x0101010101010101) for byte in (_DOT, 0x01, 0x80))
_POWERS = np.array([1.0] * 128 + [10.0 ** (_LONGEST - 1 - byte) for byte in range(_LONGEST)])
_PAIRS = (
    (np.uint64(0x0F0F0F0F0F0F0F0F), np.uint64(10 * 2**8 + 1), np.uint64(8)),
    (np.uint64(0x00FF00FF00FF00FF), np.uint64(100 * 2**16 + 1), np.uint64(16)),
    (np.uint64(0x0000FFFF0000FFFF), np.uint64(10000 * 2**32 + 1), np.uint64(32)),
)


def parse_decimals(text: bytes) -> F64:
    """Numbers (n,) of a text in which they stand between spaces.

    Plain decimals of up to eight characters, such as `81.83`, are read eight characters at a time for all numbers at
    once; the quotient of two exact numbers is the nearest double. Anything else goes to numpy's reader.

    Raises
    ------
    ValueError
        If something is not a number.
    """
    characters = np.frombuffer(b" " * _LONGEST + text + b" ", dtype=np.uint8)
    is_space = characters <= _SPACE
    if not (is_space | (characters - np.uint8(_ZERO) <= 9) | (characters == _DOT)).all():
        return parse_numbers(text)
    bounds = np.flatnonzero(is_space[1:] != is_space[:-1]) + 1
    starts, ends = bounds[::2], bounds[1::2]
    sizes = ends - starts
    if int(sizes.max(initial=0)) > _LONGEST:
        return parse_numbers(text)
    # Eight characters that end with the number, the last one highest; those before the number are cleared.
    words = columns_of(characters, ends - _LONGEST, _LONGEST).view("<u8")[:, 0] & _KEPT[sizes]
    dots = _dots_of(words)
    has_dot = dots != 0
    if (dots & (dots - np.uint64(1))).any() or (has_dot & (sizes == 1)).any():
        msg = "not a number"
        raise ValueError(msg)
    # What stands before the dot takes its place.
    ones = dots >> np.uint64(7)
    before = np.where(has_dot, ones - np.uint64(1), np.uint64(0))
    words = ((words & before) << np.uint64(8)) | (words & ~(before | (ones * np.uint64(0xFF))))
    for mask, factor, shift in _PAIRS:
        words &= mask
        words *= factor
        words >>= shift
    # The exponent of a power of two says where the dot is.
    places = dots.astype(np.float64).view(np.int64) >> 55
    return np.asarray(words.astype(np.float64) / _POWERS[places])


def _dots_of(words: U64) -> U64:
    """The highest bit of each byte that is a dot, of words (n,) of digits, dots and nulls."""
    different = words ^ _EACH_DOT
    return np.asarray((different - _EACH_ONE) & ~different & _EACH_TOP)


def parse_numbers(text: bytes) -> F64:
    """Numbers (n,) of any spelling; ValueError if something is not a number."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        try:
            return np.fromstring(text, dtype=np.float64, sep=" ")
        except (ValueError, DeprecationWarning) as err:
            msg = "not a number"
            raise ValueError(msg) from err
