"""Recordings that rosbags refuses, read record by record: what is whole is used, what is lost is said."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

from dynmap_cli.ingest.containers.bag1_records import bag1_messages
from dynmap_cli.ingest.containers.bag_checks import UnreadableBagError
from dynmap_cli.ingest.containers.bag_folders import stated_messages
from dynmap_cli.ingest.containers.db3_rows import db3_messages
from dynmap_cli.ingest.containers.mcap_records import mcap_messages
from dynmap_cli.ingest.containers.type_stores import decode_message
from dynmap_cli.ingest.messages.batches import Batches
from dynmap_cli.ingest.messages.blocks import block_of
from dynmap_cli.ingest.messages.foxglove import as_ros
from dynmap_cli.ingest.messages.kinds import READ_TYPES, USED_TYPES
from dynmap_cli.ingest.messages.ros_messages import Message, decoding_failed, end_of_messages
from dynmap_cli.ingest.messages.stored import UNTIMELY, Channel, Losses, StoredMessage
from dynmap_cli.ingest.raw.plausible import is_stamp
from dynmap_cli.ingest.raw.recording import RawRecording, Topic, file_name
from dynmap_cli.ingest.refusals import damaged
from dynmap_cli.printable import printable

_ROS2_ENCODING = "cdr"
_ROS_ENCODINGS = frozenset({_ROS2_ENCODING, "ros1"})
_BYTES_AT_ONCE = 1 << 19
_READERS: dict[str, Callable[[Path, Losses], Iterator[StoredMessage]]] = {
    ".bag": bag1_messages,
    ".db3": db3_messages,
    ".mcap": mcap_messages,
}


def read_salvaged(
    path: Path, name: str, kind: str, refusal: UnreadableBagError, folder: Path | None = None
) -> RawRecording:
    """Read what is whole in a recording.

    Parameters
    ----------
    path : Path
        A .bag, .db3 or .mcap file, or a folder of the latter two.
    name, kind : str
        For messages: what the operator called it, and what it is.
    refusal : UnreadableBagError
        Why it could not be read with its index.
    folder : Path or None
        On which disk ranges lie that do not fit into memory.

    Raises
    ------
    LogError
        If no message can be read.
    """
    losses = Losses()
    recording = RawRecording(name, kind, folder=folder)
    reader = _Reader(recording)
    for message in stored_messages(path, losses):
        reader.take(message)
    reader.finish()
    counts = reader.counts
    # An MCAP file with other encodings than those of ROS 2 is refused for them, although nothing is wrong with it.
    is_foreign = path.suffix != ".bag" and not reader.encodings <= {_ROS2_ENCODING}
    is_new = not any(refusal.why in why for why in losses.why)
    if refusal.why and is_new and (losses.why or not is_foreign):
        losses.why.insert(0, refusal.why)
    if not counts:
        raise damaged(name, kind, UnreadableBagError(losses.why[0] if losses.why else "it holds no messages"))
    recording.topics = [
        Topic(topic, printable(msgtype), count) for (topic, msgtype), count in sorted(counts.items())
    ]
    if losses.why:
        line = losses.line(file_name(name), kind, counts.total(), reader.span.seconds)
        recording.warnings.append(line)
        recording.damage += losses.why
    return recording


def stored_messages(path: Path, losses: Losses) -> Iterator[StoredMessage]:
    """Yield the messages that are whole in a file, or in the files of a folder, as they were written."""
    if not path.is_dir():
        yield from _messages_of(path, losses)
        return
    files = sorted(
        (inner for inner in path.iterdir() if inner.suffix in _READERS and inner.is_file()),
        key=lambda inner: (len(inner.name), inner.name),
    )
    for file in files:
        part = Losses()
        try:
            yield from _messages_of(file, part)
        finally:
            losses.add(part, f"{printable(file.name)}: " if len(files) > 1 else "")
    losses.stated_messages = max(losses.stated_messages, stated_messages(path))


def _messages_of(file: Path, losses: Losses) -> Iterator[StoredMessage]:
    """The messages that are whole in one file."""
    try:
        for stored in _READERS[file.suffix](file, losses):
            if is_stamp(stored.logged_ns):
                yield stored
            else:
                losses.note(UNTIMELY, messages=1)
    except OSError as err:
        losses.note(str(err.strerror or err))


class Span:
    """Earliest and latest time of recording."""

    def __init__(self) -> None:
        self.first_ns: int | None = None
        self.last_ns = 0

    def add(self, stamp_ns: int) -> None:
        """Widen it to a time."""
        if is_stamp(stamp_ns):
            self.first_ns = stamp_ns if self.first_ns is None else min(self.first_ns, stamp_ns)
            self.last_ns = max(self.last_ns, stamp_ns)

    @property
    def seconds(self) -> float:
        """Length."""
        return 0.0 if self.first_ns is None else (self.last_ns - self.first_ns) * 1e-9


class _Reader:
    """Takes messages as they lie in a damaged recording; those of the types that are used are read many at a time.

    Attributes
    ----------
    counts : Counter
        All messages, by topic and type.
    span : Span
    encodings : set of str
    """

    def __init__(self, recording: RawRecording) -> None:
        self.counts: Counter[tuple[str, str]] = Counter()
        self.span = Span()
        self.encodings: set[str] = set()
        self._recording = recording
        self._batches: dict[str, Batches] = {}
        # A channel is new in each container, but its name and type are not.
        self._channels: dict[tuple[str, str, str], Channel] = {}
        self._waiting: dict[str, list[tuple[bytes, int, int]]] = {}
        self._n_bytes = 0

    def take(self, message: StoredMessage) -> None:
        """Take one message."""
        channel = message.channel
        encoding, kind = channel.message_encoding, channel.message_type
        if encoding not in READ_TYPES:
            kind = f"{channel.schema_name} ({printable(encoding) or 'no encoding'})"
        self.counts[channel.topic, kind] += 1
        self.span.add(message.logged_ns)
        self.encodings.add(encoding)
        if kind not in READ_TYPES.get(encoding, ()):
            return
        batches = self._batches.get(encoding)
        if batches is None:
            batches = self._batches[encoding] = self._new_batches(encoding)
        if self._channels.setdefault((encoding, channel.topic, kind), channel) != channel:
            # What is waiting may be of another definition.
            self._hand_over()
            self._channels[encoding, channel.topic, kind] = channel
        number = batches.number_of(channel.topic, kind)
        self._waiting.setdefault(encoding, []).append((message.data, number, message.logged_ns))
        self._n_bytes += len(message.data)
        if self._n_bytes > _BYTES_AT_ONCE:
            self._hand_over()

    def finish(self) -> None:
        """Read the rest."""
        self._hand_over()
        for batches in self._batches.values():
            batches.finish()
        end_of_messages(self._recording)

    def _hand_over(self) -> None:
        """Give what is waiting to who reads it."""
        for encoding, waiting in self._waiting.items():
            data, numbers, logged_ns = zip(*waiting, strict=True)
            self._batches[encoding].add(block_of(data, numbers, logged_ns))
        self._waiting, self._n_bytes = {}, 0

    def _new_batches(self, encoding: str) -> Batches:
        """Who reads messages of one encoding; types are as the standard defines them, whatever the recording says."""

        def decode(topic: str, kind: str, logged_ns: int, data: bytes) -> list[Message]:
            try:
                content = decode_message(self._channels[encoding, topic, kind], data)
                return as_ros(Message(topic, kind, logged_ns, content))
            except Exception as err:
                decoding_failed(self._recording, topic, err)
                return []

        usual = USED_TYPES if encoding in _ROS_ENCODINGS else set()
        return Batches(self._recording, decode, usual, is_cdr=encoding == _ROS2_ENCODING)
