"""The files that the room leaves behind."""

import re
from dataclasses import replace

import numpy as np
import pytest

from dynmap_cli.config import Config
from dynmap_cli.domain.grid import FREE, OCCUPIED, OccupancyGrid
from dynmap_cli.domain.patches import Visit
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.errors import ConfigError
from dynmap_cli.files.patch_archive import write_patches
from dynmap_cli.files.pgm import write_map
from dynmap_cli.files.scan_log import write_scan_log
from dynmap_cli.files.trajectory import parse_stamp, read_tum
from dynmap_cli.localization.outputs import HEALTH_HEADER, POSES_HEADER, STATES_HEADER
from dynmap_cli.localization.settings import LocalizationSettings
from dynmap_cli.localization.stage import run
from dynmap_cli.stage import StageContext
from tests.localization.worlds import office, patch_sets_of, pose_errors, simulated


@pytest.fixture(scope="module")
def simulated_run():
    return simulated(office())


@pytest.fixture
def folders(simulated_run, tmp_path):
    log = simulated_run.log.select(slice(0, 60))
    for name in ("scans", "map", "patches", "out"):
        (tmp_path / name).mkdir()
    write_scan_log(tmp_path / "scans", log)
    write_map(tmp_path / "map", "map", simulated_run.true_map)
    sets = patch_sets_of(simulated_run)
    submaps = [
        SubMap(s.submap_id, s.frame, 0, 0, s.varying, np.ones_like(s.varying), 1.0, name="lab door")
        for s in sets
    ]
    write_patches(tmp_path / "patches" / "patches.zip", submaps, sets, visits_of(sets))
    return tmp_path


def visits_of(sets):
    """As many visits of each state as its support says."""
    states = [(s.submap_id, p.patch_id) for s in sets for p in s.patches for _ in range(p.support)]
    return [Visit(submap_id, k, "a.mcap", k, k, state, 1.0) for k, (submap_id, state) in enumerate(states)]


def context(folder, map_yaml=None, **settings):
    config = Config(localization=LocalizationSettings(**settings))
    return StageContext(folder, folder / "out", config, (), 1, folder / "scans", map_yaml)


def rows(path):
    header, *lines = path.read_text().splitlines()
    return header, [line.split(",") for line in lines]


def test_trajectory_states_and_health_are_written(folders, simulated_run):
    summary = run(context(folders, save_particles=True))
    trajectory = read_tum(folders / "out" / "trajectory.tum")
    stamps = simulated_run.log.stamps_ns[:60]
    np.testing.assert_array_equal(trajectory.stamps_ns, stamps)
    away_m, _ = pose_errors(trajectory.poses, simulated_run.true_poses[:60])
    assert np.median(away_m) < 0.1
    header, states = rows(folders / "out" / "states.csv")
    assert header == STATES_HEADER
    by_scan = {}
    for stamp, submap, _, probability, _ in states:
        by_scan.setdefault((stamp, submap), []).append(float(probability))
    assert by_scan
    assert all(abs(sum(values) - 1) < 1e-4 and len(values) == 2 for values in by_scan.values())
    header, health = rows(folders / "out" / "health.csv")
    assert header == HEALTH_HEADER
    assert len(health) == summary["updates"] <= 60
    for row in health:
        assert abs(float(row[1]) + float(row[2]) + float(row[3]) - 1) < 1e-3
        assert row[7] in ("tracking", "changed", "lost")
    header, poses = rows(folders / "out" / "poses.csv")
    assert header == POSES_HEADER
    assert [row[0] for row in poses] == [row[0] for row in health]
    at = np.searchsorted(trajectory.stamps_ns, [parse_stamp(row[0]) for row in poses])
    values = np.array([[float(word) for word in row[1:]] for row in poses])
    np.testing.assert_allclose(values[:, :3], trajectory.poses[at], atol=2e-6)
    assert (values[:, [3, 6, 8]] > 0).all()
    assert (np.hypot(*(values[:, 9:11] - values[:, :2]).T) < 0.5).all()
    with np.load(folders / "out" / "particles.npz") as clouds:
        assert clouds["counts"].sum() == clouds["poses"].shape[0]
    assert re.match(r"60 scans from \(.*\) m, .* deg: 100 % tracking, never lost", summary["lines"][0])
    assert summary["lines"][1].startswith("sub-map 0 (lab door): state 0")


