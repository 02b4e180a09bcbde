"""What others may have written into patches.zip, submaps.yaml and edits.yaml: right, or refused in one clear line."""

import copy
import json
import math
import re
import struct
import zipfile
from collections import Counter

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from dynmap_cli.domain.grid import FARTHEST_M
from dynmap_cli.errors import ArtifactError
from dynmap_cli.files.edits import read_edits
from dynmap_cli.files.known import read_known_patches, read_known_submaps
from dynmap_cli.files.patch_archive import read_names, read_patches, read_rounds, read_visits, write_patches
from dynmap_cli.files.submaps import read_submaps, write_submaps
from tests.files.test_patch_archive import FRAME, content, manifest_of, npy, rewrite

PYTHON_WORDS = re.compile(
    r"NoneType|None\b|True\b|False\b|subscript|unhashable|invalid literal|could not convert|codec|iterable|argument|"
    r"unpack \(|expected str|indices|Traceback|<class|dtype|broadcast|reshape|'int'|'str'|'list'|'dict'|Expecting|"
    r"There is no item|Bad CRC|Bad magic|not a zip file|buffer|pickle"
)
ODD = (
    None, True, False, -1, 0, 1, 7, 2**31, 2**62, -0.5, 0.5, 1.5, 1e308, math.nan, math.inf, -math.inf, "", "1", "x",
    "\x1b[31m", "a\nb", "<script>", "../../x", "x" * 500, [], [1], [1, 2], ["a", "b"], {}, {"a": 1}, [[]], [None] * 30,
)  # fmt: skip
READERS = (read_patches, read_visits, read_rounds, read_names)
SEQUENCES = ("submap", "sequence", "log", "start_s", "end_s", "patch", "membership")


@pytest.fixture
def archive(tmp_path):
    path = tmp_path / "patches.zip"
    write_patches(path, *content())
    return path


def refusal(path, read):
    """What is said, or None where it is read."""
    try:
        read(path)
    except ArtifactError as err:
        line = str(err)
        assert line.startswith(str(path)), line
        assert line.isprintable(), line
        assert not PYTHON_WORDS.search(line.removeprefix(str(path))), line
        assert re.search(r"Run `dynmap|Mend it", line), line
        assert len(line) < 500 + len(str(path))
        return line
    return None


def table(rows):
    return "".join(",".join(map(str, row)) + "\n" for row in rows).encode()


def visits_table(**changes):
    """sequences.csv of the sample, with other words in its second row."""
    submaps, _, visits = content()
    assert submaps
    rows = [
        dict(zip(SEQUENCES, (v.submap_id, v.sequence, "a.bag", 5, 6), strict=False))
        | ({"patch": "", "membership": ""} if v.patch is None else {"patch": v.patch, "membership": 1})
        for v in visits
    ]
    rows[0] |= changes
    return table([SEQUENCES, *([row[name] for name in SEQUENCES] for row in rows)])


def changed_patch(**changes):
    def change(manifest):
        manifest["submaps"][0]["patches"][1] |= changes

    return change


