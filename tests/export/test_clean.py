"""Clean recordings: what is removed, and that nothing else is touched."""

import json
from dataclasses import dataclass

import numpy as np
import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin

from dynmap_cli.cli import main
from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.domain.patches import Patch, PatchSet
from dynmap_cli.domain.scans import single_laser_log
from dynmap_cli.errors import ArtifactError, LogError
from dynmap_cli.export.cleaning import write_clean
from dynmap_cli.export.labels import BeamLabels, hits_known_state
from dynmap_cli.export.text_logs import TextChoices
from dynmap_cli.files.counting_map import read_beams, read_unknown
from dynmap_cli.files.scan_log import read_scan_log
from dynmap_cli.ingest.containers.mcap_records import mcap_attachments, mcap_metadata
from dynmap_cli.ingest.messages.stored import Losses
from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from tests.ingest.written import (
    ROS1,
    ROS2,
    SCAN,
    START_NS,
    World,
    lone_file,
    write_bag1,
    write_bag2,
    write_mcap,
)
from tests.ingest.written_foxglove import write_foxglove

KINDS = {
    "ROS 1 bag": lambda folder, world: write_bag1(folder / "a.bag", world),
    "ROS 2 folder, SQLite": lambda folder, world: write_bag2(folder / "a", world),
    "lone .db3": lambda folder, world: lone_file(write_bag2(folder / "a", world), ".db3"),
    "ROS 2 folder, MCAP": lambda folder, world: write_bag2(folder / "a", world, StoragePlugin.MCAP),
    "MCAP": lambda folder, world: write_mcap(folder / "a.mcap", world, "ros2"),
    "MCAP of ROS 1": lambda folder, world: write_mcap(folder / "a.mcap", world, "ros1", "ros1"),
}
NO_TEXT = TextChoices("", np.inf)


@dataclass(frozen=True)
class Message:
    """A message of an MCAP file."""

    topic: str
    encoding: str
    logged_ns: int
    data: bytes


def messages_of(path):
    with path.open("rb") as stream:
        return [
            Message(channel.topic, channel.message_encoding, message.log_time, message.data)
            for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages()
        ]


def stored_in(path):
    """Topic, time and bytes of all messages of a bag, as another reader sees them."""
    reader = AnyReader([path], default_typestore=ROS2)
    with reader:
        return [(one.topic, logged_ns, bytes(data)) for one, logged_ns, data in reader.messages()]


def ranges_in(message):
    scan = ROS1.deserialize_ros1 if message.encoding == "ros1" else ROS2.deserialize_cdr
    return scan(message.data, SCAN).ranges


def labels_for(log, share=0.3):
    rng = np.random.default_rng(5)
    probability = rng.random(log.ranges_m.shape).astype(np.float32)
    probability[~np.isfinite(log.ranges_m)] = np.nan
    return BeamLabels(log, probability, is_kept=~(probability < share)), probability


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("is_label", [False, True])
def test_only_removed_beams_change(tmp_path, kind, is_label):
    path = KINDS[kind](tmp_path, World())
    log, _ = read_recordings([path], IngestSettings())
    labels, probability = labels_for(log)
    out = tmp_path / "clean.mcap"
    done = write_clean([path], out, labels, text=NO_TEXT, is_label=is_label, settings=IngestSettings())
    written = messages_of(out)
    assert [one.logged_ns for one in written] == sorted(one.logged_ns for one in written)
    assert done.scans == {"/scan": log.n_scans}
    assert not done.other_scans
    assert done.removed == int((probability < 0.3).sum())
    assert done.beams == np.isfinite(log.ranges_m).sum()
    untouched = sorted(
        (one.topic, one.logged_ns, one.data) for one in written if one.topic in original_topics(is_label)
    )
    if kind != "MCAP of ROS 1":
        assert untouched == sorted(one for one in stored_in(path) if one[0] in original_topics(is_label))
    scans = [one for one in written if one.topic == "/scan"]
    for row, message in enumerate(scans):
        found, before = ranges_in(message), World().ranges_m[row]
        gone = np.zeros(before.size, dtype=bool) if is_label else probability[row] < 0.3
        np.testing.assert_array_equal(found, np.where(gone, np.float32(np.nan), before))
    beside = [one for one in written if one.topic == "/scan/static_probability"]
    assert len(beside) == (log.n_scans if is_label else 0)
    for row, message in enumerate(beside):
        scan = ROS1.deserialize_ros1 if message.encoding == "ros1" else ROS2.deserialize_cdr
        np.testing.assert_array_equal(scan(message.data, SCAN).intensities, probability[row])


