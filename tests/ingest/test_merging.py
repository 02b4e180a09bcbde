"""Several recordings of one drive, and recordings that are none."""

import numpy as np
import pytest

from dynmap_cli.config import Config
from dynmap_cli.errors import LogError
from dynmap_cli.files.scan_log import SCAN_FILES, read_scan_log
from dynmap_cli.ingest.choices.merging import add_drives
from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from dynmap_cli.ingest.stage import run
from dynmap_cli.stage import StageContext
from tests.ingest.written import START_NS, World, write_bag1

SETTINGS = IngestSettings()
NEXT = START_NS + 12 * 10**8


def parts(tmp_path, first, second):
    return [write_bag1(tmp_path / "first.bag", first), write_bag1(tmp_path / "second.bag", second)]


def test_static_transforms_of_the_first_part_serve_the_second(tmp_path):
    second = World(start_ns=NEXT, start_m=0.6, static_topic="/elsewhere")
    log, report = read_recordings(list(reversed(parts(tmp_path, World(), second))), SETTINGS)
    assert log.recordings == ("first.bag", "second.bag")
    assert log.n_scans == 24
    np.testing.assert_allclose(log.odometry, np.vstack([World().poses, second.poses]), atol=1e-12)
    np.testing.assert_allclose(log.sensor_poses, [[0.2, -0.1, 0.0]])
    assert report.odometry_path_m == pytest.approx(23 * 0.05)


@pytest.mark.parametrize(
    ("second", "why"),
    [
        (World(start_ns=NEXT, start_m=30.0), "the odometry jumps by 29.4 m before it"),
        (World(start_ns=NEXT, yaw_rad=0.0), "its odometry starts at the origin again"),
        (World(start_ns=NEXT + 120 * 10**9, start_m=0.6), "120 s after the recording before"),
        (
            World(
                start_ns=NEXT, change=lambda _number, fields: fields["header"].update(frame_id="base_link")
            ),
            "no laser in common",
        ),
    ],
)
def test_recordings_that_do_not_continue_one_another_are_drives_of_their_own(second, why, tmp_path):
    log, report = read_recordings(parts(tmp_path, World(), second), SETTINGS)
    assert log.drive_of_recording.tolist() == [0, 1]
    assert log.n_drives == 2
    assert log.recordings_of(1) == ("second.bag",)
    assert (log.drive_index == log.recording_index).all()
    np.testing.assert_allclose(log.odometry, np.vstack([World().poses, second.poses]), atol=1e-12)
    assert [drive.scans for drive in report.drives] == [12, 12]
    assert report.drives[1].why_apart.startswith(why)
    assert f"a drive of its own: {report.drives[1].why_apart}" in report.lines()


def test_a_restart_in_the_midst_of_three_recordings_splits_them_there(tmp_path):
    paths = parts(tmp_path, World(), World(start_ns=NEXT, start_m=0.6))
    again = World(start_ns=NEXT + 12 * 10**8, yaw_rad=0.0)
    log, _ = read_recordings([*paths, write_bag1(tmp_path / "third.bag", again)], SETTINGS)
    assert log.drive_of_recording.tolist() == [0, 0, 1]


def test_recordings_without_a_date_come_in_the_order_given(tmp_path):
    worlds = [World(start_ns=10**9, yaw_rad=0.0), World(start_ns=5 * 10**8, yaw_rad=0.1)]
    log, report = read_recordings(list(reversed(parts(tmp_path, *worlds))), SETTINGS)
    assert log.recordings == ("second.bag", "first.bag")
    assert log.drive_of_recording.tolist() == [0, 1]
    assert report.drives[1].why_apart.startswith("61 s after")
    (warning,) = report.warnings
    assert "first.bag: its stamps have no date" in warning
    np.testing.assert_allclose(log.odometry, np.vstack([worlds[1].poses, worlds[0].poses]), atol=1e-12)
    first, second = (read_recordings([tmp_path / name], SETTINGS)[0] for name in ("first.bag", "second.bag"))
    added = add_drives(first, second)
    assert added.recordings == ("first.bag", "second.bag")
    assert added.drive_index.tolist() == [0] * 12 + [1] * 12
    assert added.stamps_ns[12] - added.stamps_ns[11] == 61 * 10**9


def test_a_recording_that_is_given_twice_is_refused(tmp_path):
    with pytest.raises(LogError, match=r"the same recording\. Pass it once"):
        read_recordings(parts(tmp_path, World(), World()), SETTINGS)


def test_recordings_made_at_the_same_time_are_refused(tmp_path):
    second = World(start_ns=START_NS - 2 * 10**9, n_scans=40)
    with pytest.raises(LogError, match=r"they overlap in time by .* leave one of them out"):
        read_recordings(parts(tmp_path, World(), second), SETTINGS)


def test_the_stage_writes_scans_that_read_back_and_the_same_bytes_each_time(tmp_path):
    paths = parts(tmp_path, World(), World(start_ns=NEXT, start_m=0.6))
    contents = []
    for name in ("one", "two"):
        folder = tmp_path / name
        folder.mkdir()
        context = StageContext(tmp_path, folder, Config(), tuple(paths), 1, scans_dir=folder)
        summary = run(context)
        assert {f"scans/{path.name}" for path in folder.iterdir()} == set(SCAN_FILES)
        contents.append({path.name: path.read_bytes() for path in folder.iterdir()})
    assert contents[0] == contents[1]
    log, _ = read_recordings(paths, SETTINGS)
    found = read_scan_log(folder)
    np.testing.assert_array_equal(found.ranges_m, log.ranges_m)
    np.testing.assert_array_equal(found.odometry, log.odometry)
    assert found.recordings == ("first.bag", "second.bag")
    assert summary["scans"] == 24
    assert summary["lines"][0].startswith(
        "first.bag (ROS 1 bag), second.bag (ROS 1 bag): 24 scans over 2.3 s"
    )


def test_recordings_of_one_file_name_are_told_apart(tmp_path):
    paths = []
    for folder in ("monday", "tuesday"):
        (tmp_path / folder).mkdir()
        paths.append(write_bag1(tmp_path / folder / "log.bag", World(n_scans=40)))
    with pytest.raises(LogError, match="the same recording") as caught:
        read_recordings(paths, SETTINGS)
    assert all(str(path) in str(caught.value) for path in paths)
    assert read_recordings(paths[:1], SETTINGS)[0].recordings == ("log.bag",)


def test_what_is_no_recording_is_named_by_its_path(tmp_path):
    (tmp_path / "README.md").write_text("# not a log\n")
    with pytest.raises(LogError) as caught:
        read_recordings([tmp_path / "README.md"], SETTINGS)
    assert str(caught.value).startswith(f"{tmp_path / 'README.md'}: not a known recording")
