"""What is found out about a .db3 file when it is opened, beside what rosbags finds out."""

import sqlite3

import pytest
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from dynmap_cli.ingest.containers.db3_opening import Db3Reader, use_db3_reader

_QOS = (
    "- {history: 3, depth: 0, reliability: 1, durability: 2, deadline: {sec: 1, nsec: 2}, lifespan: {sec: 3, nsec: 4}, "
    "liveliness: 1, liveliness_lease_duration: {sec: 5, nsec: 6}, avoid_ros_namespace_conventions: false}"
)
_OLDEST = ("id INTEGER PRIMARY KEY", "name TEXT", "type TEXT", "serialization_format TEXT")
_PROFILES, _HASHED = (*_OLDEST, "offered_qos_profiles TEXT"), "type_description_hash TEXT"
_VERSIONS = {1: (_OLDEST, None), 2: (_PROFILES, None), 3: (_PROFILES, 3), 4: ((*_PROFILES, _HASHED), 4)}


def _write(path, version):
    """Five messages of two topics, one of a topic that is not there, and a topic without messages."""
    columns, stated = _VERSIONS[version]
    with sqlite3.connect(path) as database:
        database.execute(f"CREATE TABLE topics({', '.join(columns)})")
        database.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data BLOB)")
        if stated is not None:
            database.execute("CREATE TABLE schema(schema_version INTEGER PRIMARY KEY)")
            database.execute("INSERT INTO schema VALUES (?)", (stated,))
        if version == 4:
            database.execute(
                "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type, encoding, "
                f"encoded_message_definition, {_HASHED})"
            )
            for row in (("a/msg/A", "ros2msg", "int32 x"), ("a/msg/A", "ros2idl", ""), ("no/No", "odd", "")):
                database.execute("INSERT INTO message_definitions VALUES (NULL, ?, ?, ?, 'h')", row)
        for number, kind in ((7, "a/msg/A"), (2, "b/msg/B"), (9, "a/msg/A")):
            row = (number, f"/{number}", kind, "cdr", "" if number == 2 else _QOS, "hash")[: len(columns)]
            database.execute(f"INSERT INTO topics VALUES ({', '.join('?' * len(row))})", row)
        rows = [(topic, stamp, b"x") for stamp, topic in enumerate((7, 2, 7, 5, 7, 7))]
        database.executemany("INSERT INTO messages VALUES (NULL, ?, ?, ?)", rows)
    database.close()
    return path


@pytest.mark.parametrize("far", [None, 2**63 - 1, -(2**63)])
def test_messages_are_estimated_before_they_are_counted_and_counted_where_numbers_have_gaps(far, tmp_path):
    path = _write(tmp_path / "a.db3", 4)
    with sqlite3.connect(path) as database:
        rows = [(7 if number % 4 else 2, number, b"x") for number in range(20_000)]
        database.executemany("INSERT INTO messages VALUES (NULL, ?, ?, ?)", rows)
        if far is not None:
            database.execute("UPDATE messages SET id = ? WHERE id = 100", (far,))
    database.close()
    reader = Db3Reader(path)
    reader.open()
    about = {one.topic: one.msgcount for one in reader.connections}
    reader.count()
    counted = {one.topic: one.msgcount for one in reader.connections}
    assert counted == {"/7": 15_004, "/2": 5001, "/9": 0}
    for topic, count in counted.items():
        assert about[topic] == pytest.approx(count, abs=0 if far else 200)
    reader.close()


@pytest.mark.parametrize("version", _VERSIONS)
def test_all_versions_of_the_tables_are_read_as_rosbags_reads_them(tmp_path, version):
    path = _write(tmp_path / "a.db3", version)
    own, other = Db3Reader(path), Sqlite3Reader(path)
    own.open()
    other.open()
    assert own.schema == other.schema == version
    own.count()
    assert [one._replace(owner=None) for one in own.connections] == [
        one._replace(owner=None) for one in other.connections
    ]
    assert own.metadata.message_count == other.metadata.message_count == 6
    assert [data for *_, data in own.messages(own.connections)] == [b"x"] * 5
    own.close()
    other.close()


def test_a_file_without_messages_table_is_refused(tmp_path):
    with sqlite3.connect(tmp_path / "a.db3") as database:
        database.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY)")
    database.close()
    with pytest.raises(ReaderError, match="are missing"):
        Db3Reader(tmp_path / "a.db3").open()


def test_only_the_reader_that_is_passed_is_changed(tmp_path):
    path = _write(tmp_path / "a.db3", 4)
    own, other = Reader(path), Reader(path)
    use_db3_reader(own)
    assert isinstance(own.storage, Db3Reader)
    assert not isinstance(other.storage, Db3Reader)
