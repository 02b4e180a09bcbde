"""Opening of a .db3 file: what rosbags finds out, with one pass over its messages instead of two.

rosbags joins topics and messages to count them, for which SQLite builds and sorts an index first, then goes through
the times of all messages for a span that nobody asks for. It runs whatever is in the file; here the tables are looked
at first, and the rows that are counted are those of the table, which no index can hide.
"""

from __future__ import annotations

from collections.abc import Iterable
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
_FORMATS = {
    "": MessageDefinitionFormat.NONE,
    "ros2msg": MessageDefinitionFormat.MSG,
    "ros2idl": MessageDefinitionFormat.IDL,
}


class Db3Reader(Sqlite3Reader):
    """Gives the messages as its base does, which makes an address of the path; of a name like `50%.db3` also."""

    def __init__(self, path: Any) -> None:
        super().__init__(Path(quote(str(path))))
        self._file = Path(str(path))

    def _open(self) -> None:
        """Fill in the topics with the numbers of their messages, if nothing is wrong; no span of time is looked for."""
        database: Any = self.dbconn
        bound = WorkBound(self._file)
        database.set_progress_handler(bound, STEPS_AT_ONCE)
        try:
            self._fill_in(database)
        except Exception as err:
            if bound.is_over:
                raise ReaderError(TOO_LONG) from err
            raise
        database.set_progress_handler(None)

    def _fill_in(self, database: Any) -> None:
        """Look at the tables before anything of them is read, and at the indexes when the messages are counted."""
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
        counts: dict[Any, int] = dict(database.execute(_COUNTS))
        _refuse(odd_indexes(database, sum(counts.values())))
        profiles = "offered_qos_profiles" if self.schema >= _WITH_PROFILES else "''"
        digest = "type_description_hash" if self.schema >= _WITH_DEFINITIONS else "''"
        self.connections = [
            Connection(
                number,
                topic,
                kind,
                _definition(*definitions.get(kind, ("", ""))),
                hashed,
                counts.get(number, 0),
                ConnectionExtRosbag2(encoding, metadata.parse_qos(offered)),
                self,
            )
            for number, topic, kind, encoding, offered, hashed in database.execute(
                _TOPICS.format(profiles, digest)
            )
        ]
        self.metadata = self.metadata._replace(message_count=sum(counts.values()))


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
        reader.storage = Db3Reader(storage.path)
    elif isinstance(storage, DirectoryReader):
        plugins = {**storage.STORAGE_PLUGINS, "sqlite3": Db3Reader}
        storage.STORAGE_PLUGINS = plugins


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
