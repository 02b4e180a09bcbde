"""CARMEN and Wean Hall text."""

import codecs

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynmap_cli.errors import LogError
from dynmap_cli.ingest.raw.plausible import LATEST_NS, stamp_of_word, stamps_of_words
from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from dynmap_cli.ingest.text.carmen_lines import flaser_shape
from dynmap_cli.ingest.text.decimals import parse_decimals
from tests.ingest.written import carmen_line

SETTINGS = IngestSettings()
RANGES = np.round(np.random.default_rng(5).uniform(0.5, 9.0, (40, 180)), 2)


def robots(n=40, step_m=0.1):
    along = step_m * np.arange(n)
    return np.column_stack([3.0 + along, -1.0 + 0.2 * along, 0.1 + 0.01 * np.arange(n)])


def laser_of(robot, ahead_m):
    return robot[0] + ahead_m * np.cos(robot[2]), robot[1] + ahead_m * np.sin(robot[2]), robot[2]


def stamp_text(number):
    return f"{976052857 + number // 5}.{(number % 5) * 200_000 + 137_530:06d}"


def stamp_ns(number):
    return (976052857 + number // 5) * 10**9 + ((number % 5) * 200_000 + 137_530) * 1000


def write(path, lines):
    path.write_text("# CARMEN Logfile\nPARAM robot_frontlaser_offset 0.0 nohost 0\n" + "".join(lines))
    return path


def flaser_lines(ahead_m=0.0, poses=None):
    poses = robots() if poses is None else poses
    return [
        carmen_line(ranges, laser_of(robot, ahead_m), robot, stamp_text(number))
        for number, (ranges, robot) in enumerate(zip(RANGES, poses, strict=True))
    ]


@given(st.lists(st.decimals(0, 99_999, places=3) | st.integers(0, 10**6).map(str), min_size=1, max_size=40))
def test_decimals_are_the_nearest_doubles(numbers):
    words = [str(number) for number in numbers]
    np.testing.assert_array_equal(parse_decimals(" ".join(words).encode()), [float(word) for word in words])


@given(
    st.lists(st.from_regex(r"[0-9]{1,4}\.?[0-9]{0,3}|\.[0-9]{1,7}", fullmatch=True), min_size=1, max_size=40)
)
def test_decimals_of_any_places_are_the_nearest_doubles(words):
    np.testing.assert_array_equal(parse_decimals(" ".join(words).encode()), [float(word) for word in words])


@given(
    st.lists(st.from_regex(r"[0-9]{10}\.[0-9]{6}", fullmatch=True), min_size=1, max_size=9),
    st.sampled_from([b"", b"1.5", b"77", b"976052906.1810904", b"976052906.1810904567"]),
)
def test_stamps_of_many_lines_are_those_of_each(words, odd):
    words = [word.encode() for word in words if int(word[:10]) < LATEST_NS // 10**9] + ([odd] if odd else [])
    expected = [stamp_of_word(word) for word in words]
    assert not words or stamps_of_words(words).tolist() == expected


@pytest.mark.parametrize("word", [b"9999999999.0", b"4611686018.5", b"1.2.3", b"17000000:0.1", b"nan"])
def test_words_that_are_no_times_are_refused_among_others(word):
    with pytest.raises(ValueError):
        stamps_of_words([word, word])


@pytest.mark.parametrize(
    "text", ["-1.5 2", "1e-3 7", "nan inf 3.0", "123456789.123456789 1", "  4   5 ", ".5 5.", ""]
)
def test_other_spellings_of_numbers_are_read_too(text):
    np.testing.assert_array_equal(parse_decimals(text.encode()), [float(word) for word in text.split()])


@pytest.mark.parametrize("text", ["1.2.3", "1 x 2", ". 1", "--3"])
def test_what_is_no_number_is_refused(text):
    with pytest.raises(ValueError, match="not a number"):
        parse_decimals(text.encode())


@pytest.mark.parametrize("ahead_m", [0.0, 0.04, -0.04])
def test_flaser_lines_read_back(ahead_m, tmp_path):
    log, report = read_recordings([write(tmp_path / "a.log", flaser_lines(ahead_m))], SETTINGS)
    np.testing.assert_array_equal(log.stamps_ns, [stamp_ns(number) for number in range(40)])
    np.testing.assert_array_equal(log.ranges_m, RANGES.astype(np.float32))
    np.testing.assert_allclose(log.odometry, robots(), atol=1e-6)
    np.testing.assert_allclose(log.sensor_poses, [[ahead_m, 0.0, 0.0]], atol=2e-6)
    np.testing.assert_allclose(log.bearings_rad[0, [0, 179]], np.radians([-90.0, 89.0]))
    assert report.odometry == "FLASER"
    assert report.recordings[0].kind == "CARMEN text"


@pytest.mark.parametrize(
    ("n_beams", "first_deg", "last_deg"),
    [
        (180, -90, 89),
        (181, -90, 90),
        (360, -90, 89.5),
        (361, -90, 90),
        (401, -50, 50),
        (400, -50, 49.75),
        (91, -90, 90),
    ],
)
def test_bearings_follow_from_the_count_of_readings(n_beams, first_deg, last_deg):
    bearings = flaser_shape(n_beams).bearings_rad
    np.testing.assert_allclose(np.degrees(bearings[[0, -1]]), [first_deg, last_deg], atol=1e-9)


def test_lines_that_do_not_parse_are_counted_and_the_others_stay(tmp_path):
    lines = flaser_lines()
    lines[3] = lines[3].replace("FLASER 180", "FLASER 181")
    lines[5] = "FLASER 180 1.0\n"
    lines[7] = lines[7].replace(f" {RANGES[7, 4]:.2f} ", " oops ", 1)
    lines[9] = lines[9].rsplit(" ", 3)[0] + " nostamp host 1\n"
    lines[39] = lines[39][:300]
    log, report = read_recordings([write(tmp_path / "a.log", lines)], SETTINGS)
    why = "181 readings announced, which takes 192 words; 191 found"
    assert report.dropped == {f"FLASER line that does not parse; the first is line 6 of a.log: {why}": 5}
    kept = [number for number in range(40) if number not in {3, 5, 7, 9, 39}]
    np.testing.assert_array_equal(log.stamps_ns, [stamp_ns(number) for number in kept])
    np.testing.assert_array_equal(log.ranges_m, RANGES[kept].astype(np.float32))


def test_further_blanks_tabs_and_line_ends_of_windows_do_no_harm(tmp_path):
    lines = [line.replace(" ", "  ", 30).replace("\n", "\r\n") for line in flaser_lines()]
    lines[3] = lines[3].replace(" ", "\t")
    log, report = read_recordings([write(tmp_path / "a.log", lines)], SETTINGS)
    assert not report.dropped
    np.testing.assert_array_equal(log.ranges_m, RANGES.astype(np.float32))


def test_scans_stamped_before_their_predecessor_are_sorted_in_and_counted(tmp_path):
    lines = flaser_lines()
    lines[10], lines[11] = lines[11], lines[10]
    lines[20], lines[21] = lines[21], lines[20]
    log, report = read_recordings([write(tmp_path / "a.log", lines)], SETTINGS)
    np.testing.assert_array_equal(log.ranges_m, RANGES.astype(np.float32))
    assert report.out_of_order == 2
    assert any("sorted in" in line for line in report.lines())


@pytest.mark.parametrize("odometry", [None, "none"])
def test_where_stamps_jump_about_the_order_of_recording_is_kept(tmp_path, odometry):
    """The robot drives towards a wall; some stamps are late by two scans, so their order is not that of the sweeps."""
    late = {number: number + 2 for number in range(4, 36, 8)}
    approach = 8.0 - 0.1 * np.arange(40)[:, None] + 0.01 * np.arange(180)
    lines = [
        carmen_line(np.round(ranges, 2), laser_of(robot, 0.0), robot, stamp_text(late.get(number, number)))
        for number, (ranges, robot) in enumerate(zip(approach, robots(), strict=True))
    ]
    log, report = read_recordings([write(tmp_path / "a.log", lines)], IngestSettings(odom=odometry))
    assert (np.diff(log.stamps_ns) >= 0).all()
    in_order = np.argsort(log.arrival_index)
    assert (np.diff(log.ranges_m[in_order, 0]) < 0).all()
    assert any("order of recording is followed" in line for line in report.lines())


def test_a_repeated_scan_is_dropped_and_counted(tmp_path):
    lines = flaser_lines()
    log, report = read_recordings([write(tmp_path / "a.log", [*lines[:7], lines[6], *lines[7:]])], SETTINGS)
    assert log.n_scans == 40
    assert report.dropped == {"scan that repeats stamp and ranges of another": 1}


def test_odometry_that_stands_still_in_scan_lines_is_taken_from_odom_lines(tmp_path):
    lines = []
    for number, (ranges, robot) in enumerate(zip(RANGES, robots(), strict=True)):
        x, y, yaw = robot
        lines.append(f"ODOM {x:.6f} {y:.6f} {yaw:.6f} 0.1 0 0 {stamp_text(number)} host 1.0\n")
        lines.append(carmen_line(ranges, (0, 0, 0), (0, 0, 0), stamp_text(number)))
    log, report = read_recordings([write(tmp_path / "a.log", lines)], SETTINGS)
    assert report.odometry == "ODOM"
    assert report.odometry_rejected == ("FLASER (it stands still)",)
    np.testing.assert_allclose(log.odometry, robots(), atol=1e-6)


def test_lost_stamps_leave_the_order_and_a_warning(tmp_path):
    lines = [carmen_line(r, robot, robot, "0") for r, robot in zip(RANGES, robots(), strict=True)]
    log, report = read_recordings([write(tmp_path / "a.log", lines)], SETTINGS)
    np.testing.assert_array_equal(log.stamps_ns, 10**9 * np.arange(40))
    np.testing.assert_array_equal(log.ranges_m, RANGES.astype(np.float32))
    np.testing.assert_allclose(log.odometry, robots(), atol=1e-6)
    assert "time stamps are the same" in report.warnings[0]


def test_a_corrected_first_pose_is_no_mounting(tmp_path):
    corrected = robots(step_m=0.11)
    lines = [
        carmen_line(ranges, first, second, stamp_text(number))
        for number, (ranges, first, second) in enumerate(zip(RANGES, corrected, robots(), strict=True))
    ]
    log, report = read_recordings([write(tmp_path / "a.log", lines)], SETTINGS)
    np.testing.assert_array_equal(log.sensor_poses, [[0.0, 0.0, 0.0]])
    np.testing.assert_allclose(log.odometry, robots(), atol=1e-6)
    assert "no fixed amount" in report.warnings[0]


def test_a_laser_that_looks_back_keeps_its_heading(tmp_path):
    lines = [
        carmen_line(ranges, (robot[0], robot[1], np.pi + robot[2]), robot, stamp_text(number), "RLASER")
        for number, (ranges, robot) in enumerate(zip(RANGES, robots(), strict=True))
    ]
    log, _ = read_recordings([write(tmp_path / "a.log", lines)], SETTINGS)
    np.testing.assert_allclose(np.abs(log.sensor_poses[0, 2]), np.pi, atol=2e-6)


@pytest.mark.parametrize("remissions", [0, 4])
def test_robotlaser_lines_state_their_geometry(remissions, tmp_path):
    lines = []
    for number, (ranges, robot) in enumerate(zip(RANGES[:, :30], robots(), strict=True)):
        poses = " ".join(f"{value:.6f}" for value in (*laser_of(robot, 0.2), *robot))
        readings = " ".join(f"{value:.2f}" for value in ranges)
        glow = " ".join(["30", "40", "50", "60"][:remissions])
        lines.append(
            f"ROBOTLASER1 0 -1.2 2.4 0.08 50.0 0.01 0 30 {readings} {remissions} {glow} {poses} 0 0 0.5 0.5 9 "
            f"{stamp_text(number)} host 1.0\n"
        )
    log, report = read_recordings([write(tmp_path / "a.log", lines)], SETTINGS)
    assert not report.dropped
    np.testing.assert_array_equal(log.ranges_m, RANGES[:, :30].astype(np.float32))
    np.testing.assert_allclose(log.bearings_rad[0], -1.2 + 0.08 * np.arange(30))
    np.testing.assert_allclose(log.range_limits_m, [[0.01, 50.0]])
    np.testing.assert_allclose(log.sensor_poses, [[0.2, 0.0, 0.0]], atol=2e-6)


def test_a_log_with_odometry_only_has_no_laser(tmp_path):
    path = write(tmp_path / "a.log", ["ODOM 1 2 0.5 0 0 0 12.5 host 1.0\n"])
    with pytest.raises(LogError, match="no laser scans in this CARMEN text; it holds ODOM"):
        read_recordings([path], SETTINGS)


def test_wean_lines_read_back_in_metres(tmp_path):
    lines = []
    for number, (ranges, robot) in enumerate(zip(RANGES, robots(), strict=True)):
        x, y, yaw = robot * [100, 100, 1]
        ahead = np.array(laser_of(robot, 0.25)) * [100, 100, 1]
        lines.append(f"O {x:.6f} {y:.6f} {yaw:.6f} {number * 0.1 + 0.05:.6f}\n")
        cm = " ".join(f"{100 * value:.0f}" for value in ranges)
        lines.append(
            f"L {x:.6f} {y:.6f} {yaw:.6f} {' '.join(f'{v:.6f}' for v in ahead)} {cm} {number * 0.1:.6f}\n"
        )
    lines[11] = lines[11][:200] + "\n"
    path = tmp_path / "wean.log"
    path.write_text("".join(lines))
    log, report = read_recordings([path], SETTINGS)
    kept = np.delete(np.arange(40), 5)
    why = "the first is line 12 of wean.log: 40 numbers found, 187 are allowed"
    assert report.dropped == {f"L line that does not parse; {why}": 1}
    assert report.recordings[0].kind == "Wean Hall text"
    np.testing.assert_array_equal(log.stamps_ns, kept * 10**8)
    np.testing.assert_allclose(log.ranges_m, RANGES[kept], atol=1e-6)
    np.testing.assert_allclose(log.odometry, robots()[kept], atol=1e-6)
    np.testing.assert_allclose(log.sensor_poses, [[0.25, 0.0, 0.0]], atol=1e-6)
    np.testing.assert_allclose(np.degrees(log.bearings_rad[0, [0, 179]]), [-90.0, 89.0])


@pytest.mark.parametrize("n_lines", [1, 40])
def test_a_byte_order_mark_costs_no_line(n_lines, tmp_path):
    path = tmp_path / "a.log"
    path.write_bytes(codecs.BOM_UTF8 + "".join(flaser_lines()[:n_lines]).encode())
    log, report = read_recordings([path], SETTINGS)
    assert log.n_scans == n_lines
    assert not report.dropped
