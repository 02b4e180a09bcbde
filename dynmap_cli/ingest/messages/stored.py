"""Messages as they lie in a container, and an account of what was lost of a damaged one."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

from dynmap_cli.files.damage import reason
from dynmap_cli.printable import printable

DAMAGE = (ValueError, LookupError, ArithmeticError, struct.error)
"""What taking broken bytes apart raises."""

ORPHAN = "message of no known topic"
UNTIMELY = "messages were recorded at no possible time"
_MOST_MISSING = 1 << 44
_MOST_SHOWN = 5


@dataclass(frozen=True, slots=True)
class Channel:
    """Where a message belongs: what a channel of an MCAP file and its schema say.

    Attributes
    ----------
    topic, message_encoding : str
        The encoding is "cdr", "ros1", "json", "protobuf" or another.
    schema_name, schema_encoding : str
        "" = no schema.
    schema_data : bytes
    metadata : tuple of (str, str)
    """

    topic: str
    message_encoding: str
    schema_name: str
    schema_encoding: str
    schema_data: bytes
    metadata: tuple[tuple[str, str], ...] = ()

    @property
    def message_type(self) -> str:
        """ROS 2 spelling of the type; names of other schemas as they are."""
        return ros2_spelling(self.schema_name)


def ros2_spelling(name: str) -> str:
    """A message type as ROS 2 names it, `sensor_msgs/msg/LaserScan`; names without a package as they are."""
    if "/" not in name:
        return name
    package, _, last = name.rpartition("/")
    return f"{package.removesuffix('/msg')}/msg/{last}"


class StoredMessage(NamedTuple):
    """A message as it lies in a container."""

    logged_ns: int
    published_ns: int
    sequence: int
    channel: Channel
    data: bytes


@dataclass(slots=True)
class Losses:
    """What could not be read.

    Attributes
    ----------
    why : list of str
        What is wrong with the container, in words, without repetition.
    n_bytes, lost_bytes : int
        Size of all files; bytes of them that were passed over.
    lost_chunks : int
        Blocks of messages that were passed over.
    lost_messages : int
        Messages that are known to be missing one by one.
    is_size_known : bool
        Whether the container says how long it was; not where it was never closed.
    stated_messages : int
        How many messages the container says that it holds; 0 where it does not.
    """

    why: list[str] = field(default_factory=list)
    n_bytes: int = 0
    lost_bytes: int = 0
    lost_chunks: int = 0
    lost_messages: int = 0
    is_size_known: bool = True
    stated_messages: int = 0

    def note(self, why: str, *, n_bytes: int = 0, chunks: int = 0, messages: int = 0) -> None:
        """Add a loss; what is wrong is said once."""
        if not any(why in known for known in self.why):
            self.why.append(why)
        self.lost_bytes += n_bytes
        self.lost_chunks += chunks
        self.lost_messages += messages

    def add(self, part: Losses, prefix: str) -> None:
        """Add what was lost of one file of several; the prefix says of which."""
        for why in part.why:
            self.note(f"{prefix}{why}")
        self.n_bytes += part.n_bytes
        self.lost_bytes += part.lost_bytes
        self.lost_chunks += part.lost_chunks
        self.lost_messages += part.lost_messages
        self.is_size_known &= part.is_size_known
        self.stated_messages += part.stated_messages

    def note_missing(self, n_bytes: int) -> None:
        """Add bytes that the container speaks of and that are not there."""
        if 0 < n_bytes < _MOST_MISSING:
            self.n_bytes += n_bytes
            self.note("its end is missing", n_bytes=n_bytes)

    def note_behind(self, n_bytes: int) -> None:
        """Add bytes behind the end of a container, as of a second one that was appended: they are not read."""
        if n_bytes > 0:
            self.note(words_of_rest(n_bytes), n_bytes=n_bytes)

    def line(self, name: str, kind: str, n_found: int, span_s: float) -> str:
        """Say it in one sentence, with numbers."""
        lost = [f"{self.lost_bytes} of {self.n_bytes} bytes"] if self.lost_bytes else []
        lost += [f"{self.lost_chunks} blocks of messages"] if self.lost_chunks else []
        lost += [f"{self.lost_messages} single messages"] if self.lost_messages else []
        if not lost and self.stated_messages > n_found:
            lost = [f"{self.stated_messages - n_found} messages"]
        return (
            f"{name}: this {kind} is cut off or damaged ({'; '.join(self.why[:3])}); recovered {n_found}"
            f"{self._of_how_many(n_found)} messages, up to t = {span_s:.1f} s, "
            f"lost {', '.join(lost) or 'no message that is known of'}"
        )

    def _of_how_many(self, n_found: int) -> str:
        """How many messages there were, as the container says, or going by the share of the bytes that is lost."""
        if self.stated_messages > n_found:
            return f" of {self.stated_messages}"
        left_bytes = self.n_bytes - self.lost_bytes
        nothing_lost = not (self.lost_bytes or self.lost_messages)
        if nothing_lost or left_bytes <= 0 or not self.is_size_known:
            return ""
        there_were = (n_found + self.lost_messages) * self.n_bytes / left_bytes
        two_digits = 10 ** max(len(str(int(there_were))) - 2, 0)
        return f" of about {max(round(there_were / two_digits) * two_digits, n_found)}"


def nameless_topics(topics: Iterable[tuple[object, object]]) -> list[str]:
    """What is wrong with topics of which name or type is no text; nothing checks that in the tables of a .db3."""
    rows = list(topics)
    n_nameless = sum(not isinstance(name, str) for name, _ in rows)
    untyped = [text_of(name) for name, kind in rows if not isinstance(kind, str)]
    left = f" and {len(untyped) - _MOST_SHOWN} others" if len(untyped) > _MOST_SHOWN else ""
    return [
        *([f"the name of {n_nameless} topics is no text"] if n_nameless else []),
        *([f"the type of {', '.join(untyped[:_MOST_SHOWN])}{left} is not known"] if untyped else []),
    ]


def text_of(value: object) -> str:
    """A name or type from a table, printable; what is no text is shown as well as it can be, "" where it is missing."""
    text = value.decode("utf-8", "backslashreplace") if isinstance(value, bytes) else value
    return "" if text is None else printable(str(text))


def words_of_encoding(topic: str) -> str:
    """What is wrong with a topic of a .db3 of which the encoding is no text."""
    return f"the encoding of {topic} is no text, and taken to be cdr"


def words_of_rest(n_bytes: int) -> str:
    """What is wrong with a container that goes on behind its end."""
    return f"{n_bytes} bytes behind its end are not read"


def words_of(err: BaseException) -> str:
    """What a library complains of, on one line."""
    return reason(err).rstrip(".")
