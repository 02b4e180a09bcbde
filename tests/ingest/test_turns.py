"""Shifts between sweeps, fast and plain."""

import numpy as np

from dynmap_cli.ingest.choices.odometry import _turns_otherwise
from dynmap_cli.ingest.choices.turns import ScanTurns, _best_shifts

CAP_M, OVERLAP = 0.5, 0.3


def plain_shift(before, after, n_shifts):
    """The shift of the least mean difference of one pair of sweeps, over all beams that both have."""
    costs = {}
    for shift in range(-n_shifts, n_shifts + 1):
        off_m = [
            min(abs(before[beam + shift] - after[beam]), CAP_M)
            for beam in range(after.size)
            if 0 <= beam + shift < before.size and np.isfinite(before[beam + shift] - after[beam])
        ]
        if len(off_m) >= OVERLAP * before.size:
            costs[shift] = sum(off_m) / len(off_m)
    return min(costs, key=costs.get)


def test_shifts_are_those_of_the_plain_search_also_where_beams_are_missing():
    rng = np.random.default_rng(3)
    for missing in (0.0, 0.2):
        before = (5.0 + rng.normal(0.0, 0.2, (12, 200)).cumsum(axis=1)).astype(np.float32)
        shifts = rng.integers(-25, 25, 12)
        after = np.array([np.roll(row, -shift) for row, shift in zip(before, shifts, strict=True)])
        after[rng.random(after.shape) < missing] = np.nan
        found, is_told = _best_shifts(before, after, 30)
        np.testing.assert_array_equal(found, shifts)
        assert is_told.all()
        assert [plain_shift(*pair, 30) for pair in zip(before, after, strict=True)] == shifts.tolist()


def test_odometry_is_believed_where_the_sweeps_hardly_seem_to_turn():
    """In a round hall they look alike from every side; where they do turn, odometry that does otherwise is not used."""
    stamps_ns = np.arange(121) * 500_000_000
    poses = np.column_stack([np.zeros(121), np.zeros(121), np.radians(10.0) * np.arange(121)])
    for seen_deg, is_told in ((2.0, False), (-25.0, True)):
        turns = ScanTurns(stamps_ns[:-1], stamps_ns[1:], np.full(120, np.radians(seen_deg)))
        if is_told:
            poses[:, 2] = np.radians(10.0) * np.random.default_rng(1).permutation(121)
        assert bool(_turns_otherwise(turns, stamps_ns, poses)) == is_told
