"""Tables of beams in memory and in nameless files, and arrays that go to a .npz file piece by piece."""

import zipfile

import numpy as np
import pytest

from dynmap_cli.domain.mapped import copied_rows, give_back, mapping_of
from dynmap_cli.errors import ArtifactError
from dynmap_cli.files import npy, tables
from dynmap_cli.files.counting_map import beams_in_parts, read_beams, write_beams
from dynmap_cli.files.npy import write_npz
from dynmap_cli.files.tables import new_table


def test_a_table_in_a_file_keeps_what_is_written_and_leaves_no_name(tmp_path, monkeypatch):
    monkeypatch.setattr(tables, "_MOST_IN_MEMORY_BYTES", 100)
    values = np.random.default_rng(1).random((50, 7)).astype(np.float32)
    table = new_table(50, 7, tmp_path)
    assert mapping_of(table) is not None
    assert mapping_of(new_table(5, 5, tmp_path)) is None
    assert list(tmp_path.iterdir()) == []
    for first in range(0, 50, 10):
        table[first : first + 10] = values[first : first + 10]
        give_back(table)
    np.testing.assert_array_equal(table, values)
    for rows in (slice(3, 9), np.array([7, 2, 2])):
        found = copied_rows(table, rows)
        np.testing.assert_array_equal(found, values[rows])
        assert mapping_of(found) is None and found.flags.writeable
    is_set = new_table(50, 7, tmp_path, np.bool_)
    assert is_set.dtype == bool and not is_set.any()


def test_copied_rows_of_an_array_in_memory_are_a_copy():
    table = np.arange(12.0).reshape(4, 3)
    copied_rows(table, slice(0, 2))[:] = -1.0
    assert table.min() == 0.0


@pytest.fixture
def in_small_pieces(monkeypatch):
    monkeypatch.setattr(npy, "_PIECE_BYTES", 100)


def test_a_npz_file_in_pieces_has_the_bytes_of_numpy(tmp_path, in_small_pieces):
    rng = np.random.default_rng(2)
    arrays = {
        "stamps_ns": np.arange(300),
        "e": rng.random((300, 11)).astype(np.float32).round(2),
        "is_unknown": (rng.random((300, 11)) < 0.1).view(np.uint8),
    }
    write_npz(tmp_path / "pieces.npz", arrays.items())
    np.savez_compressed(tmp_path / "whole.npz", **arrays)
    assert (tmp_path / "pieces.npz").read_bytes() == (tmp_path / "whole.npz").read_bytes()


def test_beams_in_parts_are_the_beams(tmp_path, in_small_pieces):
    e = np.random.default_rng(3).random((40, 9)).astype(np.float32)
    write_beams(tmp_path / "b.npz", np.arange(40), e, np.zeros(e.shape, dtype=bool))
    parts = list(beams_in_parts(tmp_path / "b.npz", e.shape))
    assert len(parts) > 10
    for rows, part in parts:
        np.testing.assert_array_equal(part, e[rows])
    np.testing.assert_array_equal(
        np.concatenate([part for _, part in parts]), read_beams(tmp_path / "b.npz", e.shape)
    )


@pytest.mark.parametrize("harm", ["flip", "short", "long", "shape", "none"])
def test_damage_is_found_also_at_the_end_of_the_parts(tmp_path, in_small_pieces, harm):
    path, shape = tmp_path / "b.npz", (40, 9)
    write_beams(path, np.arange(40), np.ones(shape, dtype=np.float32), np.zeros(shape, dtype=bool))
    with zipfile.ZipFile(path) as archive:
        content = bytearray(archive.read("static_probability.npy"))
        crc = archive.getinfo("static_probability.npy").CRC
    if harm == "short":
        content = content[:-1]
    elif harm == "long":
        content += b"\0"
    elif harm == "shape":
        shape = (41, 9)
    if harm == "none":
        path.unlink()
    elif harm != "shape":
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("static_probability.npy", bytes(content))
    if harm == "flip":
        whole = bytearray(path.read_bytes())
        assert crc.to_bytes(4, "little") in whole
        whole[whole.index(b"\x93NUMPY") + len(content) - 1] ^= 1
        path.write_bytes(bytes(whole))
    with pytest.raises(ArtifactError, match=r"b\.npz: not a readable table of beams"):
        list(beams_in_parts(path, shape))
