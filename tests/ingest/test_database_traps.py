"""Databases that would take for ever: only real tables are read, and no more rows than have room in the file."""

import sqlite3
import struct
import time
from contextlib import closing

import numpy as np
import pytest

from dynmap_cli.errors import LogError
from dynmap_cli.ingest.containers import db3_opening, db3_tables
from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from tests.ingest.corpus import FOLDERS, WORLD
from tests.ingest.test_damaged_tables import altered

ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)"
LONGEST_CPU_S = 10.0


def as_it_is(path):
    return path


def in_a_folder(path):
    """With a metadata.yaml that knows nothing of what is wrong with it."""
    folder = FOLDERS["folder db3"](path.parent / "folder")
    (file,) = folder.glob("*.db3")
    file.write_bytes(path.read_bytes())
    return folder


def refusal_of(path):
    start = time.process_time()
    with pytest.raises(LogError) as caught:
        read_recordings([path], IngestSettings())
    assert time.process_time() - start < LONGEST_CPU_S
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("table", "columns"),
    [
        ("messages", "i AS id, 1 AS topic_id, i AS timestamp, x'00' AS data"),
        (
            "topics",
            "i AS id, '/' || i AS name, 'a/msg/B' AS type, 'cdr' AS serialization_format, "
            "'' AS offered_qos_profiles, '' AS type_description_hash",
        ),
    ],
)
def test_a_view_is_not_read(table, columns, tmp_path):
    path = altered(
        tmp_path, f"DROP TABLE {table}", f"CREATE VIEW {table} AS {ENDLESS} SELECT {columns} FROM n"
    )
    assert f"its {table} is a view, which is not read" in refusal_of(path)


def test_a_virtual_table_is_not_read(tmp_path):
    path = altered(
        tmp_path, "DROP TABLE messages", "CREATE VIRTUAL TABLE messages USING fts5(topic_id, timestamp, data)"
    )
    assert "its messages is a virtual table" in refusal_of(path)


def test_a_column_that_is_computed_is_not_read(tmp_path):
    path = altered(
        tmp_path,
        "DROP TABLE messages",
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data AS (zeroblob(1000000000)))",
        "INSERT INTO messages(topic_id, timestamp) VALUES (1, 1), (2, 2)",
    )
    assert "computed column 'data'" in refusal_of(path)


def test_a_column_that_is_computed_in_a_table_of_definitions_costs_only_these(tmp_path):
    path = altered(tmp_path, "ALTER TABLE message_definitions ADD COLUMN x AS (zeroblob(1000000000))")
    log, report = read_recordings([path], IngestSettings())
    np.testing.assert_array_equal(log.ranges_m, WORLD.ranges_m)
    assert "computed column 'x'" in report.damage[0]


def test_more_topics_than_any_robot_has_are_refused(tmp_path):
    path = altered(
        tmp_path,
        "DELETE FROM topics",
        f"INSERT INTO topics {ENDLESS} SELECT i, '/' || i, 'a/msg/B', 'cdr', '', '' FROM n LIMIT 20000",
    )
    assert "it has 20000 topics (at most 10000)" in refusal_of(path)


@pytest.mark.parametrize("placed", [as_it_is, in_a_folder])
@pytest.mark.parametrize("statement", ["", "DROP INDEX timestamp_idx"])
def test_pages_that_are_used_over_and_over_do_not_hold_up(placed, statement, tmp_path):
    """A tree of pages of which each points many times to the next is small, and has more rows than anybody can read."""
    path = altered(
        tmp_path, "CREATE TABLE filler(x)", "INSERT INTO filler VALUES (zeroblob(40000))", statement
    )
    with closing(sqlite3.connect(path)) as connection:
        ((root,),) = connection.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'")
        ((size,),) = connection.execute("PRAGMA page_size")
    data = bytearray(path.read_bytes())
    n_pages = len(data) // size
    below = [n_pages + number for number in range(1, 6)]
    n_cells = 400
    for page, target in zip([root, *below[:-1]], below, strict=True):
        cells = struct.pack(">IB", target, 1) * n_cells
        start = size - len(cells)
        head = struct.pack(">BHHHBI", 5, 0, n_cells, start, 0, target)
        places = b"".join(struct.pack(">H", start + 5 * number) for number in range(n_cells))
        if (page - 1) * size == len(data):
            data += bytes(size)
        content = (head + places).ljust(start, b"\x00") + cells
        data[(page - 1) * size : page * size] = content
    leaf = bytes([13, 0, 0, 0, 1]) + struct.pack(">H", size - 10) + b"\x00" + struct.pack(">H", size - 10)
    cell = bytes([8, 1, 5, 0, 9, 9, 12, 0])  # a row: nothing, 1, 1, an empty BLOB
    data += leaf.ljust(size - 10, b"\x00") + cell.ljust(10, b"\x00")
    data[28:32] = struct.pack(">I", len(data) // size)
    path.write_bytes(data)
    assert "database disk image is malformed" in refusal_of(placed(path))


def test_a_file_takes_no_more_work_than_its_size_is_worth(tmp_path, monkeypatch):
    path = altered(tmp_path, "DROP INDEX timestamp_idx")
    monkeypatch.setattr(db3_tables, "_STEPS_AT_LEAST", 0)
    monkeypatch.setattr(db3_tables, "_STEPS_PER_BYTE", 0)
    monkeypatch.setattr(db3_opening, "STEPS_AT_ONCE", 100)
    _, report = read_recordings([path], IngestSettings())
    assert report.damage == ("its tables hold more rows than have room in the file",)


@pytest.mark.parametrize("placed", [as_it_is, in_a_folder])
def test_an_index_that_leaves_out_messages_is_not_believed(placed, tmp_path):
    path = altered(
        tmp_path,
        "DROP INDEX timestamp_idx",
        "CREATE INDEX timestamp_idx ON messages (timestamp) WHERE id % 2",
    )
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("PRAGMA writable_schema=ON")
        connection.execute(
            "UPDATE sqlite_master SET sql = 'CREATE INDEX timestamp_idx ON messages (timestamp)' "
            "WHERE name = 'timestamp_idx'"
        )
    log, report = read_recordings([placed(path)], IngestSettings())
    np.testing.assert_array_equal(log.ranges_m, WORLD.ranges_m)
    assert report.damage == ("its index 'timestamp_idx' has 91 messages, its table 181",)


def test_messages_of_no_known_topic_are_counted_in_a_folder_too(tmp_path):
    path = altered(
        tmp_path,
        "INSERT INTO messages(topic_id, timestamp, data) SELECT 99, timestamp, data FROM messages LIMIT 7",
        "DELETE FROM messages WHERE id = 181",
    )
    _, report = read_recordings([in_a_folder(path)], IngestSettings())
    assert "message of no known topic" in report.damage


def test_rows_with_numbers_below_zero_are_read(tmp_path):
    path = altered(
        tmp_path,
        "UPDATE messages SET id = id - 1000",
        "UPDATE topics SET type = NULL WHERE name = '/odom'",
    )
    log, _ = read_recordings([path], IngestSettings())
    np.testing.assert_array_equal(log.ranges_m, WORLD.ranges_m)
