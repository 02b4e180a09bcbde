"""Maps of CMU's course on statistical robotics."""

import gzip

import numpy as np
import pytest

from dynmap_cli.domain.grid import FREE, OCCUPIED, UNKNOWN
from dynmap_cli.errors import ArtifactError
from dynmap_cli.files.beesoft import is_beesoft_map
from dynmap_cli.files.pgm import image_of, read_map

TEXT = b"""robot_specifications->global_mapsize_x                 20
robot_specifications->resolution                       10

global_map[0]: 2 3
1.000 0.000 -1.000
0.790 0.900 0.300
"""


def written(folder, content, name="wean.dat"):
    path = folder / name
    path.write_bytes(gzip.compress(content) if name.endswith(".gz") else content)
    return path


@pytest.mark.parametrize("name", ["wean.dat", "wean.dat.gz"])
def test_lines_run_along_y_and_one_means_free(tmp_path, name):
    path = written(tmp_path, TEXT, name)
    grid, warnings = read_map(path)
    assert warnings == []
    assert (grid.frame.resolution_m, grid.frame.rows, grid.frame.cols) == (0.1, 3, 2)
    assert grid.cells.tolist() == [[FREE, UNKNOWN], [OCCUPIED, FREE], [UNKNOWN, OCCUPIED]]
    assert image_of(path) == path


@pytest.mark.parametrize(
    "change, words",
    [
        ((b"2 3", b"3 3"), "6 values"),
        ((b"2 3", b"200000 300000"), "cells"),
        ((b"->resolution", b"->revolution"), "resolution"),
        ((b"0.790", b"much"), "much"),
        ((b" 10\n", b" 0\n"), "0 cm"),
    ],
)
def test_a_map_that_cannot_be_read_as_meant(tmp_path, change, words):
    with pytest.raises(ArtifactError, match=words):
        read_map(written(tmp_path, TEXT.replace(*change)))


def test_a_packed_map_that_is_cut_off_is_refused(tmp_path):
    noise = np.random.default_rng(0).random(6000).round(3)
    body = (
        b"robot_specifications->resolution 10\nglobal_map[0]: 60 100\n" + " ".join(map(str, noise)).encode()
    )
    path = tmp_path / "cut.dat.gz"
    path.write_bytes(gzip.compress(body)[:-4000])
    assert is_beesoft_map(path)
    with pytest.raises(ArtifactError, match="not a readable map"):
        read_map(path)
