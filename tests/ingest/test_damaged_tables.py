"""Tables of a .db3 whose pages are whole and whose rows are not: the rest is read, what is wrong is said."""

import sqlite3
from contextlib import closing

import numpy as np
import pytest

from dynmap_cli.errors import LogError
from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from tests.ingest.corpus import FILES, WORLD

LOOSE = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name, type, serialization_format, offered_qos_profiles, "


def altered(tmp_path, *statements):
    """A .db3 after some statements of SQL; columns of its topics take any value."""
    path = FILES["db3"](tmp_path)
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("ALTER TABLE topics RENAME TO strict_topics")
        connection.execute(f"{LOOSE}type_description_hash)")
        connection.execute("INSERT INTO topics SELECT * FROM strict_topics")
        connection.execute("DROP TABLE strict_topics")
        for statement in statements:
            connection.execute(statement)
    return path


def read(path):
    return read_recordings([path], IngestSettings())


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("type = NULL", "the type of /odom is not known"),
        ("type = x'ff00'", "the type of /odom is not known"),
        ("name = NULL", "the name of 1 topics is no text"),
        ("name = x'ff00fe'", "the name of 1 topics is no text"),
    ],
)
def test_a_topic_without_a_name_or_type_costs_only_itself(value, said, tmp_path):
    log, report = read(altered(tmp_path, f"UPDATE topics SET {value} WHERE name = '/odom'"))
    np.testing.assert_array_equal(log.ranges_m, WORLD.ranges_m)
    assert report.damage == (said,)
    (warning,) = report.warnings
    assert said in warning


def test_where_no_topic_has_a_type_that_is_said(tmp_path):
    with pytest.raises(
        LogError, match=r"it holds /odom \(type not known\), .* is not known\); recovered 181"
    ):
        read(altered(tmp_path, "UPDATE topics SET type = NULL"))


def test_messages_of_a_topic_that_is_not_there_are_counted_and_damage(tmp_path):
    path = altered(tmp_path, "UPDATE messages SET topic_id = 99 WHERE id > 120")
    log, report = read(path)
    assert 30 < log.n_scans < 60
    assert report.dropped["message of no known topic"] == 61
    assert report.damage == ("message of no known topic",)
    with pytest.raises(LogError, match=r"is damaged; 61 x message of no known topic\. Copy it again"):
        read_recordings([path], IngestSettings(strict=True))


def test_messages_without_any_topic_are_not_nothing(tmp_path):
    with pytest.raises(LogError, match="it holds no topic; 181 x message of no known topic"):
        read(altered(tmp_path, "DELETE FROM topics"))


def test_where_rows_are_read_one_by_one_those_of_no_topic_are_counted_too(tmp_path):
    path = altered(
        tmp_path,
        "UPDATE topics SET type = NULL WHERE name = '/odom'",
        "DELETE FROM topics WHERE name = '/tf'",
    )
    _, report = read(path)
    assert "message of no known topic" in report.damage
    assert "lost 60 single messages" in report.warnings[0]


@pytest.mark.parametrize("number", ["(SELECT id FROM topics WHERE name = '/scan')", "NULL", "'a'", "0.5"])
def test_topics_whose_numbers_do_not_tell_them_apart_are_said(number, tmp_path):
    path = altered(
        tmp_path,
        "CREATE TABLE others AS SELECT * FROM topics",
        f"INSERT INTO others SELECT {number}, '/other', type, serialization_format, offered_qos_profiles, "
        "type_description_hash FROM topics WHERE name = '/scan'",
        "DROP TABLE topics",
        "ALTER TABLE others RENAME TO topics",
    )
    log, report = read_recordings([path], IngestSettings())
    np.testing.assert_array_equal(log.ranges_m, WORLD.ranges_m)
    assert "topics have" in report.damage[0]
    assert "different numbers" in report.damage[0]


def test_words_of_a_damaged_file_that_are_no_text_are_no_traceback(tmp_path):
    """Found by `make fuzz`: SQLite complains in words of the file itself."""
    path = FILES["db3"](tmp_path)
    data = bytearray(path.read_bytes())
    data[3151] ^= 0xFF
    path.write_bytes(data)
    try:
        read(path)
    except LogError as err:
        assert "\n" not in str(err)
