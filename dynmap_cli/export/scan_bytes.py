"""Where in a serialized LaserScan the ranges are, so that some can be replaced and every other byte stays.

    LaserScan           header, 7 x float32, float32[] ranges, float32[] intensities
    MultiEchoLaserScan  header, 7 x float32, LaserEcho[] ranges, LaserEcho[] intensities; LaserEcho = float32[] echoes

`cdr` (ROS 2) starts with four bytes that name the byte order, and aligns; `ros1` is little-endian and packed, and its
header begins with a number.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import B1, F32, I64
from dynmap_cli.errors import LogError

MULTI_ECHO = "sensor_msgs/msg/MultiEchoLaserScan"
_ENCAPSULATION, _WORD = 4, 4
_SINGLE_NUMBERS = 7


@dataclass(frozen=True, slots=True)
class ScanBytes:
    """A serialized scan, taken apart as far as needed.

    Attributes
    ----------
    data : bytes
        The whole message.
    stamp_ns : int
        Of its header.
    order : str
        "<" little-endian or ">" big-endian.
    offsets : (n_beams,) int64
        Where the first echo of each beam is; -1 = the beam has none.
    echoes : (n_beams,) int64
        How many follow one another there; always 1 in a LaserScan.
    end : int
        Where the ranges end and the intensities begin.
    is_multi_echo : bool
    """

    data: bytes
    stamp_ns: int
    order: str
    offsets: I64
    echoes: I64
    end: int
    is_multi_echo: bool

    @property
    def first_echoes_m(self) -> F32:
        """(n_beams,) ranges; +inf where a beam has no echo."""
        ranges = np.full(self.offsets.size, np.inf, dtype=np.float32)
        has_echo = self.offsets >= 0
        words = np.frombuffer(self.data, dtype=np.uint8)[_bytes_of(self.offsets[has_echo])]
        ranges[has_echo] = words.view(f"{self.order}f4").ravel()
        return ranges

    def without(self, removed: B1) -> bytes:
        """The message with NaN for all echoes of the removed beams (n_beams,), else byte for byte the same."""
        first, count = self.offsets[removed], self.echoes[removed]
        before = np.repeat(np.cumsum(count) - count, count)
        offsets = np.repeat(first, count) + _WORD * (np.arange(before.size) - before)
        changed = np.frombuffer(self.data, dtype=np.uint8).copy()
        changed[_bytes_of(offsets)] = np.frombuffer(struct.pack(f"{self.order}f", np.nan), dtype=np.uint8)
        return changed.tobytes()

    def with_intensities(self, values: F32) -> bytes:
        """The message with *values* (n_beams,) in place of its intensities."""
        head = self.data[: self.end] + struct.pack(f"{self.order}I", values.size)
        if not self.is_multi_echo:
            return head + values.astype(f"{self.order}f4").tobytes()
        return head + b"".join(struct.pack(f"{self.order}If", 1, value) for value in values.tolist())


def _bytes_of(offsets: I64) -> I64:
    """(n, 4) places of the bytes of numbers that begin at *offsets*."""
    return np.asarray(offsets[:, None] + np.arange(_WORD))


def parse_scan(data: bytes, encoding: str, message_type: str) -> ScanBytes:
    """Find stamp and ranges in a message of encoding "cdr" or "ros1".

    Raises
    ------
    LogError
        If the message is shorter than it says.
    """
    is_cdr, is_multi_echo = encoding == "cdr", message_type == MULTI_ECHO
    try:
        order = ">" if is_cdr and not data[1] & 1 else "<"
        at = _ENCAPSULATION
        seconds, nanoseconds = struct.unpack_from(f"{order}{'i' if is_cdr else 'I'}I", data, at)
        at += 2 * _WORD
        at += _WORD + struct.unpack_from(f"{order}I", data, at)[0]
        at += -at % _WORD if is_cdr else 0
        at += _SINGLE_NUMBERS * _WORD
        n_beams = struct.unpack_from(f"{order}I", data, at)[0]
        at += _WORD
        if n_beams * _WORD > len(data) - at:
            msg = f"{n_beams} beams in {len(data)} bytes"
            raise ValueError(msg)
        if is_multi_echo:
            offsets, echoes, end = _echoes(data, order, at, n_beams)
        else:
            offsets, end = at + _WORD * np.arange(n_beams), at + _WORD * n_beams
            echoes = np.ones(n_beams, dtype=np.int64)
    except (struct.error, IndexError, ValueError) as err:
        msg = f"a {message_type} message is cut off or damaged ({err})"
        raise LogError(msg) from err
    stamp_ns = seconds * 10**9 + nanoseconds
    return ScanBytes(data, stamp_ns, order, offsets, echoes, end, is_multi_echo)


def _echoes(data: bytes, order: str, at: int, n_beams: int) -> tuple[I64, I64, int]:
    """Offsets of the first echoes, their counts, and where the last one ends."""
    offsets = np.full(n_beams, -1, dtype=np.int64)
    echoes = np.zeros(n_beams, dtype=np.int64)
    for beam in range(n_beams):
        count = struct.unpack_from(f"{order}I", data, at)[0]
        at += _WORD
        if count * _WORD > len(data) - at:
            msg = f"{count} echoes in {len(data)} bytes"
            raise ValueError(msg)
        if count:
            offsets[beam], echoes[beam] = at, count
        at += _WORD * count
    return offsets, echoes, at
