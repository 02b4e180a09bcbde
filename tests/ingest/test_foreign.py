"""Files that are no recordings: what they are, and what to do."""

import numpy as np
import pytest

from dynmap_cli.errors import LogError
from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from tests.ingest.test_choices import read
from tests.ingest.written import World


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (
            b"robot_specifications->resolution 10\n\nglobal_map[0]: 8 8\n",
            "a map as CMU's wean.dat, not a log. Pass it",
        ),
        (
            b"image: a.pgm\nresolution: 0.05\norigin: [0, 0, 0]\n",
            "the YAML of a map. Pass it with `dynmap localize --map`",
        ),
        (b"P5\n4 4\n255\n0123456789abcdef", "an image. Pass the recording"),
        (b"rosbag2_bagfile_information:\n  version: 9\n", "the metadata of a ROS 2 bag. Pass the folder"),
        (b"\xd4\xc3\xb2\xa1\x02\x00", "a capture of network packets. Record the laser scans or points"),
        (b"\xed\xa1\xda\x01\x00\x00", "an LCM log. Convert it"),
        (b"a.bag".ljust(257, b"\0") + b"ustar\x0000", "a tar archive. Unpack it"),
        (b"\x04\x22\x4d\x18\x64\x40\xa7\x00", "an archive of a kind that is not unpacked. Unpack it"),
        (b"\x12\x81\x92CObservation2DRangeScan\x00\x00", "an MRPT rawlog. Convert it"),
        (b"VERTEX_SE2 0 0 0 0\nEDGE_SE2 0 1 1 0 0\n", "a pose graph without scans"),
        (
            b"1233.25,181,-1.57,1.57,2.31,2.32\n1233.30,181,-1.57,1.57,2.31,2.32\n",
            "a table of numbers. Convert it",
        ),
        (b"time,r0,r1\n1233.25,2.31,2.32\n", "a table of numbers. Convert it"),
    ],
)
def test_other_files_are_told_by_what_they_are(content, told, tmp_path):
    path = tmp_path / "log"
    path.write_bytes(content)
    with pytest.raises(LogError) as caught:
        read_recordings([path], IngestSettings())
    assert told in str(caught.value)
    assert "MCAP of ROS 1 or Foxglove" in str(caught.value)


def test_angles_of_scans_in_degrees_are_read(tmp_path):
    def in_degrees(_number, fields):
        for name in ("angle_min", "angle_max", "angle_increment"):
            fields[name] = float(np.degrees(fields[name]))

    world = World(first_rad=-2.0, step_rad=0.1, n_beams=41, change=in_degrees)
    log, report = read(tmp_path, world)
    assert report.warnings == ("/scan: its angles are no sweep in radians: taken to be in degrees",)
    np.testing.assert_allclose(log.bearings_rad[0], -2.0 + 0.1 * np.arange(41), atol=1e-4)
