"""patches.zip and submaps/: what is written comes back, and bad archives are refused in one line."""

import csv
import io
import json
import math
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.domain.patches import ChangingObject, Patch, PatchSet, Visit, cells_that_vary
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.errors import ArtifactError
from dynmap_cli.files.patch_archive import read_patches, read_rounds, read_visits, write_patches
from dynmap_cli.files.submaps import read_submaps, write_submaps

FRAME = GridFrame(0.05, -1.25, 3.1, 6, 9)


def submap(number, draw):
    contested = draw.random(FRAME.shape) < 0.3
    contested[0, 0] = True
    owned = contested | (draw.random(FRAME.shape) < 0.8)
    return SubMap(number, FRAME, 4, 7, contested, owned, 54 * 0.05**2)


def patch_set(number, draw):
    patches = []
    shares = np.round(draw.dirichlet((1.0, 2.0, 3.0), 24).T, 6)
    for k in range(3):
        values = draw.random(FRAME.shape).astype(np.float32)
        values[draw.random(FRAME.shape) < 0.2] = np.nan
        patches.append(Patch(k, 3 - k, values, tuple(shares[k].tolist()) if number else ()))
    rounds = tuple(draw.random((k, *FRAME.shape)).astype(np.float32) for k in (1, 2, 2))
    bic = (-9.125, -3.5, -4.0)
    varying = cells_that_vary(patches)
    return PatchSet(number, FRAME, varying, tuple(patches), 0.75, bic, rounds, objects(draw))


def objects(draw):
    """Two objects, seen in two visits."""
    owner = draw.integers(-1, 2, size=FRAME.shape)
    owner[0, :2] = (0, 1)
    states = [{0: "on", 1: "off"}, {0: "unknown", 1: "on"}]
    return tuple(ChangingObject(k, owner == k, seen) for k, seen in enumerate(states))


def content(seed=0):
    draw = np.random.default_rng(seed)
    submaps = tuple(submap(k, draw) for k in range(3))
    visits = (
        Visit(0, 0, "monday, late.bag", 1_700_000_000_123_456_789, 1_700_000_010_000_000_000, 1, 0.987654),
        Visit(
            0,
            1,
            "tuesday.bag",
            1_700_000_020_000_000_000,
            1_700_000_030_000_000_001,
            None,
            math.nan,
            "saw the change",
        ),
        *(Visit(0, 2 + k, "tuesday.bag", 10 * k, 10 * k + 5, (0, 0, 0, 1, 2)[k], 1.0) for k in range(5)),
        Visit(1, 0, "tuesday.bag", -5, 7, None, math.nan, "saw too little"),
        *(Visit(2, k, "tuesday.bag", 10 * k, 10 * k + 5, (0, 0, 0, 1, 1, 2)[k], 0.5) for k in range(6)),
    )
    return submaps, (patch_set(0, draw), patch_set(2, draw)), visits


@pytest.fixture
def archive(tmp_path):
    path = tmp_path / "patches.zip"
    write_patches(path, *content())
    return path


def rewrite(path, changes):
    """Replace members; None takes one away."""
    with zipfile.ZipFile(path) as old:
        members = {name: old.read(name) for name in old.namelist()}
    members.update(changes)
    with zipfile.ZipFile(path, "w") as new:
        for name, data in members.items():
            if data is not None:
                new.writestr(name, data)


def manifest_of(path):
    with zipfile.ZipFile(path) as archive:
        return json.loads(archive.read("manifest.json"))


@settings(max_examples=10)
@given(st.integers(0, 1000))
def test_patches_come_back(tmp_path_factory, seed):
    path = tmp_path_factory.mktemp("archive") / "patches.zip"
    submaps, patch_sets, visits = content(seed)
    write_patches(path, submaps, patch_sets, visits)
    for written, read in zip(patch_sets, read_patches(path), strict=True):
        assert (written.submap_id, written.frame, written.stay_probability, written.bic) == (
            read.submap_id,
            read.frame,
            read.stay_probability,
            read.bic,
        )
        np.testing.assert_array_equal(written.varying, read.varying)
        for p, q in zip(written.patches, read.patches, strict=True):
            assert (p.patch_id, p.support, p.share_by_hour) == (q.patch_id, q.support, q.share_by_hour)
            np.testing.assert_array_equal(p.reflectance, q.reflectance)
        for one, other in zip(written.objects, read.objects, strict=True):
            assert (one.object_id, one.states) == (other.object_id, other.states)
            np.testing.assert_array_equal(one.cells, other.cells)


def test_visits_come_back_with_their_remarks(archive):
    for written, read in zip(content()[2], read_visits(archive), strict=True):
        assert str(written) == str(read)


