"""A few damages of every kind of input, always the same ones; `make fuzz` tries as many as there is time for."""

import pytest

from tests.fuzz.fuzzing import fuzz, read_damaged
from tests.fuzz.law import obey
from tests.fuzz.mutations import Edit
from tests.fuzz.targets import TARGETS


@pytest.mark.parametrize("name", TARGETS)
def test_a_whole_sample_is_read(name, tmp_path):
    target = TARGETS[name]
    target.write(tmp_path / "whole", target.sample())
    assert obey(target.read, tmp_path / "whole") is None


@pytest.mark.parametrize("name", TARGETS)
def test_a_damaged_sample_is_read_or_refused_in_one_line(name):
    fuzz(TARGETS[name], examples=3)


@pytest.mark.parametrize(
    ("name", "file", "damages"),
    [
        ("manifest", "map.manifest.json", [Edit("write", 5, b"\x7f")]),
        ("folder", "a/metadata.yaml", [Edit("insert", 0, b"[" * 4000)]),
        ("salvage folder", "a/metadata.yaml", [Edit("insert", 0, b"[" * 4000)]),
        ("foxglove protobuf", "a.mcap", [Edit("zeros", 3153, b"", 16), Edit("word", 301, b"nan")]),
        ("ros1", "a.bag", [Edit("write", 7, b"\x00")]),
        ("members", "a.zip!0.name", [Edit("cut", 0)]),
        ("salvage members", "a.zip!0.name", [Edit("write", 0, b"\x01")]),
        ("folder of mcap", "a/a.mcap", [Edit("cut", 0)]),
        ("salvage rows of tables", "a.db3!topics/0003/4", [Edit("cut", 2)]),
        ("salvage rows of tables", "a.db3!topics/0001/3", [Edit("flip", 0, b"\xff")]),
        ("salvage records", "a.mcap!0003", [Edit("flip", 44, b"\xff")]),
        ("salvage records with chunks", "a.mcap!0023", [Edit("zeros", 4, b"", 26)]),
        ("salvage records with chunks", "a.mcap!0032", [Edit("flip", 1, b"\x01")]),
        ("salvage definitions", "a.mcap!0014", [Edit("flip", 8, b"\xff")]),
    ],
)
def test_what_once_broke_the_law(name, file, damages):
    read_damaged(TARGETS[name], file, damages)