def changed_submap(**changes):
    def change(manifest):
        manifest["submaps"][0] |= changes

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (changed_patch(support=-3), "submaps[0].patches[1].support is -3, not a whole number from 0"),
        (changed_patch(support=9), "support is 9, but 2 visits of sequences.csv saw patch 1"),
        (changed_patch(support=2.0), "support is 2.0, not a whole number"),
        (changed_patch(support=True), "support is true, not a whole number"),
        (changed_patch(support="2"), "support is '2', not a whole number"),
        (changed_patch(id=0), "submaps[0]: patch 0 is there twice"),
        (changed_patch(npy="../../etc/passwd"), "'../../etc/passwd' is missing"),
        (changed_patch(npy="submap_000/patch_0.npy"), "one .npy is named for two patches"),
        (changed_patch(share_by_hour=[0.5] * 24), "some patches have share_by_hour and some have not"),
        (changed_submap(id=2), "sub-map 2 is there twice"),
        (changed_submap(id=-1), "submaps[0].id is -1, not a whole number from 0"),
        (changed_submap(id=5), "sub-map 0 is not in manifest.json"),
        (changed_submap(name="\x1b[31mred"), "name is '\\x1b[31mred', not printable characters"),
        (changed_submap(name="a\nb"), "name is 'a\\nb', not printable"),
        (changed_submap(name="x" * 61), "name: a name has 1 to 60 printable characters"),
        (changed_submap(origin_m=[math.nan, 0.0]), "origin_m[0] is nan, not a finite number"),
        (
            changed_submap(origin_m=[1e9, 0.0]),
            "origin_m[0] is 1000000000.0, not a finite number from -1e+07 to 1e+07",
        ),
        (
            changed_submap(stay_probability=math.inf),
            "stay_probability is inf, not a finite number from 0 to 1",
        ),
        (changed_submap(size_cells=[9]), "size_cells is [9], not [columns, rows]"),
        (
            changed_submap(size_cells=[10**9, 10**9]),
            "size_cells[0] is 1000000000, not a whole number from 1 to",
        ),
        (changed_submap(size_cells=[12000, 12000]), "more than 120000000 cells"),
        (changed_submap(patches=None), "patches is empty, not a list"),
        (changed_submap(objects=[{"id": 0, "cells": 1}, {"id": 1, "cells": 99}]), "manifest.json says 1"),
        (changed_submap(objects=[{"id": 7, "cells": 1}]), "object 0 of sub-map 0 is not in manifest.json"),
        (changed_submap(unassigned={}), "a visit has a patch and a membership, or a remark"),
        (
            lambda manifest: manifest.update(resolution_m=0),
            "resolution_m is 0, not a finite number from 0.001 to 100",
        ),
        (lambda manifest: manifest.update(submaps={}), "submaps is 0 `key: value` lines, not a list"),
        (lambda manifest: manifest.update(format_version="\x1b[2J"), "format version '\\x1b[2J'"),
        (lambda manifest: manifest.pop("submaps"), "manifest.json has no submaps"),
        (lambda manifest: manifest["submaps"][0].pop("origin_m"), "submaps[0] has no origin_m"),
    ],
)
def test_a_manifest_is_refused_with_place_and_what_is_allowed(archive, change, words):
    manifest = manifest_of(archive)
    change(manifest)
    rewrite(archive, {"manifest.json": json.dumps(manifest)})
    assert words in refusal(archive, read_patches)


