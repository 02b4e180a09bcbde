"""`dynmap check`: what is in a recording, what would be used, and whether `build` will work."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from mcap.reader import make_reader

from dynmap_cli.cli import main
from dynmap_cli.commands.screens import labelled
from dynmap_cli.ingest.choices.timing import timing_of
from dynmap_cli.ingest.raw.laser import RawLaser, ScanShape
from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from tests.ingest.written import START_NS, TF, World, lone_file, transform, write_bag1, write_bag2, write_mcap

LONG = World(n_scans=60, n_beams=40, step_rad=0.05)


def check(*words):
    return CliRunner().invoke(main, ["check", *map(str, words)])


def found(*words):
    result = check(*words, "--json")
    return json.loads(result.stdout), result


def words_of(text):
    """Its words in one line, wherever it is broken into lines."""
    return " ".join(text.split())


def test_a_screen_shows_lasers_frames_and_decisions(tmp_path):
    result = check(write_bag1(tmp_path / "a.bag", World()))
    assert result.exit_code == 0, result.output
    words = [line.split() for line in result.stdout.splitlines()]
    assert words[0][:6] == ["a.bag", "(ROS", "1", "bag):", "12", "scans"]
    assert [
        "/scan",
        "laser",
        "12",
        "9",
        "128.9",
        "8",
        "10.0",
        "0.10",
        "0.200",
        "-0.100",
        "0.0",
        "yes",
    ] in words
    text = words_of(result.stdout)
    assert "transforms complete from base_link to each laser (3 frames)" in text
    assert "time /scan: in order; steady, none missing" in text
    assert "odometry tf odom -> base_link" in text
    assert "covers 100.0 % of the scans" in text
    assert f"build will work: dynmap build {tmp_path / 'a.bag'} -o RUN" in text
    assert all(len(line) < 130 for line in result.stdout.splitlines()[1:-1])


def test_numbers_stay_with_their_units_where_lines_are_broken():
    for length in range(60, 100):
        lines = labelled(
            "odometry", [f"{'x' * length} longest gap 0.05 s, 6.0 per s, turns 1.2 deg, 2.50 m/s, 4 % of"]
        )
        assert words_of(" ".join(lines)).endswith("0.05 s, 6.0 per s, turns 1.2 deg, 2.50 m/s, 4 % of")
        assert not any(line.split()[-1].strip(".").replace(".", "").isdigit() for line in lines), lines
        assert not any(line.split()[-1] == "per" for line in lines), lines


def test_why_a_drive_is_one_of_its_own_is_broken_into_lines(tmp_path):
    first = write_bag1(tmp_path / "a.bag", World())
    second = write_bag1(tmp_path / "b.bag", World(start_ns=START_NS + 120 * 10**9, start_m=0.6))
    result = check(first, second)
    assert "apart a drive of its own: 119 s after the recording before" in words_of(result.stdout)
    assert all(len(line) < 130 for line in result.stdout.splitlines() if "build will work" not in line)


def test_json_has_the_report_of_each_drive(tmp_path):
    summary, result = found(write_bag1(tmp_path / "a.bag", World()))
    assert result.exit_code == 0
    assert summary["build_works"] is True
    assert summary["refusals"] == summary["advice"] == []
    (drive,) = summary["drives"]
    assert drive["scans"] == 12
    assert drive["lasers"][0]["name"] == "/scan"
    assert drive["lasers"][0]["timing"]["longest_gap_s"] == pytest.approx(0.1)
    assert drive["odometry_quality"]["covered"] == 1.0
    assert {"name": "/odom", "kind": "nav_msgs/msg/Odometry", "count": 12} in drive["recordings"][0]["topics"]


def test_a_recording_without_laser_still_shows_its_topics(tmp_path):
    path = write_bag1(tmp_path / "a.bag", World(with_scans=False))
    result = check(path)
    assert result.exit_code == 4
    assert "nav_msgs/msg/Odometry" in result.stdout
    assert result.stdout.endswith("build will not work\n")
    assert "no laser scans" in result.stderr
    assert len(result.stderr.splitlines()) == 1
    summary, result = found(path)
    assert result.exit_code == 4
    assert summary["build_works"] is False
    assert "no laser scans" in summary["refusals"][0]["why"]


def test_one_that_cannot_be_used_does_not_hide_the_others(tmp_path):
    good = write_bag1(tmp_path / "good.bag", World())
    (tmp_path / "bad.bag").write_bytes(b"#ROSBAG V2.0\ncut off")
    summary, result = found(good, tmp_path / "bad.bag")
    assert result.exit_code == 4
    assert [drive["recordings"][0]["name"] for drive in summary["drives"]] == ["good.bag"]
    assert [refusal["names"] for refusal in summary["refusals"]] == [[str(tmp_path / "bad.bag")]]


def test_recordings_of_the_same_time_cannot_be_built_together(tmp_path):
    later = replace(LONG, start_ns=LONG.start_ns + 10**9 * 3 // 2)
    paths = [write_bag1(tmp_path / name, world) for name, world in (("a.bag", LONG), ("b.bag", later))]
    summary, result = found(*paths)
    assert result.exit_code == 4
    assert len(summary["drives"]) == 2
    assert "overlap in time" in summary["refusals"][0]["why"]


def test_what_map_refuses_is_refused(tmp_path):
    assert "a map needs at least 2" in check(write_bag1(tmp_path / "a.bag", World(n_scans=1))).stderr
    path = write_bag1(tmp_path / "b.bag", World(with_odometry=False, with_tf=False))
    assert "without recorded pose" in check(path, "--set", "map.poses=recorded").stderr


def test_a_laser_whose_place_is_not_known_asks_for_it(tmp_path):
    world = World(with_tf=False)
    path = write_bag1(tmp_path / "a.bag", world)
    result = check(path)
    assert result.exit_code == 0
    assert "-o RUN --laser-pose X,Y,YAW" in result.stdout
    assert found(path, "--laser-pose", "0,0,0")[0]["advice"] == []
    again = check(path, "--laser-pose", "0,0,0").stdout.splitlines()[-1]
    assert again.endswith("-o RUN --set 'ingest.laser_pose=[0.0, 0.0, 0.0]'")


def test_a_tree_without_odometry_frame_is_said(tmp_path):
    lone = World(with_tf=False)
    mounting = transform("base_link", "laser", 0, lone.mounting)
    lone.extra = [("/tf_static", TF, START_NS - 1, {"transforms": [mounting]})]
    text = words_of(check(write_bag1(tmp_path / "a.bag", lone)).stdout)
    assert "complete from base_link to each laser (2 frames), but no odometry frame above base_link" in text


def test_odometry_that_jumps_asks_for_another(tmp_path):
    def world():
        class Jumping(World):
            @property
            def poses(self):
                poses = World.poses.fget(self).copy()
                poses[30:, 0] += 50.0
                return poses

        return Jumping(n_scans=60, n_beams=40, step_rad=0.05)

    summary, _ = found(write_bag1(tmp_path / "a.bag", world()))
    assert summary["drives"][0]["odometry_quality"]["jumps"] == 1
    assert summary["advice"][0]["option"] == "--odom /odom"


def test_odometry_that_stands_still_while_the_ranges_change_is_counted(tmp_path):
    summary, _ = found(write_bag1(tmp_path / "a.bag", World(n_scans=21, step_m=0.0)))
    quality = summary["drives"][0]["odometry_quality"]
    assert quality["frozen"] == quality["moving"] == 4


def laser(stamps_ns):
    result = RawLaser("/scan")
    for stamp_ns in stamps_ns:
        result.add(stamp_ns, stamp_ns, np.ones(3, dtype=np.float32), ScanShape(-1.0, 1.0, 3, 0.1, 8.0))
    return result


def test_gaps_and_disorder_are_counted():
    stamps = [START_NS + 10**8 * number for number in range(40) if number not in (10, 11, 12, 30)]
    timing = timing_of(laser(stamps))
    assert (timing.gaps, timing.missing, timing.backward) == (2, 4, 0)
    assert timing.longest_gap_s == pytest.approx(0.4)
    stamps[5], stamps[6] = stamps[6], stamps[5]
    timing = timing_of(laser(stamps))
    assert (timing.missing, timing.backward, timing.most_backward_s) == (4, 1, 0.1)


def test_check_and_ingest_state_the_same_rate_of_a_topic_whatever_the_pauses(tmp_path):
    later = World(start_ns=START_NS + 20 * 10**9, start_m=0.6, skipped=12)
    path = write_bag1(tmp_path / "a.bag", World(extra=list(later.messages())))
    row = next(line.split() for line in check(path).stdout.splitlines() if line.split()[:1] == ["/scan"])
    _, report = read_recordings([path], IngestSettings())
    (line,) = [line for line in report.lines() if line.startswith("laser /scan: ") and " per second" in line]
    assert row[6] == f"{report.lasers[0].timing.rate_hz:.1f}" == "10.0"
    assert f", {row[6]} per second" in line


def test_a_recorder_that_keeps_scans_only_on_the_way_misses_none():
    stamps = START_NS + np.cumsum(np.random.default_rng(1).exponential(1e9, 50)).astype(np.int64)
    timing = timing_of(laser(stamps.tolist()))
    assert not timing.is_steady
    assert timing.missing == 0


CUT = {
    "ros1": lambda folder: write_bag1(folder / "a.bag", LONG),
    "db3": lambda folder: lone_file(write_bag2(folder / "a", LONG), ".db3"),
    "mcap": lambda folder: write_mcap(folder / "a.mcap", LONG, ""),
}


def cut_off(container, folder):
    path = CUT[container](folder)
    path.write_bytes(path.read_bytes()[: int(0.7 * path.stat().st_size)])
    return path


@pytest.mark.parametrize("container", CUT)
def test_strict_refuses_what_is_damaged_and_nothing_else(container, tmp_path):
    path = CUT[container](tmp_path)
    assert check(path, "--strict").exit_code == 0
    path.write_bytes(path.read_bytes()[: int(0.7 * path.stat().st_size)])
    result = check(path, "--strict")
    assert result.exit_code == 4
    assert result.stderr.count("is cut off or damaged") == 1
    assert result.stderr.count(path.name) == 1
    assert "leave out --strict" in result.stderr
    result = check(path)
    assert result.exit_code == 0
    assert "cut off or damaged" in words_of(result.stdout)


def test_strict_refuses_a_text_log_with_broken_lines(tmp_path):
    path = tmp_path / "a.log"
    line = "FLASER 3 1.00 2.00 3.00 0 0 0 0 0 0 {stamp} host {stamp}\n"
    whole = "".join(line.format(stamp=1000 + 0.1 * number) for number in range(20))
    path.write_text(whole)
    assert check(path, "--strict").exit_code == 0
    path.write_text(whole + "FLASER 3 1.00 2.")
    assert "FLASER line that does not parse" in check(path, "--strict").stderr
    assert check(path).exit_code == 0


@pytest.mark.parametrize("container", CUT)
def test_what_is_salvaged_reads_back_as_what_was_read(container, tmp_path):
    path, out = cut_off(container, tmp_path), tmp_path / "out.mcap"
    summary, result = found(path, "--salvage", out)
    assert result.exit_code == 0
    assert len(summary["salvaged"]["losses"]) == 1
    before, _ = read_recordings([path], IngestSettings())
    after, _ = read_recordings([out], IngestSettings(strict=True))
    np.testing.assert_array_equal(after.ranges_m, before.ranges_m)
    np.testing.assert_array_equal(after.odometry, before.odometry)
    with out.open("rb") as stream:
        statistics = make_reader(stream, validate_crcs=True).get_summary().statistics
    assert statistics.message_count == sum(summary["salvaged"]["messages"].values())
    assert check(path, "--salvage", out).exit_code == 5
    assert check(path, "--salvage", tmp_path / "again.mcap", "--strict").exit_code == 4
    assert (tmp_path / "again.mcap").read_bytes() == out.read_bytes()
    assert check(path, "--salvage", out, "--force").exit_code == 0


def test_salvage_says_what_it_cannot_do(tmp_path):
    whole = write_bag1(tmp_path / "a.bag", World())
    assert (
        "every message that is stored was copied" in check(whole, "--salvage", tmp_path / "out.mcap").stdout
    )
    text = tmp_path / "a.log"
    text.write_text("FLASER 3 1.00 2.00 3.00 0 0 0 0 0 0 1.0 host 1.0\n" * 3)
    result = check(text, "--salvage", tmp_path / "text.mcap")
    assert result.exit_code == 5
    assert "no messages to salvage" in result.stderr
    assert "build will work" in result.stdout
    assert not (tmp_path / "text.mcap").exists()
