"""What is written is read back; what is damaged is refused in one line; a failed write leaves what was there."""

import io
import json
import zipfile

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from dynmap_cli.domain.grid import FREE, OCCUPIED, UNKNOWN, CountingMap, GridFrame, OccupancyGrid
from dynmap_cli.domain.poses import Trajectory
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.errors import ArtifactError
from dynmap_cli.files.atomic import replacing, scratch_folder
from dynmap_cli.files.counting_map import (
    read_beams,
    read_counting_map,
    read_unknown,
    write_beams,
    write_counting_map,
)
from dynmap_cli.files.manifest import (
    Manifest,
    damaged,
    manifest_path,
    read_manifest,
    sha256_of,
    write_manifest,
)
from dynmap_cli.files.pgm import image_of, read_map, write_map
from dynmap_cli.files.scan_log import read_scan_log, write_scan_log
from dynmap_cli.files.trajectory import format_stamp, parse_stamp, read_tum, write_tum

RANDOM = np.random.default_rng(4)


@pytest.fixture
def grid():
    cells = RANDOM.choice(np.array([FREE, OCCUPIED, UNKNOWN], dtype=np.int8), (7, 11))
    return OccupancyGrid(GridFrame(0.05, -1.25, 3.5, 7, 11), cells)


def test_a_map_keeps_every_cell_and_its_place(grid, tmp_path):
    write_map(tmp_path, "map", grid)
    found, warnings = read_map(tmp_path / "map.yaml")
    assert warnings == []
    assert found.frame == grid.frame
    np.testing.assert_array_equal(found.cells, grid.cells)


def test_the_first_row_of_the_image_has_the_highest_y(tmp_path):
    cells = np.full((3, 2), FREE, dtype=np.int8)
    cells[0, 1] = OCCUPIED
    write_map(tmp_path, "map", OccupancyGrid(GridFrame(0.1, 0.0, 0.0, 3, 2), cells))
    assert np.asarray(Image.open(tmp_path / "map.pgm")).tolist() == [[254, 254], [254, 254], [254, 0]]
    content = yaml.safe_load((tmp_path / "map.yaml").read_text())
    assert content["image"] == "map.pgm"
    assert (content["occupied_thresh"], content["free_thresh"], content["negate"]) == (0.65, 0.196, 0)
    assert image_of(tmp_path / "map.yaml") == tmp_path / "map.pgm"


def test_unknown_stays_unknown_under_the_old_default_threshold(grid, tmp_path):
    write_map(tmp_path, "map", grid)
    text = (tmp_path / "map.yaml").read_text().replace("0.196", "0.25")
    (tmp_path / "map.yaml").write_text(text)
    found, warnings = read_map(tmp_path / "map.yaml")
    assert "free_thresh 0.25" in warnings[0]
    np.testing.assert_array_equal(found.cells, grid.cells)


def test_a_negated_map_is_read_the_other_way(grid, tmp_path):
    write_map(tmp_path, "map", grid)
    grey = np.asarray(Image.open(tmp_path / "map.pgm"))
    Image.fromarray(255 - grey).save(tmp_path / "map.pgm")
    text = (tmp_path / "map.yaml").read_text().replace("negate: 0", "negate: 1")
    (tmp_path / "map.yaml").write_text(text)
    np.testing.assert_array_equal(read_map(tmp_path / "map.yaml")[0].cells, grid.cells)


