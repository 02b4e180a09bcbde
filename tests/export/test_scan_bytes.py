"""Replacing ranges inside serialized scans."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynmap_cli.errors import LogError
from dynmap_cli.export.scan_bytes import MULTI_ECHO, parse_scan
from tests.ingest.written import ROS1, ROS2, SCAN, build, stamp

STAMP_NS = 1_700_000_000_123_456_789
STORES = {"cdr": ROS2, "ros1": ROS1}


def message_of(store, kind, ranges, intensities, frame):
    fields = {
        "header": {"stamp": stamp(STAMP_NS), "frame_id": frame},
        **dict.fromkeys(
            ("angle_min", "angle_max", "angle_increment", "time_increment", "scan_time", "range_min"), 0.5
        ),
        "range_max": 20.0,
        "ranges": ranges,
        "intensities": intensities,
    }
    return build(store, kind, fields)


def serialized(encoding, message, kind, *, little_endian=True):
    if encoding == "ros1":
        return bytes(ROS1.serialize_ros1(message, kind))
    return bytes(ROS2.serialize_cdr(message, kind, little_endian=little_endian))


def read_again(encoding, data, kind):
    return ROS1.deserialize_ros1(data, kind) if encoding == "ros1" else ROS2.deserialize_cdr(data, kind)


@given(
    encoding=st.sampled_from(("cdr", "ros1", "big-endian cdr")),
    frame=st.text(alphabet="abc/", max_size=9),
    beams=st.integers(0, 7),
    intensities=st.integers(0, 3),
    seed=st.integers(0, 99),
)
def test_removed_beams_are_nan_and_all_other_bytes_stay(encoding, frame, beams, intensities, seed):
    rng = np.random.default_rng(seed)
    encoding, little = encoding.removeprefix("big-endian "), not encoding.startswith("big")
    ranges, removed = rng.uniform(0.1, 20.0, beams).astype(np.float32), rng.random(beams) < 0.5
    message = message_of(STORES[encoding], SCAN, ranges, np.ones(intensities, dtype=np.float32), frame)
    data = serialized(encoding, message, SCAN, little_endian=little)

    scan = parse_scan(data, encoding, SCAN)
    assert scan.stamp_ns == STAMP_NS
    np.testing.assert_array_equal(scan.first_echoes_m, ranges)

    message.ranges = np.where(removed, np.float32(np.nan), ranges)
    assert scan.without(removed) == serialized(encoding, message, SCAN, little_endian=little)
    message.ranges, message.intensities = ranges, np.arange(beams, dtype=np.float32)
    labelled = scan.with_intensities(message.intensities)
    assert labelled == serialized(encoding, message, SCAN, little_endian=little)


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_all_echoes_of_a_removed_beam_go(encoding):
    store = STORES[encoding]

    def echoes(*rows):
        return [{"echoes": np.array(row, dtype=np.float32)} for row in rows]

    message = message_of(store, MULTI_ECHO, echoes([1, 2], [], [3], [4, 5, 6]), echoes([7]), "laser")
    scan = parse_scan(serialized(encoding, message, MULTI_ECHO), encoding, MULTI_ECHO)
    np.testing.assert_array_equal(scan.first_echoes_m, [1.0, np.inf, 3.0, 4.0])

    cleaned = read_again(encoding, scan.without(np.array([True, True, False, True])), MULTI_ECHO)
    assert [np.isnan(beam.echoes).tolist() for beam in cleaned.ranges] == [
        [True] * 2,
        [],
        [False],
        [True] * 3,
    ]
    labelled = read_again(encoding, scan.with_intensities(np.full(4, 0.25, dtype=np.float32)), MULTI_ECHO)
    assert [beam.echoes.tolist() for beam in labelled.intensities] == [[0.25]] * 4


def test_a_cut_off_scan_is_refused():
    data = serialized(
        "cdr", message_of(ROS2, SCAN, np.ones(5, np.float32), np.ones(0, np.float32), "f"), SCAN
    )
    for length in (0, 3, 11, 17, 40, len(data) - 12):
        with pytest.raises(LogError, match="cut off"):
            parse_scan(data[:length], "cdr", SCAN)
