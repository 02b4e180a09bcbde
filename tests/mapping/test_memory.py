"""What mapping holds in memory does not grow with the beams, and tables in files give the bytes of those in memory."""

import subprocess
import sys

import numpy as np
import pytest

from dynmap_cli.domain.scans import single_laser_log
from dynmap_cli.files import tables
from dynmap_cli.files.scan_log import read_scan_log, write_scan_log
from dynmap_cli.mapping.rounds import build_filter_map
from dynmap_cli.mapping.settings import MapSettings

HALF_SIZE_M = np.array([4.0, 3.0])
N_BEAMS = 720


def rounds_in_a_room(n_scans, n_beams, step_s=1.0):
    """A robot that goes round and round in a rectangle, and somebody who stands in its way on one round of two."""
    times_s = step_s * np.arange(n_scans)
    phase = times_s / 20.0
    poses = np.column_stack([1.5 * np.cos(phase), np.sin(phase), 0.3 * np.sin(0.7 * phase)])
    bearings = np.linspace(-np.pi, np.pi, n_beams, endpoint=False)
    angles = poses[:, 2:3] + bearings
    direction = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    to_walls = (np.sign(direction) * HALF_SIZE_M - poses[:, None, :2]) / np.where(
        direction == 0, 1e-9, direction
    )
    ranges = to_walls.min(axis=-1)
    to_person = np.array([0.0, 2.2]) - poses[:, None, :2]
    along = (to_person * direction).sum(axis=-1)
    across = np.abs(to_person[..., 0] * direction[..., 1] - to_person[..., 1] * direction[..., 0])
    is_there = (np.floor(phase / np.pi) % 2 == 0)[:, None]
    ranges = np.where(is_there & (across < 0.3) & (along > 0.3), np.minimum(ranges, along - 0.3), ranges)
    ranges += np.random.default_rng(4).normal(0.0, 0.005, ranges.shape)
    return single_laser_log(
        (times_s * 1e9).astype(np.int64),
        ranges.astype(np.float32),
        bearings,
        poses,
        range_limits_m=(0.1, 20.0),
    )


@pytest.mark.slow
def test_memory_does_not_grow_with_the_beams(tmp_path):
    n_scans, peaks = (500, 1500), []
    for count in n_scans:
        folder = tmp_path / str(count)
        folder.mkdir()
        write_scan_log(folder, rounds_in_a_room(count, N_BEAMS))
        code = (
            "import sys, tracemalloc; from pathlib import Path\n"
            "import dynmap_cli.files.tables as tables\n"
            "from dynmap_cli.files.scan_log import read_scan_log\n"
            "from dynmap_cli.mapping.rounds import build_filter_map\n"
            "from dynmap_cli.mapping.settings import MapSettings\n"
            "tables._MOST_IN_MEMORY_BYTES = 1 << 16\n"
            "log = read_scan_log(Path(sys.argv[1]))\n"
            "tracemalloc.start()\n"
            "build_filter_map(log, MapSettings(), threads=1, folder=Path(sys.argv[2]))\n"
            "print(tracemalloc.get_traced_memory()[1])\n"
        )
        done = subprocess.run(
            [sys.executable, "-c", code, folder, tmp_path], capture_output=True, text=True, check=True
        )
        peaks.append(int(done.stdout))
    more_bytes = 4 * N_BEAMS * (n_scans[1] - n_scans[0])
    assert peaks[1] - peaks[0] < 0.5 * more_bytes


def test_tables_in_files_give_what_tables_in_memory_give(tmp_path, monkeypatch):
    log = rounds_in_a_room(400, 90)
    write_scan_log(tmp_path, log)
    in_memory = build_filter_map(log, MapSettings(), threads=1)
    monkeypatch.setattr(tables, "_MOST_IN_MEMORY_BYTES", 100)
    in_files = build_filter_map(read_scan_log(tmp_path), MapSettings(), threads=2, folder=tmp_path)
    assert (in_memory.filtered.static_probability < 0.5).any()
    for name in ("static_probability", "is_unknown"):
        np.testing.assert_array_equal(getattr(in_files.filtered, name), getattr(in_memory.filtered, name))
    np.testing.assert_array_equal(in_files.trajectory.poses, in_memory.trajectory.poses)
    assert in_files.rounds[-1].changed_labels == in_memory.rounds[-1].changed_labels