def test_the_names_in_the_archive_are_those_that_scripts_rely_on(archive):
    manifest = manifest_of(archive)
    assert list(manifest) == ["format_version", "resolution_m", "submaps"]
    entry = manifest["submaps"][0]
    assert {"id", "origin_m", "size_cells", "area_m2", "stay_probability", "patches"} <= set(entry)
    assert entry["size_cells"] == [9, 6]
    assert set(entry["patches"][0]) == {"id", "support", "pgm", "npy"}
    assert manifest["submaps"][1]["patches"] == []
    with zipfile.ZipFile(archive) as opened:
        assert {p[k] for e in manifest["submaps"] for p in e["patches"] for k in ("pgm", "npy")} <= set(
            opened.namelist()
        )
        rows = list(csv.reader(io.StringIO(opened.read("sequences.csv").decode())))
        picture = opened.read(entry["patches"][0]["pgm"])
    assert rows[0] == ["submap", "sequence", "log", "start_s", "end_s", "patch", "membership"]
    assert rows[1] == [
        "0",
        "0",
        "monday, late.bag",
        "1700000000.123456789",
        "1700000010.000000000",
        "1",
        "0.987654",
    ]
    assert rows[2][5:] == ["", ""]
    assert picture.startswith(b"P5\n9 6\n255\n")
    values = content()[1][0].patches[0].reflectance
    assert picture[-9] == (205 if np.isnan(values[0, 0]) else 0 if values[0, 0] >= 0.2 else picture[-9])


def test_the_same_content_gives_the_same_bytes(archive, tmp_path):
    write_patches(tmp_path / "again.zip", *content())
    assert archive.read_bytes() == (tmp_path / "again.zip").read_bytes()


def test_no_submaps_make_an_empty_archive(tmp_path):
    write_patches(tmp_path / "patches.zip", (), (), ())
    assert read_patches(tmp_path / "patches.zip") == ()
    assert read_visits(tmp_path / "patches.zip") == ()


def test_another_version_is_refused_and_both_are_named(archive):
    rewrite(archive, {"manifest.json": json.dumps({**manifest_of(archive), "format_version": 99})})
    with pytest.raises(ArtifactError, match="format version 99, this dynmap reads version 1"):
        read_patches(archive)


@pytest.mark.parametrize(
    "damage",
    [
        {"manifest.json": b"not json"},
        {"manifest.json": None},
        {"submap_000/patch_0.npy": None},
        {"submap_000/patch_0.npy": b"garbage"},
    ],
)
def test_a_damaged_archive_is_refused_in_one_line(archive, damage):
    rewrite(archive, damage)
    with pytest.raises(ArtifactError, match="damaged patch archive") as caught:
        read_patches(archive)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("size_cells", [10**9, 10**9]),
        ("size_cells", [0, 5]),
        ("size_cells", [9, 7]),
        ("size_cells", "9"),
        ("origin_m", [1.0]),
        ("stay_probability", 1.5),
        ("stay_probability", None),
        ("bic", [float("nan")]),
        ("bic", ["best"]),
        ("bic", 3),
        ("patches", [{"id": 0, "support": 1, "npy": "../../etc/passwd", "pgm": "x"}]),
        ("patches", [{"id": 0}]),
    ],
)
def test_a_manifest_that_cannot_be_is_refused(archive, key, value):
    manifest = manifest_of(archive)
    manifest["submaps"][0][key] = value
    rewrite(archive, {"manifest.json": json.dumps(manifest)})
    with pytest.raises(ArtifactError, match="damaged patch archive"):
        read_patches(archive)


def test_an_archive_without_scores_is_read(archive):
    manifest = manifest_of(archive)
    for entry in manifest["submaps"]:
        del entry["bic"]
    rewrite(archive, {"manifest.json": json.dumps(manifest)})
    assert [patch_set.bic for patch_set in read_patches(archive)] == [(), ()]


def test_rounds_come_back_and_older_archives_have_none(archive):
    written = {one.submap_id: one.rounds for one in content()[1]}
    read = read_rounds(archive)
    assert {number: len(rounds) for number, rounds in read.items()} == {0: 3, 1: 0, 2: 3}
    for number, rounds in written.items():
        for one, other in zip(rounds, read[number], strict=True):
            np.testing.assert_array_equal(one, other)
    manifest = manifest_of(archive)
    for entry in manifest["submaps"]:
        del entry["rounds"]
    rewrite(archive, {"manifest.json": json.dumps(manifest)})
    assert read_rounds(archive) == {0: (), 1: (), 2: ()}


@pytest.mark.parametrize(
    "rounds",
    [
        ["submap_000/round_1.npy"],
        ["submap_000/round_3.npy"] * 3,
        ["../x"] * 3,
        7,
        ["submap_000/patch_0.npy"] * 3,
    ],
)
def test_rounds_that_cannot_be_are_refused(archive, rounds):
    manifest = manifest_of(archive)
    manifest["submaps"][0]["rounds"] = rounds
    rewrite(
        archive,
        {"manifest.json": json.dumps(manifest), "submap_000/round_3.npy": npy(np.zeros((4, 6, 9), "<f4"))},
    )
    with pytest.raises(ArtifactError, match="damaged patch archive"):
        read_rounds(archive)


