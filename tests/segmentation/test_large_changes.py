"""Changes that one time window saw: large ones count, people and displaced windows do not."""

import numpy as np
import pytest

from dynmap_cli.domain.grid import FREE, OCCUPIED
from dynmap_cli.segmentation.finding import find_submaps
from dynmap_cli.segmentation.settings import SegmentationSettings
from dynmap_cli.segmentation.windows import WindowRecord
from tests.segmentation.worlds import corridor, door

SETTINGS = SegmentationSettings()


@pytest.mark.parametrize(("changes", "says"), [([60, 91], "open once"), ([], "never open")])
def test_a_door_that_one_window_saw_open_is_a_submap(changes, says):
    run, frame = corridor(doors=[door("south", [3, 0], [4, 0], -90, changes)])
    submaps, found = find_submaps(run.log, run.true_poses, frame, SETTINGS)
    assert len(submaps) == (says == "open once")
    assert found.large.any() == (says == "open once")


def test_a_window_with_poses_that_are_off_makes_no_submap():
    run, frame = corridor()
    poses = run.true_poses.copy()
    seconds = (run.log.stamps_ns - run.log.stamps_ns[0]) / 1e9
    poses[(seconds >= 60) & (seconds < 90)] += [0.12, 0.15, 0.0]
    submaps, _ = find_submaps(run.log, poses, frame, SETTINGS)
    assert submaps == ()


@pytest.mark.parametrize("seed", range(5))
def test_windows_are_remembered_and_counted_by_group(seed):
    draw = np.random.default_rng(seed)
    n_cells, n_windows, n_groups = 45, 12, 3
    states = draw.choice([OCCUPIED, FREE, -1], size=(n_windows, n_cells)).astype(np.int8)
    group_of = draw.integers(-1, n_groups, size=n_cells)
    record = WindowRecord(n_cells)
    for window in states:
        seen = np.flatnonzero(window >= 0)
        record.add(seen, window[seen])
    for kind, counts, last in (
        (OCCUPIED, record.occupied, record.last_occupied),
        (FREE, record.free, record.last_free),
    ):
        np.testing.assert_array_equal(counts, (states == kind).sum(axis=0))
        for cell in range(n_cells):
            windows = np.flatnonzero(states[:, cell] == kind)
            assert last[cell] == (windows[-1] if windows.size else -1)
    for number in range(n_windows):
        occupied, free = record.window(number)
        np.testing.assert_array_equal(occupied, states[number] == OCCUPIED)
        np.testing.assert_array_equal(free, states[number] == FREE)
    shown = record.cells_shown(group_of, n_groups)
    for kind, counts in zip((OCCUPIED, FREE), shown, strict=True):
        plain = [
            [int((window[group_of == group] == kind).sum()) for group in range(n_groups)] for window in states
        ]
        assert counts.tolist() == plain