@pytest.mark.parametrize(
    "change, words",
    [
        ({"origin": [0, 0, 0.5]}, "turned"),
        ({"origin": [0, 0]}, "origin must be"),
        ({"origin": [0, 0, "nan"]}, "origin must be"),
        ({"resolution": 0}, "resolution must be"),
        ({"resolution": None}, "resolution must be"),
        ({"image": "gone.pgm"}, "gone.pgm"),
        ({"image": "a\0b.pgm"}, "image must be"),
        ({"image": 3}, "image must be"),
        ({"occupied_thresh": None}, "occupied_thresh must be"),
        ({"occupied_thresh": "much"}, "occupied_thresh must be"),
        ({"free_thresh": 10**15}, "free_thresh must be"),
        ({"negate": [1]}, "negate must be"),
        ({"mode": "raw"}, "mode must be trinary"),
        ({"mode": 3}, "mode must be trinary"),
        ({"occupied_thresh": 0.1}, "free_thresh 0.196 must be below occupied_thresh 0.1"),
        ({"resolution": 1e-9}, "resolution must be"),
        ({"resolution": 1e300}, "resolution must be"),
        ({"resolution": float("nan")}, "resolution must be"),
        ({"resolution": -0.05}, "resolution must be"),
        ({"origin": [1e300, 0, 0]}, "origin must be"),
        ({"origin": {"x": 1}}, "origin must be"),
    ],
)
def test_a_map_that_cannot_be_read_as_meant(grid, tmp_path, change, words):
    write_map(tmp_path, "map", grid)
    content = {**yaml.safe_load((tmp_path / "map.yaml").read_text()), **change}
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(content))
    with pytest.raises(ArtifactError, match=words):
        read_map(tmp_path / "map.yaml")


def test_numbers_that_yaml_takes_for_words_are_numbers(grid, tmp_path):
    write_map(tmp_path, "map", grid)
    text = (tmp_path / "map.yaml").read_text().replace("resolution: 0.05", "resolution: 5e-2")
    (tmp_path / "map.yaml").write_text(text)
    assert read_map(tmp_path / "map.yaml")[0].frame.resolution_m == 0.05


@pytest.mark.parametrize(
    "image",
    [
        b"P5\n30000 30000\n255\n",
        b"P5\n9999999999 9999999999\n255\n",
        b"P5\n9500 9500\n255\n",
        b"P5\n2 2\n255\nab",
    ],
)
def test_an_image_that_claims_more_than_it_has_is_refused(grid, tmp_path, image):
    write_map(tmp_path, "map", grid)
    (tmp_path / "map.pgm").write_bytes(image)
    with pytest.raises(ArtifactError, match=r"map\.pgm: not a readable map image"):
        read_map(tmp_path / "map.yaml")


def test_an_image_of_16_bits_is_refused(grid, tmp_path):
    write_map(tmp_path, "map", grid)
    Image.fromarray(np.full((4, 6), 50_000, dtype=np.uint16)).save(tmp_path / "map.png")
    text = (tmp_path / "map.yaml").read_text().replace("map.pgm", "map.png")
    (tmp_path / "map.yaml").write_text(text)
    with pytest.raises(ArtifactError, match="expected 8 bits"):
        read_map(tmp_path / "map.yaml")


@given(st.integers(-(2**62), 2**62))
def test_stamps_are_exact_to_the_nanosecond(stamp):
    assert parse_stamp(format_stamp(stamp)) == stamp


def test_a_trajectory_round_trip(tmp_path):
    stamps = np.array([1772438400_000000001, 1772438400_166666999], dtype=np.int64)
    written = Trajectory(stamps, np.array([[1.5, -2.25, 3.1], [0.0, 1e3, -3.1]]))
    write_tum(tmp_path / "t.tum", written)
    found = read_tum(tmp_path / "t.tum")
    np.testing.assert_array_equal(found.stamps_ns, stamps)
    np.testing.assert_allclose(found.poses, written.poses, atol=1e-6)


@pytest.mark.parametrize(
    "line",
    [
        "1 2 3",
        "1 0 0 0 0 0 0 x",
        "now 0 0 0 0 0 0 1",
        "1e400 0 0 0 0 0 0 1",
        "9223372037 0 0 0 0 0 0 1",
        "1" * 5000 + " 0 0 0 0 0 0 1",
        "1 1e300 0 0 0 0 0 1",
        "1 inf 0 0 0 0 0 1",
    ],
)
def test_a_bad_line_of_a_trajectory_is_named(tmp_path, line):
    (tmp_path / "t.tum").write_text(f"# stamp x y z qx qy qz qw\n{line}\n")
    with pytest.raises(ArtifactError, match=r"t\.tum:2: expected"):
        read_tum(tmp_path / "t.tum")