def original_topics(is_label):
    return {"/tf", "/tf_static", "/odom"} | ({"/scan"} if is_label else set())


@pytest.mark.parametrize("kind", ["ROS 1 bag", "lone .db3", "MCAP"])
def test_the_result_reads_as_the_original_does(tmp_path, kind):
    path = KINDS[kind](tmp_path, World())
    log, before = read_recordings([path], IngestSettings())
    labels, probability = labels_for(log)
    out = tmp_path / "clean.mcap"
    write_clean([path], out, labels, text=NO_TEXT, is_label=False, settings=IngestSettings())
    again, after = read_recordings([out], IngestSettings())
    np.testing.assert_array_equal(again.stamps_ns, log.stamps_ns)
    np.testing.assert_array_equal(again.odometry, log.odometry)
    np.testing.assert_array_equal(again.sensor_poses, log.sensor_poses)
    np.testing.assert_array_equal(
        again.ranges_m, np.where(probability < 0.3, np.float32(np.nan), log.ranges_m)
    )
    assert after.odometry == before.odometry
    if kind != "ROS 1 bag":
        assert len(stored_in(out)) == len(stored_in(path))


def test_other_lasers_stay_as_they_are(tmp_path):
    world = World()
    extra = []
    for topic, kind, logged_ns, fields in world.messages():
        if topic == "/scan":
            extra.append(("/other/scan", kind, logged_ns, {**fields, "ranges": fields["ranges"] * 0.5}))
    path = write_mcap(tmp_path / "a.mcap", World(extra=extra), "ros2")
    log, _ = read_recordings([path], IngestSettings(scan_topic="/scan"))
    labels, _ = labels_for(log)
    out = tmp_path / "clean.mcap"
    done = write_clean([path], out, labels, text=NO_TEXT, is_label=False, settings=IngestSettings())
    assert done.scans == {"/scan": world.n_scans}
    assert done.other_scans == {"/other/scan": world.n_scans}
    others = [[one.data for one in messages_of(file) if one.topic == "/other/scan"] for file in (path, out)]
    assert others[0] == others[1]


def test_labels_of_another_recording_are_refused(tmp_path):
    log, _ = read_recordings([write_mcap(tmp_path / "a.mcap", World(), "ros2")], IngestSettings())
    other = write_mcap(tmp_path / "b.mcap", World(n_scans=5), "ros2")
    labels, _ = labels_for(log)
    with pytest.raises(ArtifactError, match="7 of the 12 scans of the run"):
        write_clean(
            [other], tmp_path / "clean.mcap", labels, text=NO_TEXT, is_label=False, settings=IngestSettings()
        )
    assert not (tmp_path / "clean.mcap").exists()


def test_drives_of_one_map_are_cleaned_one_by_one(tmp_path):
    paths = [
        write_mcap(tmp_path / name, World(start_ns=START_NS + day * 86_400 * 10**9), "ros2")
        for day, name in enumerate(("monday.mcap", "tuesday.mcap"))
    ]
    log, _ = read_recordings(paths, IngestSettings())
    labels, _ = labels_for(log)
    options = {"text": NO_TEXT, "is_label": False, "settings": IngestSettings()}
    with pytest.raises(ArtifactError, match=r"monday.mcap; tuesday.mcap: 2 drives, .* Clean each on its own"):
        write_clean(paths, tmp_path / "both.mcap", labels, **options)
    assert not (tmp_path / "both.mcap").exists()
    done = write_clean(paths[1:], tmp_path / "clean.mcap", labels, **options)
    assert sum(done.scans.values()) == World().n_scans


def test_beams_on_a_known_state_are_told_from_others():
    frame = GridFrame(0.05, 0.9, -0.25, 10, 10)
    reflectance = np.zeros((10, 10), dtype=np.float32)
    reflectance[4:7, 2] = 0.6
    patches = (Patch(0, 3, np.zeros_like(reflectance)), Patch(1, 1, reflectance))
    area = PatchSet(0, frame, reflectance > 0.5, patches, 0.9)
    ranges = np.array([[1.02, 1.3, 3.0, 1.02]], dtype=np.float32)
    log = single_laser_log(np.array([0]), ranges, np.zeros(4), np.zeros((1, 3)))
    chosen = np.array([[True, True, True, False]])
    assert hits_known_state(log, np.zeros((1, 3)), chosen, [area]).tolist() == [[True, False, False, False]]


