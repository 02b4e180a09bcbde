"""Random trees of transforms, times and lasers: scans lie where a direct computation in three dimensions puts them."""

import math

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from dynmap_cli.ingest.raw.laser import RawLaser, ScanShape
from dynmap_cli.ingest.raw.recording import RawRecording, RawTransform
from dynmap_cli.ingest.reading import merge_recordings
from dynmap_cli.ingest.settings import IngestSettings

START_NS = 1_700_000_000_000_000_000
N_SCANS = 12
near = st.floats(-1.0, 1.0)
angles = st.floats(-3.1, 3.1)


@st.composite
def drives(draw):
    """Moving and fixed transforms from odom to a laser, each stored one way or the other, and sweeps of the laser."""
    static = [(draw(near), draw(near), draw(near), 0.0, draw(angles)) for _ in range(draw(st.integers(0, 3)))]
    # The last one carries the laser, which may hang upside down.
    static.append((draw(near), draw(near), draw(near), draw(st.sampled_from([0.0, math.pi])), draw(angles)))
    n_moves = draw(st.integers(2, 20))
    gaps = draw(st.lists(st.integers(1, 10**9), min_size=n_moves - 1, max_size=n_moves - 1))
    offsets = np.cumsum([0, *gaps]) + draw(st.integers(0, 10**8))
    steps = draw(st.lists(st.tuples(near, near, st.floats(-0.5, 0.5)), min_size=n_moves, max_size=n_moves))
    flips = draw(st.lists(st.booleans(), min_size=len(static), max_size=len(static)))
    at = sorted(draw(st.sets(st.integers(int(offsets[0]), int(offsets[-1])), min_size=1, max_size=N_SCANS)))
    first, increment = draw(angles), draw(st.floats(0.01, 0.3)) * draw(st.sampled_from([-1.0, 1.0]))
    ranges = draw(st.lists(st.floats(0.5, 7.0, width=32), min_size=8, max_size=8))
    return static, flips, offsets + START_NS, np.cumsum(steps, axis=0), at, first, increment, ranges


def matrix(x, y, z, roll, yaw):
    """parent_from_child (4, 4): turned about x, then about z."""
    found = np.eye(4)
    found[:3, :3] = Rotation.from_euler("xz", [roll, yaw]).as_matrix()
    found[:3, 3] = x, y, z
    return found


def values(pose):
    """x, y, z and quaternion of a matrix."""
    return (*pose[:3, 3], *Rotation.from_matrix(pose[:3, :3]).as_quat())


def end_points(log, row):
    """Ends of the beams of a scan in the frame of the odometry (n, 2), as every later stage computes them."""
    geometry = log.geometry_index[row]
    along = log.bearings_rad[geometry] + log.sensor_poses[geometry, 2]
    x, y = log.sensor_poses[geometry, :2, None] + log.ranges_m[row] * np.stack([np.cos(along), np.sin(along)])
    turn = log.odometry[row, 2]
    turned = np.stack([math.cos(turn) * x - math.sin(turn) * y, math.sin(turn) * x + math.cos(turn) * y])
    return (log.odometry[row, :2, None] + turned).T


A_LITTLE_RAD = 5.96e-8
"""By which a robot may turn that hardly moves."""


@settings(max_examples=100)
@given(drives())
@example(
    (
        [(0.0, 0.0, 0.0, 0.0, 0.0)],
        [False],
        START_NS + np.array([0, 1]),
        np.array([[0.0, 0.0, 0.0], [0.0, 0.0, A_LITTLE_RAD]]),
        [0],
        0.0,
        -0.25,
        [1.0] * 8,
    )
)
def test_scans_lie_where_a_direct_computation_puts_them(drive):
    static, flips, move_ns, moves, at, first, increment, ranges = drive
    frames = ["base_link", *(f"link_{number}" for number in range(len(static) - 1)), "laser"]
    recording = RawRecording("a.bag", "ROS 1 bag")
    turns = Rotation.from_euler("z", moves[:, 2:])
    moving = recording.transforms["odom", "base_link"] = RawTransform(False)
    for stamp_ns, (x, y, _), turn in zip(move_ns.tolist(), moves, turns.as_quat(), strict=True):
        moving.add(stamp_ns, stamp_ns, (x, y, 0.0, *turn))
    for number, (pose, is_flipped) in enumerate(zip(static, flips, strict=True)):
        parent, child, stored = frames[number], frames[number + 1], matrix(*pose)
        if is_flipped:
            parent, child, stored = child, parent, np.linalg.inv(stored)
        mounted = recording.transforms[parent, child] = RawTransform(True)
        mounted.add(0, 0, values(stored))
    laser = RawLaser("/scan", "laser")
    shape = ScanShape(first, increment, len(ranges), 0.1, 8.0)
    for offset in at:
        stamp_ns = START_NS + offset
        laser.add(stamp_ns, stamp_ns, np.array(ranges, dtype=np.float32), shape)
    recording.lasers["/scan"] = laser
    log, _ = merge_recordings(
        [recording], IngestSettings(base_frame="base_link", odom_frame="odom", odom="tf")
    )
    assert log.n_scans == len(at)

    base_from_laser = np.linalg.multi_dot([np.eye(4), np.eye(4), *(matrix(*pose) for pose in static)])
    seconds = (move_ns - START_NS) * 1e-9
    slerp = Slerp(seconds, turns)
    bearings = first + increment * np.arange(len(ranges))
    points = np.column_stack(
        [ranges * np.cos(bearings), ranges * np.sin(bearings), np.zeros(len(ranges)), np.ones(len(ranges))]
    )
    for row, offset in enumerate(at):
        odom_from_base = np.eye(4)
        odom_from_base[:3, :3] = slerp(offset * 1e-9).as_matrix()
        odom_from_base[:2, 3] = [np.interp(offset * 1e-9, seconds, moves[:, axis]) for axis in (0, 1)]
        expected = (odom_from_base @ base_from_laser @ points.T).T[:, :2]
        np.testing.assert_allclose(end_points(log, row), expected, atol=1e-9)
