"""Arrays on a shelf are those that were put there, in memory and in files."""

import numpy as np
import pytest

from dynmap_cli.domain.mapped import mapping_of
from dynmap_cli.files import tables
from dynmap_cli.files.tables import Shelf


@pytest.mark.parametrize("most_bytes", [1 << 20, 100])
def test_what_was_put_on_a_shelf_stays_as_it_was(tmp_path, monkeypatch, most_bytes):
    monkeypatch.setattr(tables, "_MOST_IN_MEMORY_BYTES", most_bytes)
    monkeypatch.setattr(tables, "_PIECE_BYTES", 5000)
    draw = np.random.default_rng(1)
    arrays = [
        draw.integers(0, 256, (n, 3)).astype(dtype)
        for n in (0, 1, 40, 7, 2000, 3)
        for dtype in (np.uint8, np.float32, np.float64)
    ]
    shelf = Shelf(tmp_path)
    kept = [shelf.put(array) for array in arrays]
    shelf.give_back()
    for array, same in zip(arrays, kept, strict=True):
        np.testing.assert_array_equal(same, array)
        assert same.dtype == array.dtype
        assert same.flags.c_contiguous
        assert same.flags.aligned
    assert (mapping_of(kept[-1]) is not None) == (most_bytes == 100)
    assert not list(tmp_path.iterdir())
