"""Odd but well-formed input: used correctly, dropped with a count, or refused in one line."""

import math
import os
import socket
import stat
import warnings
import zipfile
from dataclasses import dataclass

import numpy as np
import pytest
from click.testing import CliRunner

from dynmap_cli.cli import main
from dynmap_cli.errors import LogError
from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from tests.ingest.written import (
    ODOMETRY,
    PERIOD_NS,
    START_NS,
    TF,
    World,
    carmen_line,
    odometry,
    stamp,
    transform,
    write_bag1,
    write_bag2,
)

SETTINGS = IngestSettings()
N = 20
RANGES_M = np.linspace(1.0, 4.0, 180)
WEAN_RANGES = " ".join(f"{value:.0f}" for value in 100.0 * RANGES_M)


@pytest.fixture(autouse=True)
def loud():
    """Warnings of libraries are errors."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def world_with(change=lambda number, fields: None, **settings):
    return World(n_scans=N, n_beams=30, step_rad=0.05, change=change, **settings)


def read(path):
    return read_recordings([path], SETTINGS)


def read_world(tmp_path, world):
    return read(write_bag1(tmp_path / "a.bag", world))


def refusal(path, settings=SETTINGS):
    with pytest.raises(LogError) as caught:
        read_recordings([path], settings)
    text = str(caught.value)
    assert "\n" not in text
    return text


def every(step, **values):
    """Change fields of each step-th scan."""
    return lambda number, fields: fields.update(values) if number % step == 0 else None


def restamped(new_ns):
    """Change the stamp of each scan; *new_ns* gets its number and stamp."""

    def change(number, fields):
        at = new_ns(number, START_NS + PERIOD_NS * number)
        fields["header"] = {**fields["header"], "stamp": stamp(at)}

    return change


# Fields of laser messages


@pytest.mark.parametrize("step_rad", [math.nan, math.inf, 1e30, 0.5])
def test_scans_with_angles_that_no_laser_has_are_counted(tmp_path, step_rad):
    _, report = read_world(tmp_path, world_with(every(4, angle_increment=step_rad)))
    assert report.dropped == {"scan on /scan with angles that no laser has": 5}
    assert report.scans == N - 5


@pytest.mark.parametrize("step_rad", [0.0, 1e-30, 1e-9, -0.05])
def test_an_increment_that_is_no_step_is_taken_from_the_ends(tmp_path, step_rad):
    log, report = read_world(tmp_path, world_with(every(1, angle_increment=step_rad)))
    np.testing.assert_allclose(log.bearings_rad[0], -1.0 + 0.05 * np.arange(30), atol=1e-4)
    assert not report.dropped


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf, 1e38])
def test_a_reach_that_is_none_counts_as_not_stated(tmp_path, value):
    log, report = read_world(tmp_path, world_with(every(1, range_max=value)))
    assert report.lasers[0].reach_m is None
    assert 6.0 < log.range_limits_m[0, 1] < 8.0


@pytest.mark.parametrize("fields", [{"range_min": 9.0}, {"range_max": 0.05}, {"range_min": math.inf}])
def test_one_scan_with_odd_limits_does_not_decide_for_all(tmp_path, fields):
    log, _ = read_world(tmp_path, world_with(every(N, **fields)))
    np.testing.assert_array_equal(np.isfinite(log.ranges_m), np.isfinite(world_with().ranges_m))


@pytest.mark.parametrize(
    "fields",
    [
        {"range_min": 9.0},
        {"range_max": 0.05},
        *({"ranges": np.full(30, value, np.float32)} for value in (math.nan, math.inf, -math.inf, 1e38, 0.0)),
    ],
)
def test_a_laser_without_any_return_is_refused(tmp_path, fields):
    text = refusal(write_bag1(tmp_path / "a.bag", world_with(every(1, **fields))))
    assert "no beam of any scan is a return between" in text
    assert ("range_min is not below range_max" in text) == ("ranges" not in fields)


@pytest.mark.parametrize("reach_m", [8.0, math.inf])
def test_ranges_that_no_laser_measures_are_no_returns(tmp_path, reach_m):
    far = np.full(30, 1e38, dtype=np.float32)

    def change(number, fields):
        fields["range_max"] = reach_m
        if number < 3:
            fields["ranges"] = far

    log, _ = read_world(tmp_path, world_with(change))
    assert log.ranges_m[np.isfinite(log.ranges_m)].max() < 8.0


@pytest.mark.parametrize("n_beams", [1, 2])
def test_a_laser_of_few_beams_is_read(tmp_path, n_beams):
    log, _ = read_world(tmp_path, world_with(every(1, ranges=np.full(n_beams, 2.0, np.float32))))
    assert log.ranges_m.shape == (N, n_beams)


def test_scans_without_beams_and_with_absurdly_many_are_counted(tmp_path):
    def change(number, fields):
        if number == 3:
            fields["ranges"] = np.zeros(0, dtype=np.float32)
        if number == 5:
            fields.update(ranges=np.full(100_000, 2.0, np.float32), angle_increment=5e-5)

    log, report = read_world(tmp_path, world_with(change))
    assert log.ranges_m.shape == (N - 2, 30)
    assert report.dropped == {
        "scan on /scan without beams": 1,
        "scan on /scan with over 8 times the usual 30 beams": 1,
    }


@pytest.mark.parametrize("interval_s", [math.nan, math.inf, -0.1, 1e9])
def test_times_between_beams_that_are_none_are_said(tmp_path, interval_s):
    log, report = read_world(tmp_path, world_with(every(2, time_increment=interval_s)))
    np.testing.assert_allclose(log.beam_interval_s, 0.001)
    assert "10 of 20 scans have a time_increment" in report.warnings[0]


# Stamps


@pytest.mark.parametrize(
    ("odd_ns", "reason"),
    [
        (lambda at: -at, "stamped with no possible time"),
        (lambda at: 2 * 10**9, "stamped more than a week from the others, as after a clock was set"),
        (lambda at: at + 10**17, "stamped more than a week from the others, as after a clock was set"),
        (lambda at: 0, "without a time stamp"),
    ],
)
def test_scans_at_impossible_times_are_counted(tmp_path, odd_ns, reason):
    change = restamped(lambda number, at: odd_ns(at) if number % 7 == 3 else at)
    _, report = read_world(tmp_path, world_with(change))
    assert report.scans == N - 3
    assert sum(report.dropped.values()) == 3
    assert next(iter(report.dropped)).endswith(reason)


def test_stamps_that_are_all_the_same_give_way_to_the_times_of_recording(tmp_path):
    _, report = read_world(tmp_path, world_with(restamped(lambda number, at: START_NS)))
    assert report.span_s > 1.0
    assert "all scans have the same time stamp" in report.warnings[0]


def test_a_clock_that_was_set_back_is_said_with_numbers(tmp_path):
    change = restamped(lambda number, at: at - (3600 * 10**9 if number >= 15 else 0))
    _, report = read_world(tmp_path, world_with(change))
    said = " ".join(report.warnings)
    assert "go back by up to 3599.9 s" in said
    assert "no scans for up to" in said
    assert "5 scans have no odometry" in said
    assert report.out_of_order == 1


@pytest.mark.parametrize(("first", "used"), [(10, 20), (8, 12), (12, 12)])
def test_of_two_clocks_in_one_recording_few_scans_are_left_out_and_many_moved(tmp_path, first, used):
    def on_old_clock(number, fields):
        if number < first:
            fields["header"]["stamp"] = stamp(100 * 10**9 + number * PERIOD_NS)

    log, report = read_world(tmp_path, world_with(on_old_clock, with_tf=False, with_odometry=False))
    assert log.n_scans == used
    assert sum(report.dropped.values()) == N - used
    assert (log.stamps_ns < START_NS - 10**10).all() == (first > N / 2)
    said = [line for line in report.warnings if "the clock was set while it was made" in line]
    assert len(said) == (first == 10)
    for line in said:
        assert (
            "/scan jumps by +1699999900.123 s against the times of recording; by these the stamps are" in line
        )
    assert (np.diff(log.stamps_ns) == PERIOD_NS).all()


def test_where_no_scan_can_be_used_the_refusal_says_so(tmp_path):
    absurd = world_with(every(1, angle_min=-900.0, angle_max=900.0, angle_increment=62.0))
    text = refusal(write_bag1(tmp_path / "a.bag", absurd))
    assert (
        "none of the laser scans in this ROS 1 bag can be used; 20 x scan on /scan with angles that no laser has"
        in text
    )


def test_scans_that_share_a_stamp_are_said(tmp_path):
    _, report = read_world(
        tmp_path, world_with(restamped(lambda number, at: START_NS + PERIOD_NS * (number // 2)))
    )
    assert "10 scans have the stamp of the scan before but other ranges" in report.warnings


@pytest.mark.parametrize("text", ["1e10", "1e400", "9" * 30, "nan", "inf", "-5.0", "9" * 5000, "x"])
def test_lines_with_a_stamp_that_is_no_time_are_counted(tmp_path, text):
    lines = [line.decode() for line in carmen_text()]
    lines[4] = lines[4].replace(" 104.5 ", f" {text} ")
    lines.append(f"ODOM 0 0 0 0 0 0 {text} host 0.5\n")
    path = tmp_path / "a.log"
    path.write_text("".join(lines))
    _, report = read(path)
    assert report.scans == N - 1
    assert [reason.split(";")[0] for reason in report.dropped] == [
        "FLASER line that does not parse",
        "ODOM line that does not parse",
    ]
    assert set(report.dropped.values()) == {1}
    assert all("seconds from 0 to 4611686018 are allowed" in reason for reason in report.dropped)


@pytest.mark.parametrize("text", ["1e10", "1e400", "9" * 30, "nan"])
def test_wean_lines_with_a_stamp_or_pose_that_is_none_are_counted(tmp_path, text):
    good = [f"L 1 2 0.5 1 2 0.5 {WEAN_RANGES} {number}.5\n" for number in range(1, 6)]
    bad = [
        f"L 1 2 0.5 1 2 0.5 {WEAN_RANGES} {text}\n",
        f"O {text} 2 0.5 9.5\n",
        f"L {text} 2 0.5 1 2 0.5 {WEAN_RANGES} 3.5\n",
    ]
    path = tmp_path / "a.log"
    path.write_text("".join(good + bad[: 3 if text != "1e10" else 1]))
    _, report = read(path)
    assert report.scans == 5
    assert sum(report.dropped.values()) == (3 if text != "1e10" else 1)


# Transforms and odometry

ODD_POSES = {
    "nan": (math.nan, 0, 0, 0, 0, 0, 1),
    "no rotation": (0, 0, 0, 0, 0, 0, 0),
    "far": (1e9, 0, 0, 0, 0, 0, 1),
    "very far": (1e300, 0, 0, 0, 0, 0, 1),
    "huge rotation": (0, 0, 0, 1e200, 0, 0, 1),
    "huge, and in one component only": (0, 0, 0, 1e200, 0, 0, 0),
}


@pytest.mark.parametrize("kind", ODD_POSES)
def test_transforms_and_odometry_that_are_no_pose_are_counted(tmp_path, kind):
    at = START_NS + 5 * PERIOD_NS + 1
    extra = [
        ("/tf", TF, at, {"transforms": [transform("odom", "base_link", at, ODD_POSES[kind])]}),
        ("/odom", ODOMETRY, at, odometry("odom", "base_link", at, ODD_POSES[kind])),
    ]
    log, report = read_world(tmp_path, world_with(extra=extra))
    np.testing.assert_allclose(log.odometry, world_with().poses, atol=1e-12)
    assert report.dropped == {
        "transform that is no pose or has no possible time": 1,
        "odometry on /odom that is no pose or has no possible time": 1,
    }


def test_odometry_that_is_not_in_order_is_said_with_numbers(tmp_path):
    x, y, yaw = world_with().poses[0]
    turn = (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
    late = ("/odom", ODOMETRY, START_NS + 10**10, odometry("odom", "base_link", START_NS, (x, y, 0.0, *turn)))
    world = world_with(extra=[late, late])
    world.with_tf = False
    log, report = read_world(tmp_path, world)
    np.testing.assert_allclose(log.odometry, world.poses, atol=1e-12)
    assert any(
        "odometry /odom: of 22 poses 1 were stamped before their predecessor and 1 like it" in line
        for line in report.warnings
    )


@pytest.mark.parametrize("step_m", [1e4, 1e6])
def test_odometry_that_jumps_all_the_time_is_not_used(tmp_path, step_m):
    _, report = read_world(tmp_path, world_with(step_m=step_m))
    assert report.odometry == "none"
    assert report.odometry_rejected[0].endswith(f"(it jumps 19 times between scans, by up to {step_m:.1f} m)")


@dataclass
class Reset(World):
    jump_m: float = 1e4
    every: int = 10

    @property
    def poses(self):
        return super().poses + np.outer(np.arange(self.n_scans) // self.every, (self.jump_m, 0.0, 0.0))


@pytest.mark.parametrize("jump_m", [1e4, 1e6])
def test_odometry_that_jumps_is_said_with_numbers(tmp_path, jump_m):
    _, report = read_world(tmp_path, Reset(n_scans=60, every=15, jump_m=jump_m))
    assert "jumps 3 times between one scan and the next, by up to" in report.warnings[0]
    assert f"{jump_m + 0.05 * np.cos(0.3):.1f} m" in report.warnings[0]


def test_odometry_that_jumps_once(tmp_path):
    _, report = read_world(tmp_path, Reset(n_scans=N))
    assert "the odometry jumps once between one scan and the next" in report.warnings[0]


def test_a_laser_far_from_its_robot_is_refused(tmp_path):
    text = refusal(write_bag1(tmp_path / "a.bag", world_with(mounting=(1e5, 0, 0, 0, 0, 0, 1))))
    assert "/scan would sit 100000 m from the centre of the robot (at most 20 m)" in text


def test_names_that_cannot_be_printed_do_not_break_lines(tmp_path):
    def change(_, fields):
        fields["header"] = {**fields["header"], "frame_id": "la\nser\x1b[31m"}

    _, report = read_world(tmp_path, world_with(change))
    assert all(line.isprintable() for line in report.lines())


# Text


def carmen_text(end="\n"):
    poses = World(n_scans=N).poses
    lines = [carmen_line(RANGES_M, pose, pose, f"{100 + k}.5") for k, pose in enumerate(poses)]
    return [line.replace("\n", end).encode() for line in lines]


@pytest.mark.parametrize(
    ("odd", "reason"),
    [
        (b"FLASER 180 1.0\x00\x00 2.0\n", "line with null bytes, as unclean shutdowns leave them"),
        (b"\xff\xfe\x80 broken\n", "line of no known kind"),
        (
            b"FLASER 180 \xff\xfe\n",
            "FLASER line that does not parse; the first is line 6 of a.log: 180 readings announced, which takes 191 "
            "words; 3 found",
        ),
        (b"FLASER " + b"1" * (9 << 20) + b"\n", "line longer than 8 MiB"),
        (
            b"FLASER 99999999999999999999 1 2 3 4 5 6 7 8 9 10\n",
            "FLASER line that does not parse; the first is line 6 of a.log: count of readings '99999999999999999999'; "
            "whole numbers from 1 to 8388608 are allowed",
        ),
        (
            b"ODOM 1 2 3 0 0 0 101.5 host\n",
            "ODOM line that does not parse; the first is line 6 of a.log: 9 words found, 10 are allowed",
        ),
        (
            b"ROBOTLASER1 0 nan 3.14 0.01 80 0 0 2 1 1 0 0 0 0 0 0 0 0 0 0 0 0 1 h 1\n",
            "ROBOTLASER1 line that does not parse; the first is line 6 of a.log: start angle, field of view, "
            "resolution, range 'nan', '3.14', '0.01', '80'; numbers from -1e+08 to 1e+08 are allowed",
        ),
    ],
)
def test_odd_lines_are_counted(tmp_path, odd, reason):
    lines = carmen_text()
    path = tmp_path / "a.log"
    path.write_bytes(b"".join([*lines[:5], odd, *lines[5:]]))
    _, report = read(path)
    assert report.scans == N
    assert report.dropped == {reason: 1}


def test_line_ends_of_windows_are_read(tmp_path):
    path = tmp_path / "a.log"
    path.write_bytes(b"".join(carmen_text("\r\n")))
    _, report = read(path)
    assert report.scans == N
    assert not report.dropped


def test_ranges_too_large_for_a_float_are_no_returns(tmp_path):
    lines = carmen_text()
    words = lines[3].split()
    words[4:9] = [b"1e39", b"-1e39", b"1e300", b"1e400", b"nan"]
    lines[3] = b" ".join(words) + b"\n"
    path = tmp_path / "a.log"
    path.write_bytes(b"".join(lines))
    log, _ = read(path)
    assert np.isfinite(log.ranges_m[3]).sum() == 175


# Files and archives


def test_pipes_sockets_and_devices_are_refused_at_once(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "pipe.log")
    with socket.socket(socket.AF_UNIX) as server:
        monkeypatch.chdir(tmp_path)
        server.bind("s.log")
    for path in (tmp_path / "pipe.log", tmp_path / "s.log", "/dev/zero"):
        result = CliRunner().invoke(main, ["ingest", str(path), "-o", str(tmp_path / "run"), "-q"])
        assert result.exit_code == 4, result.output
        assert (
            result.stderr
            == f"dynmap: {path}: neither a regular file nor a folder. Copy the recording into a file first.\n"
        )


def test_a_bag_folder_with_a_pipe_in_it_is_refused(tmp_path):
    folder = write_bag2(tmp_path / "drive", World())
    storage = next(folder.glob("*.db3"))
    storage.unlink()
    os.mkfifo(storage)
    assert "neither a regular file nor a folder" in refusal(folder)


@pytest.mark.parametrize("verb", ["check", "ingest"])
def test_names_that_no_file_can_have_are_refused(tmp_path, verb):
    (tmp_path / "loop").symlink_to("loop")
    out = ["-o", str(tmp_path / "run")] if verb == "ingest" else []
    for name in ("x" * 5000, "loop", "none\nthere"):
        result = CliRunner().invoke(main, [verb, str(tmp_path / name), *out, "-q"])
        assert result.exit_code == 4
        assert result.stderr.startswith("dynmap: ")
        assert len(result.stderr.splitlines()) == 1
        assert len(result.stderr) < 500


def test_loops_of_links_in_a_folder_are_passed_over(tmp_path):
    write_bag1(tmp_path / "a.bag", World())
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "up").symlink_to(tmp_path)
    os.mkfifo(tmp_path / "pipe")
    _, report = read(tmp_path)
    assert report.scans == 12


def test_file_names_that_are_not_utf8_are_read(tmp_path):
    path = write_bag1(tmp_path / "a.bag", World())
    odd = tmp_path / os.fsdecode(b"caf\xe9.bag")
    path.rename(odd)
    result = CliRunner().invoke(main, ["ingest", str(odd), "-o", str(tmp_path / "run"), "-q"])
    assert result.exit_code == 0, result.output


def test_packed_many_times_over_is_refused(tmp_path):
    path = write_bag1(tmp_path / "a.bag", World())
    for layer in range(7):
        target = tmp_path / f"{layer}.zip"
        with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.write(path, path.name)
        path = target
        if layer == 2:
            assert read(path)[1].scans == 12
    assert "packed more than 5 times over" in refusal(path)


def test_an_encrypted_member_is_refused(tmp_path):
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.write(write_bag1(tmp_path / "a.bag", World()), "a.bag")
    data = bytearray(path.read_bytes())
    data[6] |= 1
    data[data.index(b"PK\x01\x02") + 8] |= 1
    path.write_bytes(data)
    assert "encrypted" in refusal(path)


@pytest.mark.parametrize("how", [zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_wrong_bytes_in_a_zip_are_said(tmp_path, how):
    path = tmp_path / "a.zip"
    bag = write_bag1(tmp_path / "a.bag", World())
    with zipfile.ZipFile(path, "w", how) as archive:
        archive.write(bag, "a.bag")
    data = path.read_bytes()
    for at in range(60, len(data) - 200, len(data) // 12):
        path.write_bytes(data[:at] + b"\x55\xaa\x55" + data[at + 3 :])
        assert "zip file is damaged" in refusal(path, IngestSettings(strict=True))
        try:
            _, report = read(path)
        except LogError as err:
            assert "zip file is damaged" in str(err)
        else:
            assert "zip file is damaged" in report.warnings[0]


def test_a_file_that_may_not_be_read_is_refused(tmp_path):
    path = write_bag1(tmp_path / "a.bag", World())
    path.chmod(0)
    if os.access(path, os.R_OK):
        pytest.skip("this user reads everything")
    assert "cannot be read" in refusal(path)
    path.chmod(stat.S_IRUSR)