@pytest.fixture
def log():
    return ScanLog(
        stamps_ns=np.array([5, 7, 7], dtype=np.int64),
        ranges_m=np.array([[1.0, np.inf], [np.nan, 2.0], [3.0, 4.0]], dtype=np.float32),
        odometry=np.array([[0.0, 0.0, 0.0], [np.nan] * 3, [1.0, 2.0, 3.0]]),
        geometry_index=np.array([0, 1, 0], dtype=np.int32),
        bearings_rad=np.array([[-0.1, 0.1], [0.0, np.nan]]),
        sensor_poses=np.array([[0.2, 0.0, 0.0], [-0.2, 0.0, 3.1]]),
        range_limits_m=np.array([[0.1, 8.0], [0.1, 30.0]]),
        beam_interval_s=np.array([0.0, 1e-4]),
        recording_index=np.zeros(3, dtype=np.int32),
        recordings=("a.bag",),
    )


def test_scans_round_trip(log, tmp_path):
    write_scan_log(tmp_path, log)
    found = read_scan_log(tmp_path)
    assert found.recordings == log.recordings
    for name in ("stamps_ns", "ranges_m", "odometry", "bearings_rad", "sensor_poses", "arrival_index"):
        np.testing.assert_array_equal(getattr(found, name), getattr(log, name))
    assert not found.ranges_m.flags.writeable


@pytest.mark.parametrize("content", [b"", b"nonsense", None])
def test_a_damaged_column_is_refused(log, tmp_path, content):
    write_scan_log(tmp_path, log)
    path = tmp_path / "ranges_m.npy"
    path.write_bytes(path.read_bytes()[:-4] if content is None else content)
    with pytest.raises(ArtifactError, match="not a readable scan folder"):
        read_scan_log(tmp_path)


@pytest.mark.parametrize(
    "name, column",
    [
        ("ranges_m", np.zeros((3, 2))),
        ("stamps_ns", np.array([5, 7, 7], dtype=np.uint64)),
        ("odometry", np.array(["a", "b", "c"])),
        ("odometry", np.array([None] * 9).reshape(3, 3)),
        ("sensor_poses", np.array([[np.nan, 0.0, 0.0], [0.0, 0.0, 0.0]])),
        ("geometry_index", np.array([0, 2, 0], dtype=np.int32)),
        ("recording_index", np.array([0, 1, 0], dtype=np.int32)),
        ("arrival_index", np.array([0, 9, 1], dtype=np.int32)),
        ("bearings_rad", np.array([[0.0, np.inf], [0.0, 0.0]])),
    ],
)
def test_columns_of_another_kind_are_refused(log, tmp_path, name, column):
    write_scan_log(tmp_path, log)
    np.save(tmp_path / f"{name}.npy", column)
    with pytest.raises(ArtifactError, match=f"not a readable scan folder.*{name}"):
        read_scan_log(tmp_path)


def test_a_header_that_does_not_end_is_refused(log, tmp_path):
    write_scan_log(tmp_path, log)
    path = tmp_path / "bearings_rad.npy"
    path.write_bytes(path.read_bytes().replace(b")", b"("))
    with pytest.raises(ArtifactError, match="not a readable scan folder"):
        read_scan_log(tmp_path)


@pytest.mark.parametrize("names", ["3", "[3]", "{}", "[" * 200_000, '"a.bag"'])
def test_names_of_recordings_that_are_no_names_are_refused(log, tmp_path, names):
    write_scan_log(tmp_path, log)
    (tmp_path / "recordings.json").write_text(names)
    with pytest.raises(ArtifactError, match="not a readable scan folder"):
        read_scan_log(tmp_path)


def test_columns_that_do_not_fit_one_another_are_refused(log, tmp_path):
    write_scan_log(tmp_path, log)
    np.save(tmp_path / "odometry.npy", np.zeros((2, 3)))
    with pytest.raises(ArtifactError, match="odometry is"):
        read_scan_log(tmp_path)


