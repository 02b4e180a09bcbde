"""Recordings that rosbags refuses, read record by record: what is whole is used, what is lost is said."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

from dynmap_cli.ingest.bag1_records import bag1_messages
from dynmap_cli.ingest.bags import UnreadableBagError, damaged, decode_message, decoding_failed
from dynmap_cli.ingest.db3_rows import db3_messages
from dynmap_cli.ingest.foxglove import as_ros
from dynmap_cli.ingest.kinds import READ_TYPES
from dynmap_cli.ingest.mcap_records import mcap_messages
from dynmap_cli.ingest.plausible import is_stamp
from dynmap_cli.ingest.raw import RawRecording, Topic, file_name
from dynmap_cli.ingest.ros_messages import Message, take_messages
from dynmap_cli.ingest.stored import Losses, StoredMessage
from dynmap_cli.printable import printable

_ROS2_ENCODING = "cdr"
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
    counts: Counter[tuple[str, str]] = Counter()
    span = Span()
    encodings: set[str] = set()
    take_messages(recording, _decoded(stored_messages(path, losses), recording, counts, span, encodings))
    # An MCAP file with other encodings than those of ROS 2 is refused for them, although nothing is wrong with it.
    is_foreign = path.suffix != ".bag" and not encodings <= {_ROS2_ENCODING}
    if refusal.why and refusal.why not in losses.why and (losses.why or not is_foreign):
        losses.why.insert(0, refusal.why)
    if not counts:
        raise damaged(name, kind, UnreadableBagError(losses.why[0] if losses.why else "it holds no messages"))
    recording.topics = [Topic(topic, msgtype, count) for (topic, msgtype), count in sorted(counts.items())]
    if losses.why:
        line = losses.line(file_name(name), kind, counts.total(), span.seconds)
        recording.warnings.append(line)
        recording.damage += losses.why
    return recording


def stored_messages(path: Path, losses: Losses) -> Iterator[StoredMessage]:
    """Yield the messages that are whole in a file, or in the files of a folder, as they were written."""
    files = [path]
    if path.is_dir():
        files = sorted(
            (inner for inner in path.iterdir() if inner.suffix in _READERS and inner.is_file()),
            key=lambda inner: (len(inner.name), inner.name),
        )
    try:
        for file in files:
            yield from _READERS[file.suffix](file, losses)
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


def _decoded(
    stored: Iterator[StoredMessage],
    recording: RawRecording,
    counts: Counter[tuple[str, str]],
    span: Span,
    encodings: set[str],
) -> Iterator[Message]:
    """Messages of the types that are used; all are counted, and their encodings noted."""
    for message in stored:
        channel = message.channel
        encoding, kind = channel.message_encoding, channel.message_type
        if encoding not in READ_TYPES:
            kind = f"{channel.schema_name} ({printable(encoding) or 'no encoding'})"
        counts[channel.topic, kind] += 1
        span.add(message.logged_ns)
        encodings.add(encoding)
        if kind not in READ_TYPES.get(encoding, ()):
            continue
        try:
            content = decode_message(channel, message.data)
            said = as_ros(Message(channel.topic, kind, message.logged_ns, content))
        except Exception as err:
            decoding_failed(recording, channel.topic, err)
            continue
        yield from said
