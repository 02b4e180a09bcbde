"""What is worked out block by block is what numpy finds of the whole columns."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynmap_cli.domain.poses import between, wrap_angle
from dynmap_cli.domain.scans import single_laser_log
from dynmap_cli.ingest.choices.merging import pauses_ns, period_s_of
from dynmap_cli.ingest.choices.timing import timing_of
from dynmap_cli.ingest.choices.track_quality import jumps_m, known_jumps_m, quality_of
from dynmap_cli.ingest.raw import columns
from dynmap_cli.ingest.raw.columns import ascends, counts_of, known_rows, picked, steps_in
from dynmap_cli.ingest.raw.laser import RawLaser, ScanShape

STAMPS = st.lists(st.integers(0, 12), min_size=1, max_size=20).map(
    lambda numbers: 10**18 + 10**8 * np.array(numbers, dtype=np.int64)
)


@pytest.fixture(autouse=True, scope="module")
def _small_blocks():
    patch = pytest.MonkeyPatch()
    patch.setattr(columns, "_ROWS_AT_ONCE", 3)
    yield
    patch.undo()


def plain_timing(stamps_ns):
    """All fields of a `Timing`, from whole columns."""
    steps_s = np.diff(stamps_ns).astype(np.float64) * 1e-9
    pauses_s = np.diff(np.unique(stamps_ns)).astype(np.float64) * 1e-9
    period_s = float(np.median(np.diff(np.unique(stamps_ns)))) * 1e-9 if pauses_s.size else 0.0
    is_steady, missing = False, np.zeros(0)
    if pauses_s.size:
        is_steady = bool(np.mean(np.abs(pauses_s / period_s - 1.0) <= 0.5) >= 0.9)
    if is_steady:
        missing = np.round(pauses_s[pauses_s > 1.5 * period_s] / period_s) - 1.0
    return (
        round(1.0 / period_s, 3) if period_s else 0.0,
        is_steady,
        round(float(pauses_s.max(initial=0.0)), 3),
        missing.size,
        int(missing.sum()),
        int(np.count_nonzero(steps_s < 0.0)),
        round(-float(steps_s.min(initial=0.0)), 3),
    )


@given(STAMPS)
def test_times_between_sweeps(stamps_ns):
    laser = RawLaser("/scan")
    for stamp_ns in stamps_ns.tolist():
        laser.add(stamp_ns, stamp_ns, np.ones(3, np.float32), ScanShape(-1.0, 1.0, 3, 0.1, 8.0))
    timing = timing_of(laser)
    assert tuple(getattr(timing, name) for name in timing.__slots__) == plain_timing(stamps_ns)
    np.testing.assert_array_equal(pauses_ns(stamps_ns), np.diff(np.unique(stamps_ns)))
    np.testing.assert_array_equal(
        np.concatenate([[0], *steps_in(stamps_ns)]), np.diff(stamps_ns, prepend=stamps_ns[0])
    )
    assert ascends(stamps_ns) == bool((np.diff(stamps_ns) >= 0).all())
    several = np.unique(stamps_ns).size > 1
    assert period_s_of(stamps_ns) == (
        float(np.median(np.diff(np.unique(stamps_ns)))) * 1e-9 if several else 0.0
    )


@given(st.lists(st.integers(1, 4), min_size=1, max_size=20))
def test_lengths_of_sweeps(lengths):
    laser = RawLaser("/scan")
    for number, length in enumerate(lengths):
        shape = ScanShape(-1.0 - number % 2, 1.0, length, 0.1, 8.0)
        laser.add(number, number, np.ones(length, np.float32), shape)
    for found, plain in zip(laser.lengths_counted, np.unique(lengths, return_counts=True), strict=True):
        np.testing.assert_array_equal(found, plain)
    values = np.array(lengths, dtype=np.int32)
    np.testing.assert_array_equal(counts_of(values, 5), np.bincount(values, minlength=5))
    order = np.argsort(values, kind="stable")
    np.testing.assert_array_equal(picked(values, order), values[order])
    assert picked(values, np.arange(values.size)) is values


@given(st.integers(2, 20), st.floats(0.0, 0.5), st.integers(0, 2**32 - 1))
def test_the_quality_of_an_odometry(n_scans, unknown, seed):
    draw = np.random.default_rng(seed)
    stamps_ns = 10**18 + np.cumsum(draw.integers(0, 3, n_scans)) * 10**7
    odometry = np.cumsum(draw.normal(0.0, 1.0, (n_scans, 3)), axis=0)
    odometry[draw.random(n_scans) < unknown] = np.nan
    log = single_laser_log(stamps_ns, np.ones((n_scans, 4)), np.arange(4.0), odometry)
    known = np.isfinite(odometry).all(axis=1)
    np.testing.assert_array_equal(known_rows(odometry), known)
    np.testing.assert_array_equal(
        known_jumps_m(stamps_ns, odometry), jumps_m(stamps_ns[known], odometry[known])
    )
    quality = quality_of(log)
    if known.sum() < 2:
        assert quality is None
        return
    assert quality is not None
    poses = odometry[known]
    steps = between(poses[:-1], poses[1:])
    seconds = np.diff(stamps_ns[known]) * 1e-9
    seconds = np.maximum(seconds, max(float(np.median(seconds)), 1e-3))
    speeds_mps = np.hypot(steps[:, 0], steps[:, 1]) / seconds
    assert quality.covered == round(known.mean(), 5)
    assert quality.fastest_mps == round(float(np.quantile(speeds_mps, 0.99)), 3)
    assert quality.turned_rad == pytest.approx(np.abs(wrap_angle(steps[:, 2])).sum(), abs=1e-3)
