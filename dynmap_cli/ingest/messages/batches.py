"""Serialized messages, many at a time, into the columns of a raw recording; the same as `ros_messages`, one by one."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from dynmap_cli.arrays import B1, F64, I64
from dynmap_cli.ingest.messages.blocks import Block, joined, packed
from dynmap_cli.ingest.messages.kinds import LASER_TYPES, TRANSFORM_TYPES
from dynmap_cli.ingest.messages.layouts import MOST_TRANSFORMS, Layout, has_layout, layout_of
from dynmap_cli.ingest.messages.namespaces import namespace_of
from dynmap_cli.ingest.messages.ros_messages import (
    LEAST_QUATERNION,
    LONGEST_SWEEP_S,
    MOST_QUATERNION,
    Message,
    note_degrees,
    plain_frame,
    shape_of_angles,
    take_message,
)
from dynmap_cli.ingest.raw.laser import ScanShape
from dynmap_cli.ingest.raw.plausible import FARTHEST_M, are_stamps
from dynmap_cli.ingest.raw.recording import RawOdometry, RawRecording, RawTransform

_BATCH, _BATCH_BYTES = 2048, 1 << 20
_MOST_LAYOUTS = 32
MOST_MESSAGE_BYTES = 1 << 24
"""Four million beams, or a hundred thousand transforms; clouds, which may be larger, are read elsewhere."""
_LEAST_RUN = 8
_ANGLES_AND_LIMITS = [0, 1, 2, 5, 6]
_TIME_INCREMENT = 3


class Batches:
    """Takes messages in the order of their recording, and reads them when there are enough.

    Parameters
    ----------
    recording : RawRecording
        Where what is read goes.
    decode : callable
        (topic, message type, time of recording, data) -> messages of ROS, or nothing where they are broken, which it
        counts. For messages whose fields do not lie as usual.
    usual_types : set of str
        Message types that are defined as usual in this recording.
    is_cdr : bool
        Encoded as in ROS 2 rather than as in ROS 1.
    """

    def __init__(
        self,
        recording: RawRecording,
        decode: Callable[[str, str, int, bytes], list[Message]],
        usual_types: Collection[str],
        *,
        is_cdr: bool,
    ) -> None:
        self._recording, self._decode, self._is_cdr = recording, decode, is_cdr
        self._usual = {kind for kind in usual_types if has_layout(kind)}
        self._channels: dict[tuple[str, str], int] = {}
        self._names: list[tuple[str, str]] = []
        # Channels that are read together, in the order in which the first message of each came.
        self._keys: dict[tuple[str, str], list[int]] = {}
        self._layouts: dict[tuple[str, int], list[Layout]] = {}
        self._waiting: list[Block] = []
        self._n_messages = self._n_bytes = 0

    def number_of(self, topic: str, message_type: str) -> int:
        """Number of a topic and type, by which blocks name it."""
        number = self._channels.get((topic, message_type))
        if number is None:
            number = self._channels[topic, message_type] = len(self._names)
            self._names.append((topic, message_type))
        return number

    def add(self, block: Block) -> None:
        """Take messages."""
        block = self._of_sane_size(block)
        if not block.starts.size:
            return
        seen, first = np.unique(block.channels, return_index=True)
        alone = []
        for number in seen[np.argsort(first)].tolist():
            topic, message_type = self._names[number]
            if message_type not in self._usual:
                alone.append(number)
                continue
            # Transforms of all topics go together, for the first one of a pair of frames counts.
            key = message_type, "" if message_type in TRANSFORM_TYPES else topic
            together = self._keys.setdefault(key, [])
            if number not in together:
                together.append(number)
        if alone:
            is_alone = np.isin(block.channels, alone)
            for row in np.flatnonzero(is_alone).tolist():
                self._take_alone(block, row)
            block = block.picked(~is_alone)
        self._waiting.append(block)
        self._n_messages += block.starts.size
        self._n_bytes += block.content.size
        if self._n_messages >= _BATCH or self._n_bytes >= _BATCH_BYTES:
            self.finish()

    def _of_sane_size(self, block: Block) -> Block:
        """Messages without those that are larger than any laser sends: they would take many times their size."""
        is_sane = block.sizes <= MOST_MESSAGE_BYTES
        for number in block.channels[~is_sane].tolist():
            topic, _ = self._names[number]
            self._recording.drop_broken(f"message on {topic} of more than {MOST_MESSAGE_BYTES >> 20} MiB")
        return block if is_sane.all() else packed(block.picked(is_sane))

    def finish(self) -> None:
        """Read what is waiting."""
        if not self._waiting:
            return
        block = joined(self._waiting)
        self._waiting.clear()
        self._n_messages = self._n_bytes = 0
        for numbers in self._keys.values():
            is_mine = block.channels == numbers[0]
            for number in numbers[1:]:
                is_mine |= block.channels == number
            if is_mine.any():
                self._take(self._names[numbers[0]][1], block.picked(is_mine))

    def _take_alone(self, block: Block, row: int) -> None:
        """Read one message with the library."""
        topic, message_type = self._names[int(block.channels[row])]
        for message in self._decode(topic, message_type, int(block.logged_ns[row]), block.data_of(row)):
            take_message(self._recording, message)

    def _take(self, message_type: str, block: Block) -> None:
        """Read messages of one type; one by one where few that follow one another lie alike."""
        owner, groups = self._sorted(message_type, block)
        starts = np.flatnonzero(np.diff(owner, prepend=-2) != 0)
        is_transform = message_type in TRANSFORM_TYPES
        is_mixed = not is_transform and starts.size > max(1, owner.size // _LEAST_RUN)
        if is_mixed or (owner < 0).any():
            for row in range(owner.size):
                self._take_alone(block, row)
            return
        self._recording.n_read += owner.size
        timely = are_stamps(block.logged_ns)
        topics = [self._names[number][0] for number in block.channels[~timely].tolist()]
        for topic in topics:
            self._recording.dropped[f"message on {topic} recorded at no possible time"] += 1
        if is_transform:
            self._take_transforms(groups, block, timely)
            return
        take = _take_scans if message_type in LASER_TYPES else _take_odometry
        topic = self._names[int(block.channels[0])][0]
        for start, end in zip(starts.tolist(), [*starts[1:].tolist(), owner.size], strict=True):
            run = slice(start, end)
            take(self._recording, _Batch(groups[owner[start]].layout, block.picked(run), topic, timely[run]))

    def _sorted(self, message_type: str, block: Block) -> tuple[I64, list[_Group]]:
        """Messages that lie alike, and to which of these groups each (n,) belongs; -1 = none."""
        owner = np.full(block.sizes.size, -1)
        groups: list[_Group] = []
        for size in np.unique(block.sizes).tolist():
            rows = np.flatnonzero(block.sizes == size)
            messages = block.picked(rows)
            left = np.ones(rows.size, dtype=bool)
            for layout in self._layouts_for(message_type, messages, left):
                found = left & layout.fits(messages)
                if found.any():
                    owner[rows[found]] = len(groups)
                    groups.append(_Group(layout, rows[found]))
                    left &= ~found
        return owner, groups

    def _layouts_for(self, message_type: str, messages: Block, left: B1) -> Iterator[Layout]:
        """Yield the layouts that are known for messages of a length, then those of messages (n,) that are left."""
        known = self._layouts.setdefault((message_type, int(messages.sizes[0])), [])
        for layout in known:
            if not left.any():
                return
            yield layout
        while left.any() and len(known) < _MOST_LAYOUTS:
            data = messages.data_of(int(np.argmax(left)))
            try:
                known.append(layout_of(data, message_type, is_cdr=self._is_cdr))
            except ValueError:
                return
            yield known[-1]

    def _take_transforms(self, groups: list[_Group], block: Block, timely: B1) -> None:
        """Keep the transforms of tf messages, those of a pair of frames in the order of the messages."""
        found: dict[tuple[str, str, str], list[tuple[I64, I64, I64, F64]]] = {}
        for group in groups:
            for space, rows in self._by_namespace(block, group.rows[timely[group.rows]]):
                messages = block.picked(rows)
                for number, part in enumerate(group.layout.parts):
                    places = rows * MOST_TRANSFORMS + number
                    stamps_ns = group.layout.stamps_ns(messages, part)
                    values = group.layout.pose_values(messages, part)
                    found.setdefault((space, part.frame, part.child), []).append(
                        (places, stamps_ns, messages.logged_ns, values)
                    )
        for key, pieces in found.items():
            places = np.concatenate([piece[0] for piece in pieces])
            if places.size == 0:
                continue
            order = np.argsort(places)
            kept = self._recording.transforms_read.get(key)
            if kept is None:
                first = int(block.channels[int(places[order[0]]) // MOST_TRANSFORMS])
                is_static = self._names[first][0].endswith("tf_static")
                kept = self._recording.transforms_read[key] = RawTransform(is_static)
            kept.add_many(
                np.concatenate([piece[1] for piece in pieces])[order],
                np.concatenate([piece[2] for piece in pieces])[order],
                np.concatenate([piece[3] for piece in pieces])[order],
            )

    def _by_namespace(self, block: Block, rows: I64) -> Iterator[tuple[str, I64]]:
        """Yield the namespaces of the topics of messages, and which of them are in each."""
        channels = block.channels[rows]
        spaces = {number: namespace_of(self._names[number][0]) for number in np.unique(channels).tolist()}
        for space in sorted(set(spaces.values())):
            within = [number for number in spaces if spaces[number] == space]
            yield space, rows if len(within) == len(spaces) else rows[np.isin(channels, within)]


@dataclass(frozen=True, slots=True)
class _Group:
    """Messages that lie alike: which they are (n,)."""

    layout: Layout
    rows: I64


@dataclass(frozen=True, slots=True)
class _Batch:
    """Messages of one topic that follow one another and lie alike.

    Attributes
    ----------
    layout : Layout
    messages : Block
    topic : str
    timely : (n,) bool
        Whether they were recorded at a possible time.
    """

    layout: Layout
    messages: Block
    topic: str
    timely: B1


def _take_scans(recording: RawRecording, batch: _Batch) -> None:
    """Keep sweeps."""
    topic, part = batch.topic, batch.layout.parts[0]
    if part.n_beams == 0:
        _drop(recording, f"scan on {topic} without beams", batch.timely)
        return
    values = batch.layout.scan_values(batch.messages, part)
    stamps_ns = batch.layout.stamps_ns(batch.messages, part)
    shapes, number = _shapes(values, part.n_beams)
    has_shape = np.array([shape is not None for shape in shapes])[number]
    has_stamp = are_stamps(stamps_ns)
    _drop(recording, f"scan on {topic} with angles that no laser has", batch.timely & ~has_shape)
    _drop(recording, f"scan on {topic} stamped with no possible time", batch.timely & has_shape & ~has_stamp)
    good = batch.timely & has_shape & has_stamp
    if not good.any():
        return
    note_degrees(recording, topic, float(values[0, 0]), float(values[0, 2]), part.n_beams)
    laser = recording.laser(topic, plain_frame(part.frame))
    interval_s = values[:, _TIME_INCREMENT].astype(np.float64)
    with np.errstate(all="ignore"):
        sweep_s = interval_s * part.n_beams
    interval_s[~((sweep_s >= 0.0) & (sweep_s <= LONGEST_SWEEP_S))] = math.nan
    # Shapes get their numbers in the order in which they come.
    table = np.zeros(len(shapes), dtype=np.int32)
    _, first = np.unique(number[good], return_index=True)
    for row in np.sort(first).tolist():
        shape = shapes[number[good][row]]
        if shape is not None:
            table[number[good][row]] = laser.number_of(shape)
    ranges_m = batch.layout.ranges_m(batch.messages, part)
    laser.add_many(
        stamps_ns[good],
        batch.messages.logged_ns[good],
        ranges_m if good.all() else ranges_m[good],
        table[number[good]],
        interval_s[good],
    )


def _shapes(values: Any, n_beams: int) -> tuple[list[ScanShape | None], I64]:
    """The shapes that occur, and which of them each row (n,) has."""
    bits = np.ascontiguousarray(values[:, _ANGLES_AND_LIMITS]).view(np.uint32)
    if (bits == bits[0]).all():
        kinds, number = bits[:1], np.zeros(bits.shape[0], dtype=np.int64)
    else:
        kinds, number = np.unique(bits, axis=0, return_inverse=True)
        number = number.ravel()
    return [shape_of_angles(*row, n_beams) for row in kinds.view(np.float32).tolist()], number


def _take_odometry(recording: RawRecording, batch: _Batch) -> None:
    """Keep odometry poses, projected to the plane."""
    topic, part = batch.topic, batch.layout.parts[0]
    values = batch.layout.pose_values(batch.messages, part)
    stamps_ns = batch.layout.stamps_ns(batch.messages, part)
    poses = np.column_stack([values[:, :2], _yaws(values[:, 3:])])
    is_good = (np.abs(poses) <= FARTHEST_M).all(axis=1) & are_stamps(stamps_ns)
    _drop(recording, f"odometry on {topic} that is no pose or has no possible time", batch.timely & ~is_good)
    good = batch.timely & is_good
    if not good.any():
        return
    track = recording.odometry.get(topic)
    if track is None:
        track = RawOdometry(topic, plain_frame(part.frame), plain_frame(part.child))
        recording.odometry[topic] = track
    track.add_many(stamps_ns[good], batch.messages.logged_ns[good], poses[good])


def _yaws(quaternions: F64) -> F64:
    """(n,) headings of quaternions (n, 4) x, y, z, w; NaN where one is no rotation."""
    x, y, z, w = quaternions.T
    with np.errstate(all="ignore"):
        length = x * x + y * y + z * z + w * w
        sine = 2.0 * (w * z + x * y)
        cosine = w * w + x * x - y * y - z * z
    # The arctangent of numpy differs in the last bit from one processor to another.
    yaw = np.array(list(map(math.atan2, sine.tolist(), cosine.tolist())), dtype=np.float64)
    yaw[~((length >= LEAST_QUATERNION) & (length <= MOST_QUATERNION))] = math.nan
    return yaw


def _drop(recording: RawRecording, why: str, mask: B1) -> None:
    """Count messages that are left out."""
    count = int(np.count_nonzero(mask))
    if count:
        recording.dropped[why] += count
