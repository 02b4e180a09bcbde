"""Simulated recordings: they open in public readers, complete and in order, and are the same again."""

import json
import math

import numpy as np
import pytest
import yaml
from click.testing import CliRunner
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from dynmap_cli.cli import main
from dynmap_cli.domain.poses import compose
from dynmap_cli.errors import ArtifactError, ConfigError
from dynmap_cli.files.pgm import read_map
from dynmap_cli.files.trajectory import read_tum
from dynmap_cli.simulation import load_scenario, parse_scenario, simulate
from dynmap_cli.simulation.recording import write_recording
from dynmap_cli.simulation.sensing import FIRST_OBJECT, MOVING, NO_RETURN
from dynmap_cli.simulation.stage import simulate_to_files

SCENARIO = {
    "seed": 3,
    "turn_deg": 20,
    "world": {
        "walls": [{"points": [[0, 0], [6, 0], [6, 4], [0, 4]], "closed": True}],
        "boxes": [
            {"name": "box", "size_m": [0.5, 0.5], "places": {"a": [5, 3, 0]}, "schedule": [[2, "absent"]]}
        ],
    },
    "movers": [{"does": "walk", "path": [[1, 3], [5, 2]]}],
    "robot": {"path": [[1, 1], [5, 1], [5, 2]], "pause_s": 20, "repeat": 2},
    "lasers": [
        {
            "beams": 61,
            "fov_deg": 180,
            "rate_hz": 5,
            "beam_interval_s": 0.001,
            "max_range_m": 4,
            "pose": [0.1, 0, 5],
        }
    ],
}
TWO = {
    **SCENARIO,
    "lasers": [
        *SCENARIO["lasers"],
        {"name": "rear", "beams": 31, "pose": [-0.2, 0.1, 180], "no_return": "zero"},
    ],
}


@pytest.fixture(scope="module")
def run():
    return simulate(parse_scenario(SCENARIO))


@pytest.fixture(scope="module")
def two_lasers():
    return simulate(parse_scenario(TWO))


def read(path):
    by_topic = {}
    with AnyReader([path]) as reader:
        for connection, time_ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            by_topic.setdefault(connection.topic, []).append((time_ns, message))
    return by_topic


def stamp_ns(header):
    return header.stamp.sec * 10**9 + header.stamp.nanosec


@pytest.mark.parametrize("suffix", [".mcap", ".bag"])
def test_rosbags_reads_back_every_number(tmp_path, two_lasers, suffix):
    path = tmp_path / f"log{suffix}"
    write_recording(path, two_lasers)
    topics, log = read(path), two_lasers.log
    assert set(topics) == {"/laser/scan", "/rear/scan", "/odom", "/tf", "/tf_static"}
    for number, topic in enumerate(("/laser/scan", "/rear/scan")):
        rows = np.flatnonzero(log.geometry_index == number)
        messages = [message for _, message in topics[topic]]
        assert [stamp_ns(message.header) for message in messages] == log.stamps_ns[rows].tolist()
        beams = len(messages[0].ranges)
        got = np.array([message.ranges for message in messages])
        expected = log.ranges_m[rows][:, :beams]
        if number:
            expected = np.where(np.isfinite(expected), expected, 0.0)
        np.testing.assert_array_equal(got, expected)
        angles = messages[0].angle_min + messages[0].angle_increment * np.arange(beams)
        np.testing.assert_allclose(angles, log.bearings_rad[number][:beams], atol=1e-5)
        assert messages[0].angle_max == pytest.approx(log.bearings_rad[number][beams - 1])
    assert [stamp_ns(m.header) for _, m in topics["/odom"]] == two_lasers.odometry.stamps_ns.tolist()
    last = topics["/odom"][-1][1].pose.pose
    assert [last.position.x, last.position.y] == two_lasers.odometry.poses[-1, :2].tolist()


