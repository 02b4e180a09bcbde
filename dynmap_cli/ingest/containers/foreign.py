"""Files that are no recordings that are read, told by their first bytes, with what to do instead."""

from __future__ import annotations

import re

_CONVERT = "Convert it to a ROS bag or to CARMEN text"
_TAKE_SOURCE = "Pass the recording that it was made from"
_UNPACK = "Unpack it and pass the recording inside"
_WEAN_MAP = ("a map as CMU's wean.dat, not a log", "Pass it with `dynmap localize --map`")
_STARTS = (
    (
        (b"\xd4\xc3\xb2\xa1", b"\xa1\xb2\xc3\xd4", b"\x0a\x0d\x0d\x0a"),
        "a capture of network packets",
        "Record the laser scans or points that the driver publishes",
    ),
    (
        (b"7z\xbc\xaf\x27\x1c", b"Rar!", b"\x1f\x9d", b"\x04\x22\x4d\x18"),
        "an archive of a kind that is not unpacked",
        _UNPACK,
    ),
    ((b"\xed\xa1\xda\x01",), "an LCM log", _CONVERT),
    ((b"\x89HDF",), "an HDF5 file", _CONVERT),
    ((b"MATLAB",), "a MATLAB file", _CONVERT),
    (
        (b"\x89PNG", b"P5", b"P2"),
        "an image",
        "Pass the recording; a map goes to `dynmap localize --map MAP.yaml`",
    ),
    ((b"LASF", b"# .PCD", b"ply\n"), "a point cloud without times", _TAKE_SOURCE),
    ((b"rosbag2_bagfile_information",), "the metadata of a ROS 2 bag", "Pass the folder that it lies in"),
    ((b"## Player",), "a log of Player", _CONVERT),
    ((b"robot_specifications",), *_WEAN_MAP),
)
_INSIDE = (
    (rb"\A[^\0](?s:.){256}ustar", "a tar archive", _UNPACK),
    (
        rb"C(Observation|Sensory|Action)\w+",
        "an MRPT rawlog",
        "Convert it to a ROS bag (mrpt_rawlog) or to CARMEN text",
    ),
    (rb"^global_map\[0\]", *_WEAN_MAP),
    (rb"^image:[^\n]*(?s:.*)^resolution:", "the YAML of a map", "Pass it with `dynmap localize --map`"),
    (rb"^(VERTEX|EDGE)[_0-9A-Z]* ", "a pose graph without scans", _TAKE_SOURCE),
    (
        rb"\A([^\n]*[A-Za-z][^\n]*\n)?[-+0-9.eE, ;\t]*[,;][-+0-9.eE,; \t]*\r?$",
        "a table of numbers",
        "Convert it to a ROS bag or to CARMEN text (FLASER lines)",
    ),
)


def foreign(head: bytes) -> str:
    """What a file is and what to do, in two sentences, from its first bytes; "" where that is not known."""
    for starts, what, then in _STARTS:
        if head.startswith(starts):
            return f"{what}. {then}."
    for pattern, what, then in _INSIDE:
        if re.search(pattern, head, re.MULTILINE):
            return f"{what}. {then}."
    return ""