SCENARIO = """
seed: 3
world:
  walls:
    - {points: [[0, 0], [6, 0], [6, 4], [3, 4], [3, 4.8], [2, 4.8], [2, 4], [0, 4]], closed: true}
movers: [{does: walk, path: [[2, 3], [5, 3]], speed_mps: 1.0}]
robot: {path: [[1, 1], [5, 1.2], [4, 2], [1, 1.8]], speed_mps: 0.5}
lasers: [{beams: 91, fov_deg: 270, max_range_m: 12, rate_hz: 4}]
"""


def run_dynmap(*words):
    return CliRunner().invoke(main, [str(word) for word in words])


@pytest.fixture(scope="module", params=[".mcap", ".log"])
def cleaned(tmp_path_factory, request):
    """A simulated recording with somebody walking, mapped, and cleaned by the run and without it."""
    folder = tmp_path_factory.mktemp("clean")
    (folder / "world.yaml").write_text(SCENARIO)
    log, run = folder / f"a{request.param}", folder / "run"
    for words in (
        ("simulate", folder / "world.yaml", "-o", log),
        ("ingest", log, "-o", run),
        ("map", run),
        ("clean", log, "-o", folder / "clean.mcap", "--run", run),
        ("clean", log, "-o", folder / "alone.mcap"),
        ("ingest", folder / "clean.mcap", "-o", folder / "again"),
    ):
        result = run_dynmap(*words)
        assert result.exit_code == 0, result.output
    return folder


def test_a_clean_recording_has_no_beams_that_the_run_calls_dynamic(cleaned):
    before, after = read_scan_log(cleaned / "run" / "scans"), read_scan_log(cleaned / "again" / "scans")
    is_dynamic = read_beams(cleaned / "run" / "map" / "beams.npz", before.ranges_m.shape) < 0.5
    assert is_dynamic.any()
    np.testing.assert_array_equal(after.stamps_ns, before.stamps_ns)
    np.testing.assert_allclose(after.odometry, before.odometry, atol=1e-6)
    known = np.isfinite(np.asarray(before.ranges_m)) & ~is_dynamic
    np.testing.assert_array_equal(after.ranges_m[known], before.ranges_m[known])
    assert np.isnan(after.ranges_m[is_dynamic]).all()


def test_the_run_that_is_made_in_passing_says_the_same(cleaned):
    assert (cleaned / "alone.mcap").read_bytes() == (cleaned / "clean.mcap").read_bytes()


def test_labels_are_even_odds_where_the_run_does_not_know(cleaned):
    log = next(path for path in (cleaned / "a.log", cleaned / "a.mcap") if path.exists())
    result = run_dynmap("clean", log, "-o", cleaned / "label.mcap", "--run", cleaned / "run", "--label")
    assert result.exit_code == 0, result.output
    table = cleaned / "run" / "map" / "beams.npz"
    shape = read_scan_log(cleaned / "run" / "scans").ranges_m.shape
    expected = np.where(read_unknown(table, shape), np.float32(0.5), read_beams(table, shape))
    beside = [one for one in messages_of(cleaned / "label.mcap") if one.topic.endswith("/static_probability")]
    found = np.stack([ROS2.deserialize_cdr(one.data, SCAN).intensities for one in beside])
    np.testing.assert_array_equal(found, expected)


def test_what_clean_refuses(cleaned):
    log = next(cleaned.glob("a.*g")) if (cleaned / "a.log").exists() else cleaned / "a.mcap"
    for words, says in (
        (("-o", cleaned / "clean.mcap"), "exists already"),
        (("-o", cleaned / "clean.bag"), "must end in .mcap"),
        (("-o", cleaned / "new.mcap", "--run", cleaned / "nothing"), "no such run directory"),
        (
            ("-o", cleaned / "new.mcap", "--run", cleaned / "run", "--keep", "quasi-static"),
            "is not done here",
        ),
    ):
        result = run_dynmap("clean", log, *words)
        assert result.exit_code == 5
        assert says in result.stderr
    assert not (cleaned / "new.mcap").exists()


def test_an_input_is_never_replaced(cleaned):
    before = (cleaned / "clean.mcap").read_bytes()
    result = run_dynmap("clean", cleaned / "clean.mcap", "-o", cleaned / "clean.mcap", "--force")
    assert result.exit_code == 5
    assert "the recording that is read" in result.stderr
    assert (cleaned / "clean.mcap").read_bytes() == before


