"""In which order, and in what time, the beams of a sweep are made."""

import numpy as np
import pytest

from dynmap_cli.domain.poses import compose
from dynmap_cli.domain.scans import single_laser_log
from dynmap_cli.mapping.registrar import Registrar
from dynmap_cli.scan_matching.sweeps import sweeps_of
from tests.mapping.test_local_maps import cast

STEP_S, BEAMS, SCANS = 0.1, 120, 60


def turning(said_s, sign, *, has_odometry, lag=0):
    """A robot that turns to and fro with a laser that looks all round while it turns once per sweep."""
    rates = 2.0 * np.sin(np.arange(SCANS * BEAMS + BEAMS) / (6.0 * BEAMS))
    headings = np.cumsum(rates) * STEP_S / BEAMS
    bearings = -np.pi + 2.0 * np.pi * np.arange(BEAMS) / BEAMS
    ranges = np.empty((SCANS, BEAMS), dtype=np.float32)
    for k in range(SCANS):
        for beam in range(BEAMS):
            made = beam if sign > 0 else BEAMS - 1 - beam
            there = compose(np.zeros(3), np.array([0.0, 0.0, headings[k * BEAMS + made]]))
            ranges[k, beam] = cast(there, bearings[beam : beam + 1])[0]
    poses = np.zeros((SCANS, 3))
    at = np.clip(np.arange(SCANS) + lag, 0, SCANS - 1)
    poses[:, 2] = headings[at * BEAMS]
    if not has_odometry:
        poses[:] = np.nan
    stamps_ns = (np.arange(SCANS) * STEP_S * 1e9).astype(np.int64)
    return single_laser_log(stamps_ns, ranges, bearings, poses, beam_interval_s=said_s / BEAMS)


@pytest.mark.parametrize("has_odometry", [True, False])
@pytest.mark.parametrize(("sign", "name"), [(1, "first to last"), (-1, "last to first")])
def test_the_order_is_found_though_the_odometry_lags(sign, name, has_odometry):
    log = turning(STEP_S, sign, has_odometry=has_odometry, lag=1)
    registrar = Registrar(log, 25.0)
    registrar.register(sweeps_of(log, None), "")
    assert registrar.calibration.sweep == name
    assert not registrar.calibration.is_revolution


@pytest.mark.parametrize("said_s", [0.0, 1e-3 * STEP_S])
def test_a_laser_that_looks_all_round_is_not_believed_to_do_so_in_no_time(said_s):
    log = turning(said_s, -1, has_odometry=False)
    registrar = Registrar(log, 25.0)
    registrar.register(sweeps_of(log, None), "")
    assert registrar.calibration.sweep == "last to first"
    assert registrar.calibration.is_revolution
    np.testing.assert_allclose(registrar.rays.beam_interval_s, -STEP_S / BEAMS)