@pytest.mark.parametrize(
    ("member", "data", "words"),
    [
        ("manifest.json", b"not json", "manifest.json: not JSON from line 1, column 1 on"),
        ("manifest.json", b"\xff\xfe{}", "manifest.json: it is not text in UTF-8, byte 0 is 0xff"),
        ("manifest.json", b"[]", "manifest.json: it is [], not `key: value` lines"),
        ("manifest.json", b'{"a": 1, "a": 2}', "the key 'a' is there twice"),
        ("manifest.json", b"[" * 100_000, "manifest.json: nested too deeply"),
        ("manifest.json", None, "'manifest.json' is missing"),
        ("sequences.csv", None, "'sequences.csv' is missing"),
        ("sequences.csv", b"", "sequences.csv has the columns [], not submap,sequence"),
        ("sequences.csv", b"a,b\n1,2\n", "sequences.csv has the columns ['a', 'b']"),
        ("sequences.csv", b"\xff", "sequences.csv is not text in UTF-8"),
        ("sequences.csv", table([SEQUENCES, "012"]), "sequences.csv line 2 has 3 columns, not 7"),
        ("sequences.csv", table([SEQUENCES, ["x" * 200_000]]), "not a line of comma-separated values"),
        ("sequences.csv", visits_table(submap="1_0"), "line 2: submap is '1_0', not a whole number"),
        ("sequences.csv", visits_table(submap="-1"), "line 2: submap is '-1'"),
        ("sequences.csv", visits_table(sequence="2"), "line 4: visit 2 of sub-map 0 is there twice"),
        ("sequences.csv", visits_table(log="a\x1b[31m"), "line 2: log is 'a\\x1b[31m', not printable"),
        ("sequences.csv", visits_table(start_s="nan"), "line 2: start_s is 'nan', not seconds"),
        ("sequences.csv", visits_table(start_s="1e99"), "line 2: start_s is '1e99', not seconds"),
        ("sequences.csv", visits_table(start_s="9", end_s="8"), "line 2: start_s 9 is after end_s 8"),
        (
            "sequences.csv",
            visits_table(patch="7"),
            "patch 7 of sub-map 0 was visited, manifest.json has none",
        ),
        ("sequences.csv", visits_table(membership="nan"), "membership is 'nan', not a number from 0 to 1"),
        ("sequences.csv", visits_table(membership="1.5"), "membership is '1.5', not a number from 0 to 1"),
        ("sequences.csv", visits_table(membership=""), "line 2: a visit has a patch and a membership"),
        (
            "objects.csv",
            table([("submap", "visit", "object", "state"), (0, 0, 0, "ajar")]),
            "state is 'ajar'",
        ),
        (
            "objects.csv",
            table([("submap", "visit", "object", "state"), (0, 0, 9, "on")]),
            "object 9 of sub-map 0",
        ),
        (
            "objects.csv",
            table([("submap", "visit", "object", "state"), (0, 99, 0, "on")]),
            "visit 99 of sub-map 0",
        ),
        (
            "objects.csv",
            table([("submap", "visit", "object", "state"), *[(0, 0, 0, "on")] * 2]),
            "line 3: visit 0, object 0 of sub-map 0 is there twice",
        ),
        (
            "submap_000/patch_0.npy",
            npy(np.full(FRAME.shape, np.inf, "<f4")),
            "patch_0.npy holds inf, values are",
        ),
        (
            "submap_000/patch_0.npy",
            npy(np.full(FRAME.shape, -0.1, "<f4")),
            "patch_0.npy holds -0.1, values are from",
        ),
        (
            "submap_000/patch_0.npy",
            npy(np.zeros(FRAME.shape)),
            "patch_0.npy is float64 (6, 9), not float32 (6, 9)",
        ),
        (
            "submap_000/patch_0.npy",
            npy(np.zeros((9, 6), "<f4")),
            "patch_0.npy is float32 (9, 6), not float32 (6, 9)",
        ),
        (
            "submap_000/patch_0.npy",
            npy(np.zeros((9, 6), "<f4").T),
            "float32 (6, 9) in columns, not float32 (6, 9)",
        ),
        (
            "submap_000/patch_0.npy",
            npy(np.array([{"a": 1}], dtype=object), allow_pickle=True),
            "patch_0.npy is Python objects (1,), not float32",
        ),
        ("submap_000/patch_0.npy", b"\x93NUMPY\x01\x00\x02\x00{(", "patch_0.npy has a damaged header"),
        ("submap_000/patch_0.npy", b"", "patch_0.npy is not a .npy file"),
        (
            "submap_000/patch_0.npy",
            npy(np.zeros((4000, 4000), "<f4")),
            "unpacks to 64000128 bytes, at most",
        ),
        ("submap_000/objects.npy", npy(np.full(FRAME.shape, -2, "<i2")), "objects.npy: it has an object -2"),
        (
            "submap_000/objects.npy",
            npy(np.full(FRAME.shape, -1, "<i2")),
            "manifest.json has an object 0, it has none",
        ),
        ("../../etc/x", b"", "member '../../etc/x' has a name that leads out of the archive"),
        ("/etc/x", b"", "member '/etc/x' has a name that leads out of the archive"),
        ("a\x1b[31m", b"", "member 'a\\x1b[31m' has a name with control characters"),
    ],
)
def test_a_member_is_refused_with_its_name_and_what_is_allowed(archive, member, data, words):
    rewrite(archive, {member: data})
    assert words in refusal(archive, read_patches)


def test_a_member_that_is_there_twice_encrypted_or_packed_otherwise_is_refused(archive):
    with pytest.warns(UserWarning, match="Duplicate"), zipfile.ZipFile(archive, "a") as opened:
        opened.writestr("sequences.csv", "")
    assert "member 'sequences.csv' is there twice" in refusal(archive, read_patches)
    write_patches(archive, *content())
    with zipfile.ZipFile(archive, "a") as opened:
        opened.writestr("x", b"x" * 9, compress_type=zipfile.ZIP_BZIP2)
    assert "member 'x' is packed by method 12" in refusal(archive, read_patches)
    write_patches(archive, *content())
    data = bytearray(archive.read_bytes())
    data[data.index(b"PK\x01\x02") + 8] |= 1
    archive.write_bytes(data)
    assert "member 'manifest.json' is encrypted" in refusal(archive, read_patches)


def test_an_archive_that_says_less_than_it_unpacks_to_is_refused(archive):
    rewrite(archive, {"submap_000/patch_0.npy": npy(np.zeros((6, 9), "<f4"))})
    data = bytearray(archive.read_bytes())
    at = data.rindex(b"submap_000/patch_0.npy") - 46
    data[at + 24 : at + 28] = struct.pack("<I", 20)
    archive.write_bytes(data)
    assert "submap_000/patch_0.npy" in refusal(archive, read_patches)


def places(value, path=()):
    """The way to every value of a document."""
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [path, *(place for key, one in inner for place in places(one, (*path, key)))]


