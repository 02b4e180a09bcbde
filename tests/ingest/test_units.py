"""Ranges in other units than metres."""

import math

import numpy as np
import pytest

from dynmap_cli.errors import LogError
from dynmap_cli.ingest.raw.columns import RangeStore
from tests.ingest.rooms import Room
from tests.ingest.test_choices import read
from tests.ingest.written import World


def scaled(factor, reach):
    """Scans in another unit, whose reach is stated as given."""

    def change(_number, fields):
        fields.update(ranges=fields["ranges"] * np.float32(factor), range_max=reach, range_min=0.0)

    return change


@pytest.mark.parametrize(
    ("factor", "reach", "unit"),
    [
        (1000.0, 20000.0, "millimetres"),
        (1000.0, 8000.0, "millimetres"),
        (1000.0, 20.0, "millimetres"),
        (1000.0, math.inf, "millimetres"),
        (100.0, 2000.0, "centimetres"),
        (100.0, 20.0, "centimetres"),
        (100.0, math.inf, "centimetres"),
    ],
)
def test_ranges_in_other_units_become_metres(factor, reach, unit, tmp_path):
    world = Room(change=scaled(factor, reach))
    log, report = read(tmp_path, world)
    assert f"taken to be in {unit}" in report.warnings[0]
    # The largest one may be taken for a code.
    far = np.isfinite(log.ranges_m)
    assert far.mean() > 0.95
    np.testing.assert_allclose(log.ranges_m[far], world.ranges_m[far], rtol=1e-5)


def test_ranges_in_no_unit_that_is_known_are_refused(tmp_path):
    with pytest.raises(LogError, match=r"the ranges of /scan cannot be metres, half of them are above \d+"):
        read(tmp_path, Room(change=scaled(300.0, math.inf)))


def test_far_ranges_stay_as_they_are(tmp_path):
    def change(_number, fields):
        fields.update(ranges=fields["ranges"] * np.float32(12.0), range_max=100.0)

    world = World(change=change)
    log, report = read(tmp_path, world)
    assert not report.warnings
    assert np.nanmax(log.ranges_m[np.isfinite(log.ranges_m)]) > 70.0


def test_a_store_of_ranges_is_scaled_in_place(tmp_path):
    store = RangeStore(tmp_path)
    values = np.random.default_rng(1).uniform(0.0, 9.0, 3_000_000).astype(np.float32)
    for start in range(0, values.size, 1_000):
        store.add(values[start : start + 1_000])
    found = store.scaled(0.01)
    np.testing.assert_array_equal(found.read(0, values.size), values * np.float32(0.01))
