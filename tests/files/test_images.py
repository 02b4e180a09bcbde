"""Images are read up to the size that a grid may have, whatever Pillow warns of."""

import pytest

from dynmap_cli.domain.grid import MAX_CELLS
from dynmap_cli.files.images import read_grey

ROWS, COLS = 9_600, 12_500


def bitmap(tmp_path, cols, n_bytes=0):
    path = tmp_path / "map.pbm"
    path.write_bytes(b"P4 %d %d\n" % (cols, ROWS) + bytes(n_bytes))
    return path


def test_the_largest_map_is_read(tmp_path):
    assert ROWS * COLS == MAX_CELLS
    assert read_grey(bitmap(tmp_path, COLS, ROWS * ((COLS + 7) // 8))).shape == (ROWS, COLS)


@pytest.mark.parametrize(("cols", "words"), [(COLS + 1, "pixels, at most"), (2 * COLS, "more pixels than")])
def test_a_larger_one_is_refused(tmp_path, cols, words):
    with pytest.raises(ValueError, match=words):
        read_grey(bitmap(tmp_path, cols))