def npy(array, **kwargs):
    stream = io.BytesIO()
    np.save(stream, array, **kwargs)
    return stream.getvalue()


@pytest.mark.parametrize(
    "data",
    [
        npy(np.array([{"a": 1}], dtype=object), allow_pickle=True),
        npy(np.zeros(FRAME.shape)),
        npy(np.zeros((2, 2), np.float32)),
        npy(np.full(FRAME.shape, 1.5, np.float32)),
        npy(np.zeros(FRAME.shape, np.float32))[:-40],
        npy(np.zeros((4000, 4000), np.float32)),
    ],
    ids=["pickle", "float64", "shape", "values", "cut", "large"],
)
def test_values_that_are_not_those_of_a_patch_are_refused(archive, data):
    rewrite(archive, {"submap_000/patch_0.npy": data})
    with pytest.raises(ArtifactError, match="damaged patch archive"):
        read_patches(archive)


def test_bytes_that_are_cut_flipped_or_missing_are_refused(archive, tmp_path):
    whole = archive.read_bytes()
    archive.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ArtifactError, match="not a readable patch archive"):
        read_patches(archive)
    with pytest.raises(ArtifactError, match="not a readable patch archive"):
        read_visits(tmp_path / "nothing.zip")
    for at in range(60, len(whole) - 200, 97):
        archive.write_bytes(whole[:at] + bytes([whole[at] ^ 0x5A]) + whole[at + 1 :])
        try:
            read_patches(archive)
        except ArtifactError:
            continue


def test_submaps_come_back(tmp_path):
    submaps = content()[0]
    write_submaps(tmp_path, submaps)
    for written, read in zip(submaps, read_submaps(tmp_path), strict=True):
        assert (written.submap_id, written.frame, written.row, written.col) == (
            read.submap_id,
            read.frame,
            read.row,
            read.col,
        )
        assert read.area_m2 == pytest.approx(written.area_m2)
        np.testing.assert_array_equal(written.contested, read.contested)
        np.testing.assert_array_equal(written.owned, read.owned)
        assert read.recurring is None
    marked = replace(submaps[0], recurring=np.roll(submaps[0].contested, 1, axis=1) & submaps[0].contested)
    write_submaps(tmp_path, (marked,))
    (read,) = read_submaps(tmp_path)
    np.testing.assert_array_equal(read.contested, marked.contested)
    np.testing.assert_array_equal(read.recurring, marked.recurring)
    write_submaps(tmp_path, ())
    assert read_submaps(tmp_path) == ()


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("format_version: 7\n", "format version 7, this dynmap reads version 1"),
        ("[1, 2\n", "not a readable list"),
        ("format_version: 1\nsubmaps: [{id: 0}]\nresolution_m: 0.05\n", "damaged list"),
    ],
)
def test_bad_lists_of_submaps_are_refused(tmp_path, text, complaint):
    (tmp_path / "submaps.yaml").write_text(text)
    with pytest.raises(ArtifactError, match=complaint):
        read_submaps(tmp_path)


def test_objects_have_rectangles_and_a_row_per_visit(archive):
    entry = manifest_of(archive)["submaps"][2]["objects"][0]
    assert set(entry) == {"id", "rectangle_m", "cells"}
    left, bottom, right, top = entry["rectangle_m"]
    assert (left, bottom) == (-1.25, 3.1)
    assert right > left
    assert top > bottom
    with zipfile.ZipFile(archive) as opened:
        rows = opened.read("objects.csv").decode().splitlines()
    assert rows[:4] == ["submap,visit,object,state", "0,0,0,on", "0,0,1,unknown", "0,1,0,off"]


def test_an_archive_without_objects_has_none(archive):
    manifest = manifest_of(archive)
    for entry in manifest["submaps"]:
        del entry["objects"]
    rewrite(archive, {"manifest.json": json.dumps(manifest), "objects.csv": None})
    assert [patch_set.objects for patch_set in read_patches(archive)] == [(), ()]


@pytest.mark.parametrize(
    "changes",
    [
        {"objects.csv": None},
        {"objects.csv": b"submap,visit,object,state\n0,0,0,ajar\n"},
        {"submap_000/objects.npy": None},
        {"submap_000/objects.npy": b"no array"},
    ],
)
def test_damaged_objects_are_refused(archive, changes):
    rewrite(archive, changes)
    with pytest.raises(ArtifactError, match="damaged patch archive"):
        read_patches(archive)


@pytest.mark.parametrize("shares", [[0.5] * 23, [0.5] * 23 + [1.5], [0.5] * 23 + ["half"], 0.5])
def test_shares_by_hour_that_are_none_are_refused(archive, shares):
    manifest = manifest_of(archive)
    manifest["submaps"][2]["patches"][0]["share_by_hour"] = shares
    rewrite(archive, {"manifest.json": json.dumps(manifest)})
    with pytest.raises(ArtifactError, match="damaged patch archive"):
        read_patches(archive)