@pytest.mark.parametrize("suffix", [".mcap", ".bag"])
def test_stamps_ascend_and_the_frames_reach_from_odom_to_each_laser(tmp_path, two_lasers, suffix):
    path = tmp_path / f"log{suffix}"
    write_recording(path, two_lasers)
    topics = read(path)
    for messages in topics.values():
        stamps = [
            stamp_ns(m.transforms[0].header if hasattr(m, "transforms") else m.header) for _, m in messages
        ]
        assert (np.diff(stamps) > 0).all()
    with AnyReader([path]) as reader:
        times = [time for _, time, _ in reader.messages()]
    assert (np.diff(times) >= 0).all()
    moving = topics["/tf"][0][1].transforms[0]
    assert (moving.header.frame_id, moving.child_frame_id) == ("odom", "base_link")
    fixed = {t.child_frame_id: t for t in topics["/tf_static"][0][1].transforms}
    assert set(fixed) == {topics[f"/{name}/scan"][0][1].header.frame_id for name in ("laser", "rear")}
    turn = fixed["rear"].transform.rotation
    assert abs(2 * math.atan2(turn.z, turn.w)) == pytest.approx(math.pi)
    assert all(t.header.frame_id == "base_link" for t in fixed.values())
    first, last = topics["/tf"][0][1].transforms[0], topics["/tf"][-1][1].transforms[0]
    assert stamp_ns(first.header) <= two_lasers.log.stamps_ns[0]
    assert stamp_ns(last.header) >= two_lasers.log.stamps_ns[-1]


def test_mcap_says_ros2_and_its_checksums_hold(tmp_path, run):
    path = tmp_path / "log.mcap"
    write_recording(path, run)
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        counts = {channel.topic: 0 for channel in reader.get_summary().channels.values()}
        for schema, channel, message in reader.iter_messages():
            assert schema.encoding == "ros2msg"
            assert channel.message_encoding == "cdr"
            assert message.sequence == counts[channel.topic]
            counts[channel.topic] += 1
        chunks = reader.get_summary().chunk_indexes
    assert counts["/scan"] == run.log.n_scans
    assert counts["/tf_static"] == 1
    assert {chunk.compression for chunk in chunks} == {"zstd"}


def test_carmen_lines_carry_the_numbers_of_the_run(tmp_path, two_lasers):
    write_recording(tmp_path / "log.log", two_lasers)
    rows = [line.split() for line in (tmp_path / "log.log").read_text().splitlines() if line[0] != "#"]
    stamps = [float(row[-3]) for row in rows]
    assert stamps == sorted(stamps)
    rear = [row for row in rows if row[0] == "ROBOTLASER2"]
    scans = np.flatnonzero(two_lasers.log.geometry_index == 1)
    assert len(rear) == scans.size
    ranges = np.array(rear[4][9 : 9 + 31], dtype=float)
    truth = two_lasers.log.ranges_m[scans[4]][:31]
    np.testing.assert_allclose(ranges[np.isfinite(truth)], truth[np.isfinite(truth)], atol=6e-4)
    assert (ranges[np.isinf(truth)] == 81.83).all()
    pose = np.array(rear[4][9 + 31 + 1 : 9 + 31 + 7], dtype=float)
    robot = two_lasers.log.odometry[scans[4]]
    np.testing.assert_allclose(pose[3:], robot, atol=2e-6)
    np.testing.assert_allclose(pose[:3], compose(robot, two_lasers.log.sensor_poses[1]), atol=2e-6)


def test_a_half_circle_of_one_laser_becomes_flaser_lines(tmp_path):
    half = {**SCENARIO, "lasers": [{"beams": 181, "rate_hz": 2}]}
    run = simulate(parse_scenario(half))
    write_recording(tmp_path / "log.clf", run)
    rows = [
        line.split() for line in (tmp_path / "log.clf").read_text().splitlines() if line.startswith("FLASER")
    ]
    assert len(rows) == run.log.n_scans
    assert all(int(row[1]) == 181 and len(row) == 2 + 181 + 6 + 3 for row in rows)
    with pytest.raises(ConfigError, match="CARMEN lines carry odometry"):
        write_recording(tmp_path / "none.log", simulate(parse_scenario({**half, "odometry": None})))
    assert not (tmp_path / "none.log").exists()


@pytest.mark.parametrize("suffix", [".mcap", ".bag", ".log"])
def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(tmp_path, suffix):
    scenario = tmp_path / "scenario.yaml"
    scenario.write_text(yaml.safe_dump(SCENARIO), encoding="utf-8")
    for name, seed in (("a", 3), ("b", None), ("c", 4)):
        simulate_to_files(scenario, tmp_path / f"{name}{suffix}", seed=seed)
    content = {name: (tmp_path / f"{name}{suffix}").read_bytes() for name in "abc"}
    assert content["a"] == content["b"]
    assert content["a"] != content["c"]
    for path in (tmp_path / f"a{suffix}.truth").iterdir():
        assert path.read_bytes() == (tmp_path / f"b{suffix}.truth" / path.name).read_bytes(), path.name


