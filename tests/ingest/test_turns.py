"""Shifts between sweeps, fast and plain."""

import numpy as np

from dynmap_cli.ingest.choices.turns import _best_shifts

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
