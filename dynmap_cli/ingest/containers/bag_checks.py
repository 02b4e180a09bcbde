"""What is wrong with a bag that rosbags opens all the same, or would not come back from."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader

from dynmap_cli.ingest.containers.bag1_records import bag1_bytes_behind
from dynmap_cli.ingest.containers.db3_opening import Db3Reader
from dynmap_cli.ingest.containers.mcap_chunks import can_be_sorted
from dynmap_cli.ingest.containers.mcap_records import (
    BROKEN_SUMMARY,
    SummaryState,
    mcap_bytes_behind,
    summary_state,
)
from dynmap_cli.ingest.messages.stored import nameless_topics, words_of_encoding, words_of_rest
from dynmap_cli.printable import printable

_NOTHING_WRONG = ""


class UnreadableBagError(Exception):
    """A bag that rosbags refuses.

    Attributes
    ----------
    why : str
        What is wrong with it; "" for an MCAP file of a profile other than "ros2", with types named as in ROS 1,
        or of which too much overlaps, with which nothing is wrong.
    """

    def __init__(self, why: str) -> None:
        super().__init__(why)
        self.why = why


def check_file(file: Path) -> None:
    """Refuse an MCAP file whose summary is broken, or lies before the end of another one that was appended."""
    if file.suffix != ".mcap":
        return
    state = summary_state(file)
    if state is SummaryState.BROKEN:
        raise UnreadableBagError(BROKEN_SUMMARY)
    n_behind = mcap_bytes_behind(file) if state is SummaryState.UNKNOWN else 0
    if n_behind:
        raise UnreadableBagError(words_of_rest(n_behind))


def check_counts(reader: AnyReader) -> int:
    """Count the messages of .db3 files that nobody counted, and refuse a folder whose metadata.yaml hides some.

    Returns
    -------
    int
        How many rows are of topics that are not among those of their .db3, which no query gives.

    Raises
    ------
    ReaderError
        If an index of a .db3 leaves out messages.
    UnreadableBagError
        If the files of a folder hold a topic that its metadata.yaml leaves out: nobody would read its messages.
    """
    orphans = 0
    for inner in reader.readers:
        known = {(one.topic, one.msgtype) for one in inner.connections}
        for file in files_of(inner):
            if isinstance(file, Db3Reader):
                file.count()
                orphans += max(file.metadata.message_count - sum(one.msgcount for one in file.connections), 0)
            for one in file.connections:
                if one.msgcount and (one.topic, one.msgtype) not in known:
                    hidden = printable(str(one.topic))
                    msg = f"its metadata.yaml does not name {hidden}, of which its files hold messages"
                    raise UnreadableBagError(msg)
    return orphans


def check_topics(reader: AnyReader) -> None:
    """Refuse topics whose name, type or encoding is no text, or that have no number of messages.

    Nothing checks that in the tables of a .db3 and in a metadata.yaml.
    """
    for why in nameless_topics((one.topic, one.msgtype) for one in reader.connections):
        raise UnreadableBagError(why)
    for one in reader.connections:
        if not isinstance(getattr(one.ext, "serialization_format", ""), str):
            raise UnreadableBagError(words_of_encoding(one.topic))
        if type(one.msgcount) is not int or one.msgcount < 0:
            topic, count = printable(one.topic), printable(str(one.msgcount))
            msg = f"its metadata.yaml says that it holds '{count}' messages of {topic}, which is no number"
            raise UnreadableBagError(msg)


def check_index(reader: Any) -> None:
    """Refuse a ROS 1 bag that goes on behind its index, or whose index leaves out messages that its chunks hold."""
    chunks = getattr(reader, "chunk_infos", [])
    stated = sum(sum(chunk.connection_counts.values()) for chunk in chunks)
    indexed = sum(len(entries) for entries in getattr(reader, "indexes", {}).values())
    if chunks and stated != indexed:
        msg = f"its index has {indexed} messages, its chunks {stated}"
        raise UnreadableBagError(msg)
    n_behind = bag1_bytes_behind(reader.path) if chunks else 0
    if n_behind:
        raise UnreadableBagError(words_of_rest(n_behind))


def check_order(reader: Any) -> None:
    """Refuse MCAP files of which too much overlaps to be brought into order; nothing is wrong with them."""
    for file in files_of(reader):
        if not can_be_sorted(getattr(file, "chunks", [])):
            raise UnreadableBagError(_NOTHING_WRONG)


def files_of(inner: Any) -> list[Any]:
    """What reads each file of a ROS 2 bag; none of a ROS 1 bag."""
    outer = getattr(inner, "storage", None)
    return [] if outer is None else getattr(outer, "storages", [outer])


def missing_messages(reader: AnyReader) -> str:
    """Say by how much the files of a folder hold another number of messages than its metadata.yaml says; or ""."""
    readers: Any = reader.readers
    stated = sum(one.msgcount for inner in readers for one in inner.connections)
    files = [file for inner in readers for file in files_of(inner)]
    held = sum(file.metadata.message_count for file in files)
    return "" if held == stated else f"it says that it holds {stated} messages, and holds {held}"
