"""RAWLASER lines of CARMEN logs, which carry no pose."""

import numpy as np
import pytest

from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from tests.ingest.written import carmen_line

N, N_BEAMS = 100, 181
START_RAD, STEP_RAD = -1.570796, 0.017453
RANGES = np.round(np.random.default_rng(8).uniform(0.5, 9.0, (N, N_BEAMS)), 2)
POSES = np.column_stack([0.1 * np.arange(N), 0.02 * np.arange(N), 0.01 * np.arange(N)])


def stamp_text(number):
    return f"{1_200_000_000 + number // 5}.{(number % 5) * 200_000 + 137_530:06d}"


def raw_line(number, word="RAWLASER1", remissions=()):
    readings = " ".join(f"{value:.2f}" for value in RANGES[number])
    glow = "".join(f" {value}" for value in remissions)
    return (
        f"{word} 0 {START_RAD} 3.141593 {STEP_RAD} 50.000000 0.010000 0 {N_BEAMS} {readings} {len(remissions)}{glow} "
        f"{stamp_text(number)} host 0.5\n"
    )


def odometry_line(number, stamp=None):
    x, y, yaw = POSES[number]
    return f"ODOM {x:.6f} {y:.6f} {yaw:.6f} 0.1 0 0 {stamp or stamp_text(number)} host 0.5\n"


def read(tmp_path, lines, **settings):
    path = tmp_path / "a.log"
    path.write_text("# CARMEN Logfile\n" + "".join(lines))
    return read_recordings([path], IngestSettings(**settings))


@pytest.mark.parametrize("remissions", [(), (30, 40, 50)])
def test_sweeps_have_the_stated_geometry_and_the_pose_of_the_odometry_at_their_time(remissions, tmp_path):
    lines = []
    for number in range(N):
        lines.append(raw_line(number, remissions=remissions))
        if number % 2 == 0:
            lines.append(odometry_line(number))
    log, report = read(tmp_path, [*lines[:-1], lines[-1], odometry_line(N - 1)])
    assert not report.dropped
    assert report.odometry == "ODOM"
    assert report.lasers[0].name == "RAWLASER1"
    np.testing.assert_array_equal(log.ranges_m, RANGES.astype(np.float32))
    np.testing.assert_allclose(log.odometry, POSES, atol=1e-5)
    np.testing.assert_allclose(log.bearings_rad[0], START_RAD + STEP_RAD * np.arange(N_BEAMS))
    np.testing.assert_allclose(log.range_limits_m, [[0.01, 50.0]])
    assert any("does not say where frame 'RAWLASER1' sits on the robot" in line for line in report.warnings)


def test_a_log_says_where_its_front_laser_sits(tmp_path):
    lines = ["PARAM robot_frontlaser_offset 0.17 1200000000.0 host 0.5\n"]
    for number in range(N):
        lines += [raw_line(number), odometry_line(number)]
    log, report = read(tmp_path, lines)
    np.testing.assert_allclose(log.sensor_poses, [[0.17, 0.0, 0.0]])
    assert not report.warnings
    assert report.lasers[0].is_pose_known


@pytest.mark.parametrize(
    ("raw", "twin"),
    [
        ("RAWLASER1", "FLASER"),
        ("RAWLASER2", "RLASER"),
        ("RAWLASER1", "ROBOTLASER1"),
        ("RAWLASER2", "ROBOTLASER2"),
    ],
)
def test_a_sweep_that_other_lines_hold_with_its_pose_counts_once(raw, twin, tmp_path):
    lines = []
    for number, pose in enumerate(POSES):
        if "ROBOT" in twin:
            head, readings = raw_line(number).split(f" {N_BEAMS} ", 1)
            poses = " ".join(f"{value:.6f}" for value in (*pose, *pose))
            numbers, *times = readings.rsplit(None, 3)
            twin_line = f"{head} {N_BEAMS} {numbers} {poses} 0 0 0 0 0 {' '.join(times)}\n".replace(
                "RAWLASER1", twin
            )
        else:
            twin_line = carmen_line(RANGES[number], pose, pose, stamp_text(number), twin)
        lines += [odometry_line(number), raw_line(number, raw), twin_line]
    log, report = read(tmp_path, lines)
    assert log.n_scans == N
    assert [laser.name for laser in report.lasers] == [twin]
    assert report.odometry == twin
    assert report.notes == (
        f"{raw}: its {N} lines are left out; the {N} {twin} lines hold the same sweeps with their poses",
    )
    assert report.notes[0] in report.lines()
    assert not report.warnings
    np.testing.assert_array_equal(log.ranges_m, RANGES.astype(np.float32))


def test_sweeps_of_another_laser_are_none_of_those_with_poses(tmp_path):
    lines = []
    for number, pose in enumerate(POSES):
        lines += [
            carmen_line(RANGES[number], pose, pose, stamp_text(number)),
            raw_line(number, "RAWLASER2"),
        ]
    _, report = read(tmp_path, lines)
    assert not report.notes
    front, rear = report.lasers
    assert (front.name, front.used) == ("FLASER", True)
    assert (rear.name, rear.used, rear.pose) == ("RAWLASER2", False, None)


