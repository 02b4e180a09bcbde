"""Copies of damaged recordings say what the reader says of them, and are whole themselves."""

import numpy as np
import pytest

from dynmap_cli.errors import ArtifactError
from dynmap_cli.export.cleaning import write_clean
from dynmap_cli.export.salvaging import write_salvaged
from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from tests.export.test_clean import NO_TEXT, labels_for
from tests.ingest.test_damaged_tables import altered
from tests.ingest.test_definitions import endless, in_a_ring, itself, without_a_field, written_with
from tests.ingest.written import World, write_bag1, write_bag2, write_mcap

SETTINGS, STRICT = IngestSettings(), IngestSettings(strict=True)
TABLES = {
    "a topic without a type": ["UPDATE topics SET type = NULL WHERE name = '/odom'"],
    "a name that is no text": ["UPDATE topics SET name = x'ff00fe' WHERE name = '/odom'"],
    "names alike but for what is no text": [
        "UPDATE topics SET name = x'ff' WHERE name = '/odom'",
        "UPDATE topics SET name = x'fe' WHERE name = '/tf'",
    ],
    "no names": ["UPDATE topics SET name = NULL WHERE name != '/scan'"],
    "messages of no topic": ["UPDATE messages SET topic_id = 99 WHERE id > 120"],
    "times that are fractions": [
        "CREATE TABLE m(id INTEGER PRIMARY KEY, topic_id, timestamp, data)",
        "INSERT INTO m SELECT id, topic_id, CASE WHEN id = 7 THEN 1.5 ELSE timestamp END, data FROM messages",
        "DROP TABLE messages",
        "ALTER TABLE m RENAME TO messages",
    ],
    "times before all clocks": ["UPDATE messages SET timestamp = -5 WHERE id % 10 = 0"],
    "times after all clocks": ["UPDATE messages SET timestamp = 9223372036854775807 WHERE id % 10 = 0"],
    "definitions of no known kind": ["UPDATE message_definitions SET encoding = 'hieroglyphs'"],
    "definitions that are views": [
        "DROP TABLE message_definitions",
        "CREATE VIEW message_definitions AS SELECT 1 AS id, '' AS topic_type, '' AS encoding",
    ],
}


def expect_the_same(path, tmp_path):
    """The losses of a salvaged copy, after all that must hold for it and a clean one."""
    log, report = read_recordings([path], SETTINGS)
    salvaged = write_salvaged([path], tmp_path / "salvaged.mcap", SETTINGS)
    again, of_copy = read_recordings([tmp_path / "salvaged.mcap"], STRICT)
    np.testing.assert_array_equal(again.ranges_m, log.ranges_m)
    assert not of_copy.damage
    cleaned = write_clean(
        [path], tmp_path / "clean.mcap", labels_for(log)[0], text=NO_TEXT, is_label=False, settings=SETTINGS
    )
    read_recordings([tmp_path / "clean.mcap"], STRICT)
    assert cleaned.losses == salvaged.losses
    assert report.damage
    for why in report.damage:
        assert why in salvaged.losses[0]
    return salvaged


@pytest.mark.parametrize("name", TABLES)
def test_tables(name, tmp_path):
    salvaged = expect_the_same(altered(tmp_path, *TABLES[name]), tmp_path)
    assert len(salvaged.losses) == 1
    if "names" in name:
        assert len(salvaged.messages) == 4


@pytest.mark.parametrize("change", [itself, in_a_ring, endless, without_a_field])
def test_definitions(change, tmp_path, monkeypatch):
    expect_the_same(written_with(tmp_path, monkeypatch, change), tmp_path)


def test_bytes_behind_the_end(tmp_path):
    paths = [write_bag1(tmp_path / "a.bag", World()), write_mcap(tmp_path / "a.mcap", World(), "ros2")]
    for path in paths:
        path.write_bytes(path.read_bytes() * 2)
        assert "bytes behind its end" in expect_the_same(path, tmp_path).losses[0]


def test_a_folder_whose_metadata_leave_out_a_topic(tmp_path):
    folder = write_bag2(tmp_path / "a", World())
    metadata = folder / "metadata.yaml"
    text = metadata.read_text()
    assert "name: /scan" in text
    metadata.write_text(text.replace("name: /scan", "name: /other"))
    log, _ = read_recordings([folder], SETTINGS)
    np.testing.assert_array_equal(log.ranges_m, World().ranges_m)
    assert "does not name /scan" in expect_the_same(folder, tmp_path).losses[0]


def test_where_there_is_nothing_to_copy_nothing_is_written(tmp_path):
    path = altered(tmp_path, "DROP TABLE messages", "CREATE VIEW messages AS SELECT 1 AS id")
    with pytest.raises(ArtifactError, match="no message can be read"):
        write_salvaged([path], tmp_path / "salvaged.mcap", SETTINGS)
    assert not (tmp_path / "salvaged.mcap").exists()