def test_the_truth_beside_it_is_that_of_the_run(tmp_path, run):
    scenario = tmp_path / "scenario.yaml"
    scenario.write_text(yaml.safe_dump(SCENARIO), encoding="utf-8")
    simulate_to_files(scenario, tmp_path / "log.mcap")
    truth = tmp_path / "log.mcap.truth"
    trajectory = read_tum(truth / "trajectory.tum")
    np.testing.assert_array_equal(trajectory.stamps_ns, run.log.stamps_ns)
    np.testing.assert_allclose(trajectory.poses, run.true_poses, atol=1e-6)
    with np.load(truth / "beams.npz") as beams:
        np.testing.assert_array_equal(beams["stamps_ns"], run.log.stamps_ns)
        np.testing.assert_array_equal(beams["beam_class"], run.beam_class)
        np.testing.assert_array_equal(beams["object_states"], run.object_states)
    grid, warnings = read_map(truth / "map.yaml")
    assert not warnings
    np.testing.assert_array_equal(grid.cells, run.true_map.cells)
    start = run.scenario.start.timestamp()
    assert (truth / "objects.csv").read_text().splitlines() == [
        "stamp_s,object,state",
        f"{start:.9f},box,a",
        f"{start + 2:.9f},box,absent",
    ]
    record = json.loads((truth / "truth.json").read_text())
    assert record["classes"] == {
        "static": 0, "moving": MOVING, "no_return": NO_RETURN, "mixed": 3, "first_object": FIRST_OBJECT,
    }  # fmt: skip
    box = record["objects"][0]
    assert (box["name"], box["class"], box["states"]) == ("box", 10, ["a", "absent"])
    assert parse_scenario(record["scenario"]) == run.scenario
    turned = [math.cos(math.radians(20)) * 5 - math.sin(math.radians(20)) * 3]
    assert (box["bounds_m"][0] + box["bounds_m"][2]) / 2 == pytest.approx(turned[0], abs=1e-3)


def test_the_verb_writes_refuses_to_overwrite_and_is_told_to(tmp_path):
    scenario, log = tmp_path / "scenario.yaml", tmp_path / "deep" / "log.mcap"
    scenario.write_text(yaml.safe_dump(SCENARIO), encoding="utf-8")
    words = ["simulate", str(scenario), "-o", str(log)]
    first = CliRunner().invoke(main, [*words, "--json", "-q"])
    assert first.exit_code == 0, first.output
    summary = json.loads(first.stdout)
    assert summary["scans"] == simulate(parse_scenario(SCENARIO)).log.n_scans
    before = log.read_bytes()
    again = CliRunner().invoke(main, words)
    assert again.exit_code == ArtifactError.exit_code
    assert again.stderr.splitlines()[-1].endswith(
        "exists already. Pass --force to replace it, or choose another output."
    )
    assert len(again.stderr.splitlines()) == 1
    forced = CliRunner().invoke(main, [*words, "--force", "--seed", "8"])
    assert forced.exit_code == 0, forced.output
    assert "moving" in forced.stdout
    assert log.read_bytes() != before
    assert not list(log.parent.glob("*.part"))


def test_an_unknown_suffix_is_refused_before_any_work(tmp_path):
    result = CliRunner().invoke(
        main, ["simulate", str(tmp_path / "missing.yaml"), "-o", str(tmp_path / "log.db3")]
    )
    assert result.exit_code == ConfigError.exit_code
    assert "the suffix says which kind of recording to write" in result.stderr


@pytest.mark.parametrize("day", ["monday", "tuesday"])
def test_the_sample_recordings_are_what_their_scenarios_give(sample_logs, day):
    run = simulate(load_scenario(sample_logs / f"corridor_{day}.yaml"))
    scans = [message for _, message in read(sample_logs / f"corridor_{day}.mcap")["/scan"]]
    assert [stamp_ns(scan.header) for scan in scans] == run.log.stamps_ns.tolist()
    np.testing.assert_allclose(np.array([scan.ranges for scan in scans]), run.log.ranges_m, atol=1e-5)
    assert {thing.name: len(thing.state_names) for thing in run.objects} == {"office": 2, "kitchen": 2}
    assert (sample_logs / f"corridor_{day}.mcap").stat().st_size < 3_000_000