@pytest.fixture
def counting_map():
    hits = RANDOM.integers(0, 5, (4, 6)).astype(float)
    centroids = np.where(hits[..., None] > 0, RANDOM.random((4, 6, 2)), np.nan)
    passed = RANDOM.random((4, 6)).astype(np.float32).astype(float)
    return CountingMap.of_grids(GridFrame(0.05, 1.0, -2.0, 4, 6), hits, 0.5 * hits, passed, centroids)


def test_a_counting_map_round_trip(counting_map, tmp_path):
    write_counting_map(tmp_path / "m.npz", counting_map)
    found = read_counting_map(tmp_path / "m.npz")
    assert found.frame == counting_map.frame
    np.testing.assert_array_equal(found.static_hits, counting_map.static_hits)
    np.testing.assert_allclose(found.reflectance, counting_map.reflectance, atol=1e-6)
    np.testing.assert_allclose(found.centroids_m, counting_map.centroids_m, atol=1e-6)


def test_beams_round_trip(tmp_path):
    e = np.array([[0.5, np.nan], [1.0, 0.0]], dtype=np.float32)
    is_unknown = np.array([[True, False], [False, False]])
    write_beams(tmp_path / "b.npz", np.array([1, 2]), e, is_unknown)
    np.testing.assert_array_equal(read_beams(tmp_path / "b.npz", (2, 2)), e)
    np.testing.assert_array_equal(read_unknown(tmp_path / "b.npz", (2, 2)), is_unknown)


def test_beams_of_a_file_that_does_not_say_are_not_unknown(tmp_path):
    e = np.ones((2, 2), dtype=np.float32)
    np.savez(tmp_path / "b.npz", stamps_ns=np.array([1, 2]), static_probability=e)
    assert not read_unknown(tmp_path / "b.npz", (2, 2)).any()
    with pytest.raises(ArtifactError, match="again with --force"):
        read_unknown(tmp_path / "none.npz", (2, 2))