def with_change(document, draw):
    """A document with one of its values changed, taken away or doubled."""
    changed = copy.deepcopy(document)
    *way, last = draw(st.sampled_from(places(document)[1:]))
    around = changed
    for key in way:
        around = around[key]
    how = draw(st.sampled_from(("change", "change", "change", "take", "double")))
    if how == "change":
        around[last] = draw(st.sampled_from(ODD))
    elif how == "take":
        del around[last]
    elif isinstance(around, list):
        around.append(copy.deepcopy(around[last]))
    return changed


def check_patches(path):
    """What was read is a patch map that can be."""
    patch_sets, visits = read_patches(path), read_visits(path)
    assert all(name == "" or (name.isprintable() and len(name) <= 60) for name in read_names(path).values())
    assert len({one.submap_id for one in patch_sets}) == len(patch_sets)
    assert len({(one.submap_id, one.sequence) for one in visits}) == len(visits)
    seen = Counter((visit.submap_id, visit.patch) for visit in visits)
    for one in patch_sets:
        assert 0.0 <= one.stay_probability <= 1.0
        assert np.abs(one.frame.corner).max() <= FARTHEST_M
        for patch in one.patches:
            assert type(patch.patch_id) is type(patch.support) is int
            assert patch.support == seen[one.submap_id, patch.patch_id]
            values = patch.reflectance[~np.isnan(patch.reflectance)]
            assert ((values >= 0) & (values <= 1)).all()
        if one.patches[0].share_by_hour:
            np.testing.assert_allclose(np.sum([p.share_by_hour for p in one.patches], axis=0), 1.0, atol=1e-3)
    for visit in visits:
        assert visit.recording.isprintable()
        assert visit.remark.isprintable()
        assert (visit.patch is None) != (0.0 <= visit.membership <= 1.0)


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_any_change_of_a_manifest_is_refused_in_one_line_or_makes_a_patch_map_that_can_be(
    tmp_path_factory, data
):
    path = tmp_path_factory.mktemp("archive") / "patches.zip"
    write_patches(path, *content())
    rewrite(path, {"manifest.json": json.dumps(with_change(manifest_of(path), data.draw))})
    refused = [refusal(path, read) for read in READERS]
    if not any(refused):
        check_patches(path)


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_any_change_of_the_list_of_submaps_is_refused_in_one_line_or_makes_submaps_that_can_be(
    tmp_path_factory, data
):
    folder = tmp_path_factory.mktemp("submaps")
    write_submaps(folder, content()[0])
    path = folder / "submaps.yaml"
    path.write_text(yaml.safe_dump(with_change(yaml.safe_load(path.read_text()), data.draw)))
    if refusal(path, lambda path: read_submaps(path.parent)) is None:
        submaps = read_submaps(folder)
        assert len({one.submap_id for one in submaps}) == len(submaps)
        for one in submaps:
            assert one.contested.shape == one.frame.shape
            assert one.name.isprintable()
            assert np.abs(one.frame.corner).max() <= FARTHEST_M
            assert math.isfinite(one.area_m2)


EDITS = """
format_version: 1
corrections:
- merge: {submap: 3, rectangle_m: [-1.25, 0.5, 2.0, 1.75], states: [0, 2]}
- name: {submap: 3, rectangle_m: [-1.25, 0.5, 2.0, 1.75], name: lab door}
- drop: {submap: 3, rectangle_m: [-1.25, 0.5, 2.0, 1.75]}
- add: {submap: 7, polygon_m: [[0.0, 0.0], [1.0, 0.0], [0.5, 2.0]]}
"""


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_any_change_of_the_corrections_is_refused_in_one_line_or_read(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("edits") / "edits.yaml"
    path.write_text(yaml.safe_dump(with_change(yaml.safe_load(EDITS), data.draw)))
    refusal(path, lambda path: read_edits(path.parent))


def test_bytes_of_the_archive_are_refused_without_the_words_of_python(archive):
    whole = archive.read_bytes()
    for at in range(0, len(whole), 61):
        archive.write_bytes(whole[:at] + bytes([whole[at] ^ 0x5A]) + whole[at + 1 :])
        for read in READERS:
            refusal(archive, read)
        archive.write_bytes(whole[:at])
        refusal(archive, read_patches)


def test_what_is_known_from_before_is_refused_with_what_helps_there(tmp_path):
    known = tmp_path / "known"
    write_submaps(known, content()[0])
    (known / "patches.zip").write_bytes(b"no archive")
    with pytest.raises(ArtifactError, match="Take the folder known/ away"):
        read_known_patches(tmp_path)
    (known / "submaps.yaml").write_text("[")
    with pytest.raises(ArtifactError, match="Take the folder known/ away"):
        read_known_submaps(tmp_path)