def test_of_two_lasers_without_poses_one_is_used(tmp_path):
    lines = []
    for number in range(N):
        lines += [raw_line(number), raw_line(number, "RAWLASER2"), odometry_line(number)]
    log, report = read(tmp_path, lines)
    assert log.n_scans == N
    assert [(laser.used, laser.why) for laser in report.lasers] == [
        (True, "sees most"),
        (False, "its pose on the robot is not known"),
    ]


def test_where_lines_with_poses_are_all_broken_those_without_are_used(tmp_path):
    lines = ["FLASER 181 1.0\n"]
    for number in range(N):
        lines += [raw_line(number), odometry_line(number)]
    log, report = read(tmp_path, lines)
    assert log.n_scans == N
    assert [laser.name for laser in report.lasers] == ["RAWLASER1"]
    assert not report.notes


def test_lost_stamps_leave_the_order_of_sweeps_without_poses(tmp_path):
    lines = [line.replace(stamp_text(number), "0") for number, line in enumerate(map(raw_line, range(N)))]
    log, report = read(tmp_path, [*lines, odometry_line(0, "0")])
    np.testing.assert_array_equal(log.ranges_m, RANGES.astype(np.float32))
    assert report.odometry == "none"
    assert any("time stamps are the same" in line for line in report.warnings)


@pytest.mark.parametrize(
    "change",
    [
        lambda line: line.replace(" 181 ", " 180 ", 1),
        lambda line: line.replace(" 181 ", " x ", 1),
        lambda line: line[:400] + "\n",
        lambda line: line[:30] + "\n",
        lambda line: line.replace("-1.570796", "nan"),
    ],
)
def test_malformed_lines_are_counted(change, tmp_path):
    lines = [raw_line(number) for number in range(N)]
    lines[5] = change(lines[5])
    log, report = read(tmp_path, [*lines, *map(odometry_line, range(N))])
    assert log.n_scans == N - 1
    assert sum(report.dropped.values()) == 1


def test_a_log_says_where_its_rear_laser_sits(tmp_path):
    lines = ["PARAM robot_rearlaser_offset -0.21 1200000000.0 host 0.5\n"]
    for number in range(N):
        lines += [raw_line(number, "RAWLASER2"), odometry_line(number)]
    log, report = read(tmp_path, lines)
    assert report.lasers[0].is_pose_known
    np.testing.assert_allclose(log.sensor_poses, [[-0.21, 0.0, np.pi]])


def test_lines_with_poses_that_end_early_give_way_to_those_without(tmp_path):
    lines = []
    for number in range(N):
        if 10 <= number < 60:
            x, y, yaw = POSES[number]
            ahead = (x + 0.3 * np.cos(yaw), y + 0.3 * np.sin(yaw), yaw)
            lines.append(carmen_line(RANGES[number], ahead, POSES[number], stamp_text(number)))
        lines += [raw_line(number), odometry_line(number)]
    log, report = read(tmp_path, lines)
    assert log.n_scans == N
    assert [laser.name for laser in report.lasers] == ["RAWLASER1"]
    np.testing.assert_allclose(log.sensor_poses, [[0.3, 0.0, 0.0]], atol=1e-5)
    np.testing.assert_allclose(log.odometry, POSES, atol=1e-5)
    (note,) = report.notes
    assert note.startswith(
        "FLASER: its 50 lines are left out; they hold a part only of the sweeps of the 100 RAWLASER1"
    )


def test_angles_in_degrees_and_lines_that_end_with_carriage_returns_are_read(tmp_path):
    in_degrees = f"{START_RAD} 3.141593 {STEP_RAD}"
    lines = [raw_line(number).replace(in_degrees, "-90.0 180.0 1.0") for number in range(N)]
    lines = [text for number in range(N) for text in (lines[number], odometry_line(number))]
    path = tmp_path / "a.log"
    path.write_bytes("".join(lines).replace("\n", "\r").encode())
    log, _ = read_recordings([path], IngestSettings())
    assert log.n_scans == N
    np.testing.assert_allclose(log.bearings_rad[0], np.radians(np.arange(-90, 91)), atol=1e-9)


def test_stated_angles_in_degrees_are_said(tmp_path):
    lines = []
    for number in range(N):
        line = raw_line(number).replace(
            f"{START_RAD} 3.141593 {STEP_RAD}", f"{np.degrees(START_RAD)} 180.0 {np.degrees(STEP_RAD)}"
        )
        lines += [line, odometry_line(number)]
    log, report = read(tmp_path, lines)
    told = "RAWLASER1: its angles are no sweep in radians: taken to be in degrees"
    assert report.warnings.count(told) == 1
    np.testing.assert_allclose(log.bearings_rad[0], START_RAD + STEP_RAD * np.arange(N_BEAMS))
