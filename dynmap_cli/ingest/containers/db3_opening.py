"""Opening of a .db3 file: what rosbags finds out, without its two passes over all messages.

rosbags joins topics and messages to count them, for which SQLite builds and sorts an index first, then goes through
the times of all messages for a span that nobody asks for. It runs whatever is in the file; here the tables are looked
at first, and messages are counted in the table, where no index can hide them, or while they are read.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote

from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    MessageDefinition,
    MessageDefinitionFormat,
)
from rosbags.rosbag2 import metadata
from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from dynmap_cli.ingest.containers.db3_tables import (
    STEPS_AT_ONCE,
    TOO_LONG,
    WorkBound,
    bytes_behind,
    odd_indexes,
    odd_tables,
    odd_topics,
)
from dynmap_cli.ingest.messages.stored import words_of_rest

_WITH_PROFILES, _WITH_DEFINITIONS = 2, 4
"""Versions of the tables from which on they have these."""
_TABLES = "SELECT count(*) FROM sqlite_master WHERE type='table' AND name IN ('messages', 'topics')"
_DEFINITIONS = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions ORDER BY id"
_TOPICS = "SELECT id, name, type, serialization_format, {}, {} FROM topics ORDER BY id"
_COUNTS = "SELECT topic_id, count(*) FROM messages NOT INDEXED GROUP BY topic_id"
_SOME = "SELECT topic_id, count(*) FROM messages NOT INDEXED WHERE rowid IN ({}) GROUP BY topic_id"
_LOOKED_AT = 256
_NUMBERS = "SELECT (SELECT min(rowid) FROM messages), (SELECT max(rowid) FROM messages)"
_FORMATS = {
    "": MessageDefinitionFormat.NONE,
    "ros2msg": MessageDefinitionFormat.MSG,
    "ros2idl": MessageDefinitionFormat.IDL,
}


class Db3Reader(Sqlite3Reader):
    """Gives the messages as its base does; how many there are of a topic is estimated until they have been counted.

    Parameters
    ----------
    path : Path
    is_part : bool
        Of a folder whose metadata.yaml says with what profiles topics were offered; they have none then.
    """

    def __init__(self, path: Path, *, is_part: bool = False) -> None:
        # The base makes an address of the path, also of one like `50%.db3`.
        super().__init__(Path(quote(str(path))))
        self._file = path
        self._is_part = is_part
        self._counts: Mapping[Any, int] | None = None

    @contextmanager
    def bounded(self) -> Iterator[Any]:
        """Give the database for queries, which may take no longer than a file of its size takes.

        Raises
        ------
        ReaderError
            If they would take longer.
        """
        database: Any = self.dbconn
        bound = WorkBound(self._file)
        database.set_progress_handler(bound, STEPS_AT_ONCE)
        try:
            yield database
        except Exception as err:
            if bound.is_over:
                raise ReaderError(TOO_LONG) from err
            raise
        finally:
            database.set_progress_handler(None)

    def count(self) -> None:
        """Count the messages of each topic, unless that was done.

        Raises
        ------
        ReaderError
            If an index leaves out some of them.
        """
        if self._counts is None:
            with self.bounded() as database:
                counts = dict(database.execute(_COUNTS))
                _refuse(odd_indexes(database, sum(counts.values())))
            self._note(counts)

    def take_counts(self, counts: Mapping[Any, int]) -> None:
        """Take over how many messages of each topic were read.

        Raises
        ------
        ReaderError
            If there are others, which an index left out.
        """
        if self._counts is not None:
            return
        with self.bounded() as database:
            _, n_rows = _numbers(database)
        # Numbers without a gap say how many rows the table has without going through it.
        if sum(counts.values()) == n_rows:
            self._note(counts)
        else:
            self.count()

    def _note(self, counts: Mapping[Any, int]) -> None:
        self._counts = counts
        self.connections = [one._replace(msgcount=counts.get(one.id, 0)) for one in self.connections]
        self.metadata = self.metadata._replace(message_count=sum(counts.values()))

    def _open(self) -> None:
        """Fill in the topics if nothing is wrong."""
        with self.bounded() as database:
            self._fill_in(database)

    def _fill_in(self, database: Any) -> None:
        """Look at the tables before anything of them is read."""
        n_behind = bytes_behind(self._file)
        _refuse([*odd_tables(database).values(), *([words_of_rest(n_behind)] if n_behind else [])])
        ((n_tables,),) = database.execute(_TABLES)
        if n_tables != 2:
            _refuse(["its tables messages or topics are missing"])
        _refuse(odd_topics(database))
        self.schema = _version_of(database)
        definitions: dict[str, tuple[str, str]] = {}
        for kind, *written in database.execute(_DEFINITIONS) if self.schema >= _WITH_DEFINITIONS else ():
            definitions.setdefault(kind, (written[0], written[1]))
        about = _about(database)
        has_profiles = self.schema >= _WITH_PROFILES and not self._is_part
        profiles = "offered_qos_profiles" if has_profiles else "''"
        digest = "type_description_hash" if self.schema >= _WITH_DEFINITIONS else "''"
        self.connections = [
            Connection(
                number,
                topic,
                kind,
                _definition(*definitions.get(kind, ("", ""))),
                hashed,
                about.get(number, 0),
                ConnectionExtRosbag2(encoding, metadata.parse_qos(offered)),
                self,
            )
            for number, topic, kind, encoding, offered, hashed in database.execute(
                _TOPICS.format(profiles, digest)
            )
        ]


def _numbers(database: Any) -> tuple[int, int]:
    """The first number of a message, and how many there are from it to the last one."""
    ((first, last),) = database.execute(_NUMBERS)
    return (0, 0) if first is None else (first, last - first + 1)


def _about(database: Any) -> dict[Any, int]:
    """About how many messages each topic has, by some that are evenly spread; exactly where their numbers have gaps."""
    first, n_rows = _numbers(database)
    asked = [first + number * n_rows // _LOOKED_AT for number in range(_LOOKED_AT if n_rows else 0)]
    found: dict[Any, int] = dict(database.execute(_SOME.format(",".join("?" * len(asked))), asked))
    if sum(found.values()) < len(set(asked)):
        return dict(database.execute(_COUNTS))
    return {topic: count * n_rows // len(set(asked)) for topic, count in found.items()}


def _refuse(faults: Iterable[str]) -> None:
    """Refuse a file that has any fault.

    Raises
    ------
    ReaderError
    """
    told = "; ".join(faults)
    if told:
        raise ReaderError(told)


def use_db3_reader(reader: Any) -> None:
    """Let a reader that is not open yet, if it is one of a ROS 2 bag, read .db3 files with `Db3Reader`."""
    storage = getattr(reader, "storage", None)
    if isinstance(storage, Sqlite3Reader):
        reader.storage = Db3Reader(Path(str(storage.path)))
    elif isinstance(storage, DirectoryReader):
        own: Any = functools.partial(Db3Reader, is_part=True)
        storage.STORAGE_PLUGINS = {**storage.STORAGE_PLUGINS, "sqlite3": own}


def _definition(encoding: str, text: str) -> MessageDefinition:
    """Of a type; its encoding is only looked at where the type occurs."""
    return MessageDefinition(_FORMATS[encoding], text)


def _version_of(database: Any) -> int:
    """Version of the tables; those before the first that says it are told by their columns."""
    if list(database.execute("PRAGMA table_info(schema)")):
        for (version,) in database.execute("SELECT schema_version FROM schema"):
            return int(version)
        return -1
    columns = {row[1] for row in database.execute("PRAGMA table_info(topics)")}
    return _WITH_PROFILES if "offered_qos_profiles" in columns else 1