def test_damaged_maps_and_beams_are_refused(counting_map, tmp_path):
    path = tmp_path / "m.npz"
    write_counting_map(path, counting_map)
    whole = path.read_bytes()
    flipped = bytearray(whole)
    flipped[60:90] = bytes(30)
    for content in (b"", b"nonsense", whole[: len(whole) // 2], bytes(flipped)):
        path.write_bytes(content)
        assert_maps_and_beams_are_refused(path)
    np.savez(path, other=np.zeros(3))
    assert_maps_and_beams_are_refused(path)


def assert_maps_and_beams_are_refused(path):
    with pytest.raises(ArtifactError, match="again with --force"):
        read_counting_map(path)
    with pytest.raises(ArtifactError, match="again with --force"):
        read_beams(path, (4, 6))


@pytest.mark.parametrize(
    "change",
    [
        {"static_hits": np.zeros((4, 6))},
        {"static_hits": np.zeros((3, 6), np.float32)},
        {"static_hits": np.zeros((4, 6), np.float32, order="F")},
        {"resolution_m": np.float64(np.nan)},
        {"origin_m": np.array([0.0, np.inf])},
        {"centroids_m": np.array([{}], dtype=object)},
    ],
)
def test_a_counting_map_of_other_arrays_is_refused(counting_map, tmp_path, change):
    path = tmp_path / "m.npz"
    write_counting_map(path, counting_map)
    with np.load(path) as archive:
        arrays = dict(archive)
    np.savez(path, **{**arrays, **change})
    with pytest.raises(ArtifactError, match="not a readable counting map"):
        read_counting_map(path)


def test_an_archive_that_unpacks_to_gigabytes_is_refused_unread(tmp_path):
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {"descr": "<f4", "fortran_order": False, "shape": (2**28, 1)}
    )
    with (
        zipfile.ZipFile(tmp_path / "b.npz", "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("static_probability.npy", "w") as stream,
    ):
        stream.write(header.getvalue())
        for _ in range(40):
            stream.write(bytes(2**20))
    with pytest.raises(ArtifactError, match="at most"):
        read_beams(tmp_path / "b.npz", (2, 2))
    with pytest.raises(ArtifactError, match="by its header"):
        read_beams(tmp_path / "b.npz", (2**28, 1))


@pytest.fixture
def manifest(tmp_path):
    (tmp_path / "a.txt").write_text("one")
    outputs = {"a.txt": sha256_of(tmp_path / "a.txt")}
    return Manifest("map", {"x": 1}, {"in": "0"}, outputs, {"lines": []}, 1.5, "0.1.0")


def test_a_manifest_round_trip(manifest, tmp_path):
    assert read_manifest(tmp_path, "map") is None
    write_manifest(tmp_path, manifest)
    assert read_manifest(tmp_path, "map") == manifest
    assert list(tmp_path.glob("*.part")) == []
    assert manifest_path(tmp_path, "map").read_bytes().endswith(b"\n")


@pytest.mark.parametrize(
    "change",
    [
        {"settings": []},
        {"inputs": 3},
        {"inputs": {"a": 1}},
        {"outputs": {"a\0b": "0"}},
        {"outputs": {"../a": "0"}},
        {"outputs": {"/etc/passwd": "0"}},
        {"summary": {"lines": 3}},
        {"summary": None},
        {"stage": "segment"},
        {"dynmap_version": 1},
        {"seconds": 10**400},
        {"further": 1},
    ],
)
def test_a_manifest_that_no_stage_wrote_is_refused(manifest, tmp_path, change):
    write_manifest(tmp_path, manifest)
    path = manifest_path(tmp_path, "map")
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(ArtifactError, match=r"map\.manifest\.json: not a .*again with --force") as caught:
        read_manifest(tmp_path, "map")
    assert "\n" not in str(caught.value)


def test_a_manifest_nested_too_deeply_is_refused(manifest, tmp_path):
    manifest_path(tmp_path, "map").write_text("[" * 200_000)
    with pytest.raises(ArtifactError, match="nested too deeply"):
        read_manifest(tmp_path, "map")


def test_a_file_that_is_not_what_was_written_is_found(manifest, tmp_path):
    assert damaged(tmp_path, manifest) is None
    (tmp_path / "a.txt").write_text("another")
    assert damaged(tmp_path, manifest) == tmp_path / "a.txt"
    (tmp_path / "a.txt").unlink()
    assert damaged(tmp_path, manifest) == tmp_path / "a.txt"


def test_the_digest_of_a_folder_is_of_names_and_contents(tmp_path):
    digests = set()
    for folder, name, content in (("a", "x", "1"), ("b", "x", "2"), ("c", "y", "1"), ("d", "x", "1")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / name).write_text(content)
        digests.add(sha256_of(tmp_path / folder))
    assert len(digests) == 3


def test_a_failed_write_leaves_what_was_there(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("before")
    with pytest.raises(RuntimeError), replacing(path) as part:
        part.write_text("half")
        raise RuntimeError
    assert path.read_text() == "before"
    assert list(tmp_path.iterdir()) == [path]


def test_a_scratch_folder_starts_empty_and_is_gone_afterwards(tmp_path):
    (tmp_path / ".map.part").mkdir()
    (tmp_path / ".map.part" / "of a process that was killed").touch()
    with scratch_folder(tmp_path / "map") as part:
        assert list(part.iterdir()) == []
        (part / "x").write_text("1")
    assert list(tmp_path.iterdir()) == []


def test_only_failures_of_writing_are_about_writing(tmp_path):
    with pytest.raises(FileNotFoundError), scratch_folder(tmp_path / "out" / "map"):
        (tmp_path / "another" / "gone").read_text()
    with (
        pytest.raises(ArtifactError, match="cannot be written"),
        scratch_folder(tmp_path / "out" / "map") as part,
    ):
        (part / "missing" / "x").write_text("1")
    with pytest.raises(ArtifactError, match="No space left"), scratch_folder(tmp_path / "out" / "map"):
        raise OSError(28, "No space left on device")