def test_beams_on_known_states_are_kept_when_asked(corridor, sample_logs, tmp_path):
    log = sample_logs / "corridor_monday.mcap"
    removed = {}
    for option in ((), ("--keep", "quasi-static")):
        result = run_dynmap(
            "clean", log, "-o", tmp_path / "c.mcap", "--run", corridor.run_dir, "--force", "--json", *option
        )
        assert result.exit_code == 0, result.output
        removed[option] = json.loads(result.stdout)
    plain, kept = removed.values()
    assert plain["kept_on_changing_things"] == 0
    assert kept["removed_beams"] + kept["kept_on_changing_things"] == plain["removed_beams"]
    assert kept["kept_on_changing_things"] < 0.2 * plain["removed_beams"]


def cut(path, share=0.7):
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    return path


def with_a_bad_block(path):
    data = bytearray(path.read_bytes())
    data[data.index(b"\x28\xb5\x2f\xfd", len(data) // 2) + 60] ^= 1
    path.write_bytes(data)
    return path


DAMAGED = {
    "ROS 1 bag, cut": lambda folder, world: cut(write_bag1(folder / "a.bag", world)),
    "lone .db3, cut": lambda folder, world: cut(lone_file(write_bag2(folder / "a", world), ".db3")),
    "MCAP, cut": lambda folder, world: cut(write_mcap(folder / "a.mcap", world, "ros2")),
    "MCAP of ROS 1, cut": lambda folder, world: cut(write_mcap(folder / "a.mcap", world, "ros1", "ros1")),
    "MCAP, a block fails its checksum": lambda folder, world: with_a_bad_block(
        write_mcap(folder / "a.mcap", world, "ros2")
    ),
}


@pytest.mark.parametrize("kind", DAMAGED)
def test_a_damaged_recording_is_cleaned_as_far_as_it_is_whole(tmp_path, kind):
    path = DAMAGED[kind](tmp_path, World(n_scans=60, n_beams=40, step_rad=0.05))
    log, report = read_recordings([path], IngestSettings())
    assert 20 < log.n_scans < 60
    labels, probability = labels_for(log)
    out = tmp_path / "clean.mcap"
    done = write_clean([path], out, labels, text=NO_TEXT, is_label=False, settings=IngestSettings())
    assert done.scans == {"/scan": log.n_scans}
    assert labels.was_found.all()
    (said,) = done.losses
    assert said.split("; recovered")[1] == report.warnings[0].split("; recovered")[1]
    again, after = read_recordings([out], IngestSettings())
    np.testing.assert_array_equal(again.stamps_ns, log.stamps_ns)
    np.testing.assert_array_equal(again.odometry, log.odometry)
    np.testing.assert_array_equal(
        again.ranges_m, np.where(probability < 0.3, np.float32(np.nan), log.ranges_m)
    )
    assert not after.warnings


def test_attachments_and_metadata_of_a_cut_file_are_kept(tmp_path):
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="test")
        writer.add_attachment(1, 2, "note.txt", "text/plain", b"a note")
        writer.add_metadata("robot", {"name": "r2"})
    attachments, metadata = tuple(mcap_attachments(path, Losses())), tuple(mcap_metadata(path, Losses()))
    assert [(one.name, one.data) for one in attachments] == [("note.txt", b"a note")]
    assert [(one.name, one.metadata) for one in metadata] == [("robot", {"name": "r2"})]


def test_scans_of_foxglove_are_refused_with_the_reason(tmp_path):
    path = write_foxglove(tmp_path / "a.mcap", World(), "json")
    log, _ = read_recordings([path], IngestSettings())
    share = np.ones(log.ranges_m.shape, dtype=np.float32)
    text = TextChoices("", 8.0)
    with pytest.raises(ArtifactError, match=r"only LaserScan .* rewritten, not /scan$"):
        write_clean(
            [path],
            tmp_path / "out.mcap",
            BeamLabels(log, share),
            text=text,
            is_label=False,
            settings=IngestSettings(),
        )


def test_strict_refuses_to_clean_what_is_damaged(tmp_path):
    path = write_mcap(tmp_path / "a.mcap", World(), "")
    log, _ = read_recordings([path], IngestSettings())
    path.write_bytes(path.read_bytes()[:-100])
    share = np.ones(log.ranges_m.shape, dtype=np.float32)
    labels = BeamLabels(log, share)
    with pytest.raises(LogError, match=r"cut off or damaged .* --strict"):
        write_clean(
            [path],
            tmp_path / "out.mcap",
            labels,
            text=TextChoices("", 8.0),
            is_label=False,
            settings=IngestSettings(strict=True),
        )
