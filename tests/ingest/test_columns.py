"""Columns that grow, ranges in files, and what is computed of them block by block."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynmap_cli.domain.mapped import mapping_of
from dynmap_cli.errors import ArtifactError
from dynmap_cli.files import space, tables
from dynmap_cli.files.tables import new_table
from dynmap_cli.ingest.choices.ranges import Farthest, find_reach_m
from dynmap_cli.ingest.raw import columns
from dynmap_cli.ingest.raw.columns import (
    Growing,
    RangeStore,
    blocks_of,
    kept_rows,
    picked_rows,
    put_rows,
)
from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from dynmap_cli.ingest.space import Space
from tests.ingest.test_choices import second_laser
from tests.ingest.written import World, write_bag1, write_mcap


@pytest.fixture
def tiny(monkeypatch):
    """Nearly nothing may be held in memory."""
    monkeypatch.setattr(columns, "_MOST_IN_MEMORY_BYTES", 100)
    monkeypatch.setattr(tables, "_MOST_IN_MEMORY_BYTES", 100)
    monkeypatch.setattr(columns, "_MOST_OF_COLUMN_BYTES", 60)
    monkeypatch.setattr(columns, "_BLOCK_BYTES", 200)


def grown(parts, width):
    column = Growing(np.float64, width)
    for number, part in enumerate(parts):
        if number % 2:
            column.extend(part)
        else:
            for row in part:
                column.add(row)
    return column


@pytest.mark.parametrize("width", [0, 3])
def test_a_column_holds_what_was_added_in_memory_and_in_a_file(tiny, width):
    rng = np.random.default_rng(0)
    parts = [rng.random((n, width) if width else n) for n in (1, 5, 0, 7, 2)]
    column = grown(parts, width)
    np.testing.assert_array_equal(column.rows, np.concatenate(parts))
    column.add(parts[0][0])
    column.give_back()
    np.testing.assert_array_equal(column.rows, np.concatenate([*parts, parts[0][:1]]))
    column.rows = column.rows[::2]
    np.testing.assert_array_equal(column.rows, np.concatenate([*parts, parts[0][:1]])[::2])


@given(st.lists(st.integers(1, 12), min_size=1, max_size=30), st.integers(0, 2**32 - 1), st.booleans())
def test_sweeps_come_back_from_the_store_in_any_order(lengths, seed, in_file):
    draw = np.random.default_rng(seed)
    before = columns._MOST_IN_MEMORY_BYTES
    columns._MOST_IN_MEMORY_BYTES = 100 if in_file else before
    try:
        stores, sweeps, places = [RangeStore(), RangeStore()], [], []
        for number, length in enumerate(lengths):
            sweeps.append(draw.random(length).astype(np.float32))
            places.append((number % 2, stores[number % 2].add(sweeps[-1])))
            if draw.random() < 0.2:
                stores[0].read(0, 0)
        moved = stores[0].take_over(stores[1])
        at = np.array([place + moved * owner for owner, place in places])
        order = draw.permutation(len(sweeps))
        table = np.full((len(sweeps), 12), -1.0, dtype=np.float32)
        stores[0].fill(table, at[order], np.array(lengths)[order])
    finally:
        columns._MOST_IN_MEMORY_BYTES = before
    for row, number in enumerate(order):
        np.testing.assert_array_equal(table[row, : lengths[number]], sweeps[number])
        assert (table[row, lengths[number] :] == -1.0).all()


@pytest.mark.parametrize("in_file", [False, True])
def test_a_store_becomes_a_table_unless_another_one_holds_the_same_numbers(in_file, monkeypatch):
    monkeypatch.setattr(columns, "_MOST_IN_MEMORY_BYTES", 100 if in_file else 1 << 20)
    values = np.random.default_rng(3).random((40, 7)).astype(np.float32)
    alone, joined, other = RangeStore(), RangeStore(), RangeStore()
    for rows in (slice(0, 1), slice(1, 5), slice(5, 40)):
        alone.add(values[rows])
        other.add(values[rows])
    table = alone.as_table(40, 7)
    np.testing.assert_array_equal(table, values)
    table[3] = 0.0
    np.testing.assert_array_equal(alone.read(21, 28), table[3])
    joined.take_over(other)
    assert joined.as_table(40, 7) is None
    assert other.as_table(40, 7) is None


def test_tables_in_a_file_are_like_those_in_memory(tiny):
    values = np.random.default_rng(1).random((40, 7)).astype(np.float32)
    table = new_table(40, 7, None)
    assert mapping_of(table) is not None
    for rows in blocks_of(table):
        table[rows] = values[rows]
    wanted = values[:, 0] < 0.5
    numbers = np.flatnonzero(wanted)
    np.testing.assert_array_equal(picked_rows(table, numbers, None), values[wanted])
    put_rows(table, numbers, -values[wanted])
    expected = np.where(wanted[:, None], -values, values)
    np.testing.assert_array_equal(table, expected)
    np.testing.assert_array_equal(kept_rows(table, wanted), expected[wanted])


@given(st.integers(1, 400), st.integers(0, 2**32 - 1))
def test_the_farthest_returns_are_those_of_numpy(n_values, seed):
    draw = np.random.default_rng(seed)
    values = draw.random((n_values, 3)).astype(np.float32)
    mask = draw.random(values.shape) < 0.8
    farthest = Farthest(0.9, values.size)
    for start in range(0, n_values, 17):
        farthest.add(values[start : start + 17], mask[start : start + 17])
    if mask.any():
        assert farthest.value == pytest.approx(float(np.quantile(values[mask].astype(np.float64), 0.9)))
    else:
        assert np.isnan(farthest.value)


def test_the_reach_does_not_depend_on_the_blocks(monkeypatch):
    ranges = np.random.default_rng(2).uniform(0.5, 20.0, (300, 40)).astype(np.float32)
    ranges[::3, ::5] = 81.83
    whole = find_reach_m(ranges)
    monkeypatch.setattr(columns, "_BLOCK_BYTES", 1000)
    assert find_reach_m(ranges) == whole == pytest.approx(0.99 * 81.83)


@pytest.mark.parametrize("out_of_order", [False, True])
@pytest.mark.parametrize("two_lasers", [False, True])
def test_a_recording_too_large_for_memory_is_read_as_a_small_one(
    tmp_path, monkeypatch, request, two_lasers, out_of_order
):
    def change(number, fields):
        if number == 7:
            fields["ranges"] = np.full(9, np.nan, dtype=np.float32)
        if out_of_order and number in {4, 5}:
            fields["header"]["stamp"] = {"sec": 1_700_000_000, "nanosec": 123_456_789 + 10**8 * (9 - number)}
        if two_lasers and number % 3:
            fields["ranges"] = fields["ranges"][:6]

    world = World(n_scans=30, change=change)
    if two_lasers:
        world.extra = second_laser(world)
    path = write_bag1(tmp_path / "a.bag", world)
    small, said = read_recordings([path], IngestSettings())
    request.getfixturevalue("tiny")
    large, again = read_recordings([path], IngestSettings(), tmp_path)
    assert mapping_of(large.ranges_m) is not None
    assert again == said
    for name in ("stamps_ns", "ranges_m", "odometry", "geometry_index", "bearings_rad", "arrival_index"):
        np.testing.assert_array_equal(getattr(large, name), getattr(small, name))


def test_memory_does_not_grow_with_the_ranges(tmp_path):
    """Twice the scans take a few small columns more, not their ranges."""
    n_beams, peaks = 720, []
    for n_scans in (1000, 3000):
        world = World(n_scans=n_scans, n_beams=n_beams, first_rad=-3.0, step_rad=6.0 / n_beams)
        # Chunks of a usual size: the reader keeps an index of them.
        path = write_mcap(tmp_path / f"{n_scans}.mcap", world, "ros2", chunk_size=1 << 20)
        code = (
            "import sys, tracemalloc; from pathlib import Path\n"
            "import dynmap_cli.ingest.raw.columns as columns\n"
            "import dynmap_cli.files.tables as tables\n"
            "import dynmap_cli.ingest.containers.bags\n"
            "from dynmap_cli.ingest.reading import read_recordings\n"
            "from dynmap_cli.ingest.settings import IngestSettings\n"
            "tables._MOST_IN_MEMORY_BYTES = 1 << 16\n"
            "columns._MOST_IN_MEMORY_BYTES = columns._MOST_OF_COLUMN_BYTES = columns._BLOCK_BYTES = 1 << 16\n"
            "dynmap_cli.ingest.containers.bags.Batches._BATCH = 1\n"
            "tracemalloc.start()\n"
            "read_recordings([Path(sys.argv[1])], IngestSettings(), Path(sys.argv[2]))\n"
            "print(tracemalloc.get_traced_memory()[1])\n"
        )
        done = subprocess.run(
            [sys.executable, "-c", code, path, tmp_path], capture_output=True, text=True, check=True
        )
        peaks.append(int(done.stdout))
    assert peaks[1] - peaks[0] < 0.25 * 2000 * 4 * n_beams


def test_a_full_disk_is_refused_before_anything_is_written(tmp_path, monkeypatch):
    path = write_bag1(tmp_path / "a.bag", World())
    monkeypatch.setattr(space.shutil, "disk_usage", lambda _: space.shutil._ntuple_diskusage(1000, 500, 500))
    with pytest.raises(
        ArtifactError, match=r"are needed on the disk of .* for 12 scans, 0\.\d kB are free"
    ) as refusal:
        read_recordings([path], IngestSettings(), tmp_path / "scans" / ".part")
    assert refusal.value.exit_code == 5
    assert not (tmp_path / "scans").exists()


def test_what_recordings_need_adds_up(monkeypatch):
    monkeypatch.setattr(space.shutil, "disk_usage", lambda _: space.shutil._ntuple_diskusage(9000, 0, 9000))
    room = Space(Path("scans"))
    room.reserve("a", 10, 2000)
    room.reserve("b", 10, 2000)
    with pytest.raises(ArtifactError, match="c: "):
        room.reserve("c", 10, 2000)