def test_a_map_server_map_needs_no_run(folders):
    plain = replace(context(folders, folders / "map" / "map.yaml"), run_dir=folders / "nowhere")
    summary = run(plain)
    assert (folders / "out" / "states.csv").read_text() == STATES_HEADER + "\n"
    assert summary["scans"] == 60
    assert summary["submaps_seen"] == 0


def test_more_particles_at_least_than_at_most_is_refused():
    with pytest.raises(ValueError, match="min_particles 50 exceeds"):
        LocalizationSettings(min_particles=50, max_particles=20)


def test_a_start_far_outside_the_map_is_refused(folders):
    with pytest.raises(ConfigError, match=r"outside the map, which reaches from x = .* m and from y = .* m"):
        run(context(folders, start=(500.0, 0.0, 0.0)))


def test_a_map_that_shows_hardly_anything_is_warned_of(folders, simulated_run):
    cells = np.full(simulated_run.true_map.frame.shape, FREE, dtype=np.int8)
    cells[0, 0] = OCCUPIED
    write_map(folders, "empty", OccupancyGrid(simulated_run.true_map.frame, cells))
    start = tuple(simulated_run.true_poses[0].tolist())
    lines = run(context(folders, folders / "empty.yaml", start=start))["lines"]
    assert any(line.startswith("warning: the map has 1 occupied cell, too few") for line in lines)


def test_a_map_that_is_mostly_walls_is_warned_of(folders):
    path = folders / "map" / "map.yaml"
    path.write_text(path.read_text().replace("negate: 0", "negate: 1"))
    lines = run(context(folders))["lines"]
    assert any("more than the" in line and "check `negate`" in line for line in lines)


def test_a_laser_that_was_blocked_is_named_with_its_times(folders, simulated_run):
    log = simulated_run.log.select(slice(0, 120))
    ranges = np.array(log.ranges_m)
    ranges[20:100] = np.inf
    write_scan_log(folders / "scans", replace(log, ranges_m=ranges))
    settings = {"start": tuple(simulated_run.true_poses[0].tolist())}
    lines = run(context(folders, **settings))["lines"]
    assert any("warning: no scan with enough returns from t = " in line for line in lines)


def test_a_start_that_is_wrong_is_said_with_where_the_robot_was_found(folders, simulated_run):
    x, y, yaw = simulated_run.true_poses[0].tolist()
    lines = run(context(folders, start=(x, y, yaw + 2.0)))["lines"]
    assert any(line.startswith("warning: the robot did not start at") for line in lines)
    right = run(context(folders, start=(x, y, yaw)))["lines"]
    assert not any("did not start" in line for line in right)


def test_a_map_that_is_read_otherwise_than_it_says_is_warned_of(folders):
    path = folders / "map" / "map.yaml"
    text = path.read_text()
    path.write_text(text.replace("free_thresh: 0.196", "free_thresh: 0.25"))
    found = run(replace(context(folders, path), run_dir=folders / "nowhere"))
    path.write_text(text)
    assert [line for line in found["lines"] if line.startswith("warning: ") and "free_thresh" in line]


def test_smoothed_poses_and_states_are_written_in_the_same_form(folders):
    run(context(folders, smooth=True))
    out = folders / "out"
    known, looked_back = (read_tum(folder / "trajectory.tum") for folder in (out, out / "smoothed"))
    np.testing.assert_array_equal(known.stamps_ns, looked_back.stamps_ns)
    assert known.poses.tolist() != looked_back.poses.tolist()
    (header, states), (again, smoothed) = (rows(f / "states.csv") for f in (out, out / "smoothed"))
    assert header == again
    assert [row[:3] for row in states] == [row[:3] for row in smoothed]
    assert (out / "health.csv").read_bytes() == (out / "smoothed" / "health.csv").read_bytes()
