"""Many serialized messages of one kind at a time: where their fields lie is found once, then read of all of them.

Messages of one topic mostly differ in numbers only: names of frames and counts of beams stay. The first of them is
walked through field by field, which gives a `Layout`: the place of each field, and the bytes that must be the same in
another message for the same places to hold (counts and names). Messages that have these bytes, and that length, are
read as columns. Anything odd raises ValueError, so that the library for such messages can say what is wrong with it.

CDR (ROS 2, little endian, XCDR1): 4 bytes of header, then fields aligned to their size, strings end with a null.
ROS 1: no header, no alignment, strings without a null, a header has a sequence number before its stamp.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynmap_cli.arrays import B1, F32, F64, I64, U8
from dynmap_cli.ingest.messages.blocks import Block
from dynmap_cli.ingest.messages.kinds import LASER_TYPES, ODOMETRY_TYPES, TRANSFORM_TYPES

_U32 = struct.Struct("<I")
_CDR_HEADER, _CDR_PADDING = b"\x00\x01\x00\x00", 3
MOST_TRANSFORMS = 1000
"""No tf message holds so many."""

_WIDEST_GAP = 128
_POSE_F64, _ODOMETRY_F64 = 7, 7 + 36 + 6 + 36


@dataclass(frozen=True, slots=True)
class Stamped:
    """A stamp, names of frames, and numbers, somewhere in a message.

    Attributes
    ----------
    stamp_at : int
    frame, child : str
    values_at : int
        Seven float32 of a scan (angle_min, angle_max, angle_increment, time_increment, scan_time, range_min,
        range_max), or seven float64 of a pose (x, y, z, qx, qy, qz, qw).
    ranges_at, n_beams : int
        Of a scan.
    """

    stamp_at: int
    frame: str
    child: str
    values_at: int
    ranges_at: int = 0
    n_beams: int = 0


@dataclass(frozen=True, slots=True)
class Layout:
    """Where the fields of messages of one length lie.

    Attributes
    ----------
    spans : tuple of (int, (n_bytes,) uint8, (n_bytes,) uint8)
        Where bytes stand that must be the same; these bytes, and 255 for each that must be, 0 for those between them.
    parts : tuple of Stamped
        One, or the transforms of a tf message.
    """

    spans: tuple[tuple[int, U8, U8], ...]
    parts: tuple[Stamped, ...]

    def fits(self, messages: Block) -> B1:
        """(n,) which messages of the length of this layout have it."""
        fitting = np.ones(messages.starts.size, dtype=bool)
        for start, wanted, is_fixed in self.spans:
            differs = (messages.columns(start, wanted.size) ^ wanted) & is_fixed
            if differs.any():
                fitting &= ~differs.any(axis=1)
        return fitting

    @staticmethod
    def stamps_ns(messages: Block, part: Stamped) -> I64:
        """(n,) nanoseconds; seconds have a sign, as in ROS 2, for ROS 1 has none that reach so far."""
        words = messages.columns(part.stamp_at, 8)
        seconds, rest = words.view("<i4")[:, 0].astype(np.int64), words.view("<u4")[:, 1].astype(np.int64)
        return np.asarray(seconds * 10**9 + rest)

    @staticmethod
    def scan_values(messages: Block, part: Stamped) -> F32:
        """(n, 7) angles, times and limits."""
        return _numbers(messages, part.values_at, "<f4", 7)

    @staticmethod
    def ranges_m(messages: Block, part: Stamped) -> F32:
        """(n, n_beams) as recorded."""
        return _numbers(messages, part.ranges_at, "<f4", part.n_beams)

    @staticmethod
    def pose_values(messages: Block, part: Stamped) -> F64:
        """(n, 7) place and quaternion."""
        return _numbers(messages, part.values_at, "<f8", _POSE_F64)


def _numbers(messages: Block, place: int, dtype: str, count: int) -> NDArray[Any]:
    """Numbers (n, count) that stand at one place in all messages."""
    return messages.columns(place, count * np.dtype(dtype).itemsize).view(dtype).reshape(-1, count)


def layout_of(data: bytes, message_type: str, *, is_cdr: bool) -> Layout:
    """Find the layout of one message, of one of the types of scans, odometry and transforms of ROS.

    Raises
    ------
    ValueError
        If it is not a whole message of that type, or of another encoding.
    """
    walk = _Walk(data, is_cdr=is_cdr)
    try:
        parts = _WALKS[message_type](walk)
    except (struct.error, UnicodeDecodeError) as err:
        msg = "it is cut off, or a name is broken"
        raise ValueError(msg) from err
    walk.end()
    return Layout(tuple(_spans(walk.fixed)), parts)


def _spans(fixed: list[tuple[int, bytes]]) -> Iterator[tuple[int, U8, U8]]:
    """Put bytes that must be the same, with their places in ascending order, together where little lies between."""
    first = 0
    for last, (place, word) in enumerate(fixed):
        end = place + len(word)
        if last + 1 < len(fixed) and fixed[last + 1][0] - end <= _WIDEST_GAP:
            continue
        start = fixed[first][0]
        wanted, is_fixed = np.zeros((2, end - start), dtype=np.uint8)
        for at, known in fixed[first : last + 1]:
            wanted[at - start : at - start + len(known)] = np.frombuffer(known, dtype=np.uint8)
            is_fixed[at - start : at - start + len(known)] = 255
        first = last + 1
        yield start, wanted, is_fixed


def has_layout(message_type: str) -> bool:
    """Whether messages of a type can be read so."""
    return message_type in _WALKS


class _Walk:
    """Goes through one message, and notes what must be the same in others."""

    def __init__(self, data: bytes, *, is_cdr: bool) -> None:
        self.fixed: list[tuple[int, bytes]] = []
        self._data, self._is_cdr = data, is_cdr
        self._start = self._at = len(_CDR_HEADER) if is_cdr else 0
        if is_cdr:
            if data[: self._start] != _CDR_HEADER:
                msg = "another encoding"
                raise ValueError(msg)
            self.fixed.append((0, _CDR_HEADER))

    def skip(self, size: int, count: int = 1) -> int:
        """Pass over numbers; returns where they begin."""
        if self._is_cdr:
            self._at += -(self._at - self._start) % size
        place = self._at
        self._at += size * count
        return place

    def count(self) -> int:
        """A count."""
        place = self.skip(4)
        (value,) = _U32.unpack_from(self._data, place)
        self.fixed.append((place, self._data[place : place + 4]))
        return int(value)

    def text(self) -> str:
        """A name."""
        size = self.count()
        word = self._data[self._at : self._at + size]
        self.fixed.append((self._at, word))
        self._at += size
        if self._is_cdr:
            if word[-1:] != b"\0":
                msg = "a name does not end"
                raise ValueError(msg)
            word = word[:-1]
        return word.decode()

    def header(self) -> tuple[int, str]:
        """Where the stamp is, and the frame."""
        if not self._is_cdr:
            self.skip(4)
        place = self.skip(4, 2)
        return place, self.text()

    def end(self) -> None:
        """Refuse a message that is shorter or longer than its fields."""
        rest = len(self._data) - self._at
        if not 0 <= rest <= (_CDR_PADDING if self._is_cdr else 0):
            msg = "it has another length than its fields"
            raise ValueError(msg)


def _walk_scan(walk: _Walk) -> tuple[Stamped, ...]:
    """sensor_msgs/LaserScan: header, seven float32, ranges, intensities."""
    stamp_at, frame = walk.header()
    values_at = walk.skip(4, 7)
    n_beams = walk.count()
    ranges_at = walk.skip(4, n_beams) if n_beams else 0
    walk.skip(4, walk.count())
    return (Stamped(stamp_at, frame, "", values_at, ranges_at, n_beams),)


def _walk_odometry(walk: _Walk) -> tuple[Stamped, ...]:
    """nav_msgs/Odometry: header, child frame, pose and twist with their covariances."""
    stamp_at, frame = walk.header()
    child = walk.text()
    return (Stamped(stamp_at, frame, child, walk.skip(8, _ODOMETRY_F64)),)


def _walk_transforms(walk: _Walk) -> tuple[Stamped, ...]:
    """tf2_msgs/TFMessage: any number of header, child frame, translation and rotation."""
    count = walk.count()
    if count >= MOST_TRANSFORMS:
        msg = "too many transforms"
        raise ValueError(msg)
    parts = []
    for _ in range(count):
        stamp_at, frame = walk.header()
        child = walk.text()
        parts.append(Stamped(stamp_at, frame, child, walk.skip(8, _POSE_F64)))
    return tuple(parts)


_WALKS: dict[str, Callable[[_Walk], tuple[Stamped, ...]]] = {
    **dict.fromkeys(LASER_TYPES - {"sensor_msgs/msg/MultiEchoLaserScan"}, _walk_scan),
    **dict.fromkeys(ODOMETRY_TYPES, _walk_odometry),
    **dict.fromkeys(TRANSFORM_TYPES, _walk_transforms),
}
