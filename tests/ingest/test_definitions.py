"""Definitions that no message type has: they are not believed, and the known ones are used."""

import numpy as np
import pytest

from dynmap_cli.ingest.messages.definitions import MOST_CHARACTERS
from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from tests.ingest import written
from tests.ingest.written import World, write_mcap

SEPARATOR = f"\n{'=' * 80}\nMSG: "


def written_with(folder, monkeypatch, change):
    """An MCAP file whose definitions are changed."""
    plain = written.ROS2.generate_msgdef

    def changed(kind, **options):
        definition, digest = plain(kind, **options)
        return change(kind, definition), digest

    monkeypatch.setattr(written.ROS2, "generate_msgdef", changed)
    path = write_mcap(folder / "a.mcap", World(), "ros2")
    monkeypatch.undo()
    return path


def itself(kind, definition):
    own, separator, rest = definition.partition(SEPARATOR)
    return f"{own}\n{kind.replace('/msg/', '/')}[] more{separator}{rest}"


def in_a_ring(_kind, definition):
    return (
        f"lab_msgs/A[] more\n{definition}"
        f"{SEPARATOR}lab_msgs/A\nlab_msgs/B[2] b\n{SEPARATOR}lab_msgs/B\nlab_msgs/A[] a\n"
    )


def endless(_kind, definition):
    return "float64 extra\n" * (MOST_CHARACTERS // 14 + 1) + definition


def without_a_field(_kind, definition):
    return definition.replace("string frame_id\n", "")


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (itself, "contains itself"),
        (in_a_ring, "contains itself"),
        (endless, f"at most {MOST_CHARACTERS}"),
        (without_a_field, "has no field frame_id"),
    ],
)
def test_a_definition_without_end_is_not_believed(change, expected, tmp_path, monkeypatch):
    path = written_with(tmp_path, monkeypatch, change)
    log, report = read_recordings([path], IngestSettings())
    np.testing.assert_array_equal(log.ranges_m, World().ranges_m)
    assert len(report.warnings) == 1
    assert expected in report.warnings[0]
