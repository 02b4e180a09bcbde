"""What others may have written into reflectance.npz, beams.npz, map.yaml, a trajectory and relations."""

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from dynmap_cli.errors import ArtifactError
from dynmap_cli.evaluation.relations import read_relations
from dynmap_cli.files.counting_map import read_beams, read_counting_map, read_unknown, write_beams
from dynmap_cli.files.pgm import read_map
from dynmap_cli.files.trajectory import read_tum
from tests.files.test_hostile_artefacts import PYTHON_WORDS, with_change

SHAPE = (4, 6)


def grids(**changes):
    """Arrays of a counting map, some of them others; None takes one away."""
    arrays = {name: np.ones(SHAPE, np.float32) for name in ("static_hits", "dynamic_hits", "passed_cells")}
    arrays |= {
        "centroids_m": np.full((*SHAPE, 2), np.nan, np.float32),
        "resolution_m": np.float64(0.05),
        "origin_m": np.array([1.0, -2.0]),
    }
    return {name: array for name, array in (arrays | changes).items() if array is not None}


def refusal(read, *words):
    """What is said; one printable line without the words of Python."""
    with pytest.raises(ArtifactError) as caught:
        read(*words)
    line = str(caught.value)
    assert line.isprintable()
    assert not PYTHON_WORDS.search(line.removeprefix(str(words[0])))
    return line


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"static_hits": np.full(SHAPE, -1, np.float32)},
            "static_hits.npy holds -1, values are finite and at least 0",
        ),
        (
            {"passed_cells": np.full(SHAPE, np.inf, np.float32)},
            "passed_cells.npy holds inf, values are finite",
        ),
        ({"dynamic_hits": np.full(SHAPE, np.nan, np.float32)}, "dynamic_hits.npy holds nan"),
        (
            {"centroids_m": np.full((*SHAPE, 2), 1e9, np.float32)},
            "centroids_m.npy holds 1e+09, values are within",
        ),
        ({"resolution_m": np.float64(0.0)}, "resolution_m.npy holds 0.0, not 0.001 to 100"),
        ({"origin_m": np.array([np.nan, 0.0])}, "origin_m.npy holds nan, 0.0, not numbers within 1e+07 m"),
        ({"origin_m": None}, "'origin_m.npy' is missing"),
        ({"static_hits": np.ones((3, 6), np.float32)}, "grids of different sizes"),
        (
            {"static_hits": np.ones(SHAPE)},
            "static_hits.npy is float64 (4, 6), not float32 (any, any) in rows",
        ),
        (
            {"static_hits": np.array([{}], dtype=object)},
            "static_hits.npy is Python objects (1,), not float32",
        ),
    ],
)
def test_a_counting_map_is_refused_with_the_array_and_what_is_allowed(tmp_path, changes, words):
    path = tmp_path / "reflectance.npz"
    np.savez_compressed(path, **grids())
    assert read_counting_map(path).frame.shape == SHAPE
    np.savez_compressed(path, **grids(**changes))
    assert words in refusal(read_counting_map, path)


def test_bytes_of_a_counting_map_are_refused_without_the_words_of_python(tmp_path):
    path = tmp_path / "reflectance.npz"
    np.savez_compressed(path, **grids())
    whole = path.read_bytes()
    for at in range(0, len(whole), 23):
        for data in (whole[:at], whole[:at] + bytes([whole[at] ^ 0x5A]) + whole[at + 1 :]):
            path.write_bytes(data)
            try:
                read_counting_map(path)
            except ArtifactError:
                refusal(read_counting_map, path)


def test_labels_that_are_no_probabilities_are_refused(tmp_path):
    path, labels = tmp_path / "beams.npz", np.array([[0.5, np.nan], [1.5, 0.0]], np.float32)
    write_beams(path, np.array([1, 2]), labels, np.zeros((2, 2), bool))
    assert "static_probability.npy holds 1.5, values are from 0 to 1" in refusal(read_beams, path, (2, 2))
    assert not read_unknown(path, (2, 2)).any()
    np.savez_compressed(path, stamps_ns=np.array([1, 2]), static_probability=labels)
    assert not read_unknown(path, (2, 2)).any()


MAP = "image: m.pgm\nresolution: 0.05\norigin: [-1.5, 2.0, 0.0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.19\n"


@settings(max_examples=80, deadline=None)
@given(st.data())
def test_any_change_of_a_map_yaml_is_refused_in_one_line_or_read(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("map")
    (folder / "m.pgm").write_bytes(b"P5\n3 2\n255\n" + bytes(range(0, 240, 40)))
    path = folder / "m.yaml"
    path.write_text(yaml.safe_dump(with_change(yaml.safe_load(MAP), data.draw)))
    try:
        read_map(path)
    except ArtifactError:
        assert str(folder) in refusal(read_map, path)


@pytest.mark.parametrize("word", ["1_0", "٣", "nan", "1e99", "x", "\x1b[31m", "0x10"])
def test_numbers_that_people_do_not_write_are_refused(tmp_path, word):
    path = tmp_path / "a.txt"
    path.write_text(f"1.0 2.0 {word} 0 0 0 0 0\n", encoding="utf-8")
    assert "a.txt:1: expected" in refusal(read_relations, path)
    path.write_text(f"{word} 1 0 0 0 0 0 1\n", encoding="utf-8")
    assert "a.txt:1: expected" in refusal(read_tum, path)
