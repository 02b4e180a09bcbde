"""The report: the same bytes each time, nothing to load, also where nothing changes."""

import re
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from dynmap_cli import __version__
from dynmap_cli.config import Config
from dynmap_cli.domain.grid import FREE, OCCUPIED, GridFrame, OccupancyGrid
from dynmap_cli.domain.patches import Patch, PatchSet, Visit
from dynmap_cli.domain.poses import Trajectory
from dynmap_cli.domain.scans import end_points, single_laser_log
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.errors import ArtifactError
from dynmap_cli.files.counting_map import write_beams
from dynmap_cli.files.manifest import Manifest, write_manifest
from dynmap_cli.files.patch_archive import write_patches
from dynmap_cli.files.pgm import write_map
from dynmap_cli.files.registered import write_registered
from dynmap_cli.files.scan_log import write_scan_log
from dynmap_cli.files.submaps import write_submaps
from dynmap_cli.report.curves import _legend
from dynmap_cli.report.filtering import side_by_side
from dynmap_cli.report.pictures import MapPicture, draw_states
from dynmap_cli.report.stage import _removed_ends, run
from dynmap_cli.stage import StageContext

N_SCANS, BEARINGS = 20, np.linspace(-1.0, 1.0, 11)


def small_log():
    ranges = np.full((N_SCANS, BEARINGS.size), 2.0, dtype=np.float32)
    stamps = np.arange(N_SCANS, dtype=np.int64) * 10**9
    return single_laser_log(stamps, ranges, BEARINGS, np.zeros((N_SCANS, 3)), sensor_pose=(0.2, 0.0, 0.1))


def small_grid():
    cells = np.full((80, 60), FREE, dtype=np.int8)
    cells[[0, -1]] = OCCUPIED
    return OccupancyGrid(GridFrame(0.05, -1.0, -2.0, 80, 60), cells)


def changing():
    """One sub-map with two states, seen three times."""
    frame = small_grid().frame.window(30, 20, 8, 6)
    everywhere = np.ones((8, 6), dtype=bool)
    submap = SubMap(0, frame, 30, 20, everywhere, everywhere, 0.12)
    states = [np.full((8, 6), value, dtype=np.float32) for value in (0.0, 0.9)]
    states[0][0, 0] = np.nan
    patches = tuple(Patch(k, 2 - k, values) for k, values in enumerate(states))
    visits = tuple(Visit(0, k, "a.mcap", k * 10**9, (k + 2) * 10**9, k % 2, 0.9) for k in range(3))
    unsure = replace(visits[0], sequence=3, patch=None, membership=np.nan, remark="saw the change")
    return (submap,), (PatchSet(0, frame, everywhere, patches, 0.9),), (*visits, unsure)


def write_run(folder, submaps=(), patch_sets=(), visits=(), settings=None):
    log, labels = small_log(), np.ones((N_SCANS, BEARINGS.size), dtype=np.float32)
    labels[:, 3] = 0.1
    sections = {"scans": "ingest", "map": "map", "submaps": "segment", "patches": "cluster"}
    config = Config()
    defaults = {
        "ingest": config.ingest,
        "map": config.map,
        "segment": config.segmentation,
        "cluster": config.clustering,
    }
    for name, stage in sections.items():
        (folder / name).mkdir(parents=True)
        effective = {**defaults[stage].model_dump(mode="json"), **(settings or {}).get(stage, {})}
        summary = {"lines": [f"{stage} said <this> & that", "warning: look here"]}
        inputs = {"/somewhere/else/a.mcap": "ab" * 32} if stage == "ingest" else {}
        write_manifest(folder / name, Manifest(stage, effective, inputs, {}, summary, 1.0, __version__))
    write_scan_log(folder / "scans", log)
    write_registered(folder / "map", Trajectory(log.stamps_ns, np.zeros((N_SCANS, 3))), log.beam_interval_s)
    write_beams(folder / "map" / "beams.npz", log.stamps_ns, labels, np.zeros(labels.shape, bool))
    for grid_name in ("map", "unfiltered", "round_1", "round_2"):
        write_map(folder / "map", grid_name, small_grid())
    header = "round,log_likelihood,dynamic_share,changed_labels,pose_shift_m\n"
    (folder / "map" / "em.csv").write_text(f"{header}1,-12.5,0.1,1.0,\n2,-11.5,0.09,0.01,0.02\n")
    write_submaps(folder / "submaps", submaps)
    write_patches(folder / "patches" / "patches.zip", submaps, patch_sets, visits)


def report(run_dir, out_dir):
    out_dir.mkdir()
    run(StageContext(run_dir, out_dir, Config(), (), 1, run_dir / "scans"))
    return (out_dir / "report.html").read_text()


def test_one_page_with_all_figures_and_nothing_to_load(tmp_path):
    write_run(tmp_path / "run", *changing(), settings={"map": {"max_rounds": 5}})
    page = report(tmp_path / "run", tmp_path / "out")
    figures = sorted(path.name for path in (tmp_path / "out" / "figures").iterdir())
    assert figures == ["dynamic.png", "em.png", "map.png", "patch_map.png", "submap_000.png", "visits.png"]
    assert page.count("data:image/png;base64,") == len(figures)
    assert not re.search(r"(src|href)=\"(?!data:)", page)
    assert "<script" not in page
    assert "map said &lt;this&gt; &amp; that" in page
    assert 'class="warning">warning: look here' in page
    assert "5 (default 2)" in page
    assert "/somewhere" not in page
    assert "a.mcap" in page


def test_no_name_of_others_is_a_part_of_the_page(tmp_path):
    evil = "<script>alert(1)</script>"
    submaps, patch_sets, visits = changing()
    named = tuple(replace(one, name=evil) for one in submaps)
    visits = tuple(replace(one, recording=f"{evil}\x1b[31m.bag") for one in visits)
    write_run(tmp_path / "run", named, patch_sets, visits, {"cluster": {"near_m": evil}})
    page = report(tmp_path / "run", tmp_path / "out")
    assert "<script" not in page
    assert "\x1b" not in page
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in page


def test_the_same_bytes_in_another_place(tmp_path):
    for place in ("here", "there"):
        write_run(tmp_path / place, *changing())
        report(tmp_path / place, tmp_path / f"out_{place}")
    files = [path.relative_to(tmp_path / "out_here") for path in (tmp_path / "out_here").rglob("*.*")]
    assert len(files) == 7
    for name in files:
        assert (tmp_path / "out_here" / name).read_bytes() == (tmp_path / "out_there" / name).read_bytes()


def test_a_run_in_which_nothing_changed(tmp_path):
    write_run(tmp_path / "run")
    page = report(tmp_path / "run", tmp_path / "out")
    assert "No area was seen in two states" in page
    assert "all settings are the defaults" in page


def test_an_area_whose_states_nobody_saw(tmp_path):
    write_run(tmp_path / "run", changing()[0])
    assert "submap_000" not in report(tmp_path / "run", tmp_path / "out")


def test_a_stage_that_is_not_done_is_named(tmp_path):
    write_run(tmp_path / "run")
    (tmp_path / "run" / "map" / "map.manifest.json").unlink()
    with pytest.raises(ArtifactError, match="stage 'map' is not done"):
        report(tmp_path / "run", tmp_path / "out")


def test_end_points_are_where_the_beams_ended():
    log = small_log()
    chosen = np.zeros(log.ranges_m.shape, dtype=bool)
    chosen[4, 7] = True
    poses = np.zeros((N_SCANS, 3))
    poses[4] = [1.0, 2.0, 0.5]
    in_robot = np.array([0.2, 0.0]) + 2.0 * np.array([np.cos(BEARINGS[7] + 0.1), np.sin(BEARINGS[7] + 0.1)])
    cos, sin = np.cos(0.5), np.sin(0.5)
    expected = [1.0 + cos * in_robot[0] - sin * in_robot[1], 2.0 + sin * in_robot[0] + cos * in_robot[1]]
    np.testing.assert_allclose(end_points(log, poses, chosen), [expected], atol=1e-6)


def test_one_removed_beam_of_each_cell_is_drawn_and_all_are_counted(tmp_path):
    log, frame = small_log(), GridFrame(0.05, -1.0, -3.0, 120, 80)
    labels = np.ones(log.ranges_m.shape, dtype=np.float32)
    labels[:, 3], labels[4, 7] = 0.1, 0.2
    write_beams(tmp_path / "beams.npz", log.stamps_ns, labels, np.zeros(labels.shape, bool))
    poses = np.zeros((N_SCANS, 3))
    shown, count = _removed_ends(tmp_path / "beams.npz", log, poses, frame)
    every = end_points(log, poses, labels < 0.5)
    assert count == every.shape[0] == N_SCANS + 1
    cells = {tuple(cell) for cell in frame.to_cells(every).tolist()}
    assert sorted(cells) == sorted(tuple(cell) for cell in frame.to_cells(shown).tolist())


def test_a_map_of_any_size_fits_on_a_page():
    nothing = np.empty((0, 2))
    for rows, cols in ((1, 1), (40, 3), (300, 5001), (2400, 10)):
        grid = OccupancyGrid(
            GridFrame(0.05, 0.0, 0.0, rows, cols), np.full((rows, cols), FREE, dtype=np.int8)
        )
        image = MapPicture(grid).draw(nothing, (), ())
        assert isinstance(image, Image.Image)
        assert max(image.size) <= 2400


def test_the_scale_stands_below_the_map():
    cells = np.full((200, 40), OCCUPIED, dtype=np.int8)
    grid = OccupancyGrid(GridFrame(0.05, 0.0, 0.0, *cells.shape), cells)
    image = np.asarray(MapPicture(grid).draw(np.empty((0, 2)), (), ()))
    assert (image[: 200 * 8, : 40 * 8] == 32).all()
    below = image[200 * 8 :]
    assert (below == 32).any()
    assert (below == 255).any()
    assert (below[:, [0, -1]] == 255).all()


@pytest.mark.parametrize(("rows", "cols", "least"), [(25, 10, (200, 200)), (19, 94, (1100, 100))])
def test_states_are_drawn_as_large_as_a_page_has_room(rows, cols, least):
    frame = GridFrame(0.05, 0.0, 0.0, rows, cols)
    patches = tuple(Patch(k, 1, np.zeros((rows, cols), dtype=np.float32)) for k in range(2))
    image = draw_states(PatchSet(0, frame, np.zeros((rows, cols), dtype=bool), patches, 0.9))
    assert image.width > least[0]
    assert image.height > least[1]
    assert image.width <= 1240


def test_titles_of_narrow_pictures_are_not_cut():
    panel = Image.new("RGB", (20, 80))
    sheet = np.asarray(side_by_side((("every end point", panel), ("filtered, 3706 beams removed", panel))))
    title = sheet[:24]
    assert (title < 255).any()
    assert (title[:, [0, -1]] == 255).all()


def test_the_colours_of_states_are_named():
    states = (9, 1, 3, None)
    visits = [Visit(0, k, "a.mcap", k, k + 1, state, 1.0) for k, state in enumerate(states)]
    assert [entry.get_label() for entry in _legend(visits)] == ["state 1, 9", "state 3", "none recognised"]
    assert [entry.get_label() for entry in _legend(visits[1:2])] == ["state 1"]


def test_a_removed_beam_is_orange_at_its_place():
    grid = small_grid()
    point = grid.frame.to_points(np.array([[40, 30]]))
    image = np.asarray(MapPicture(grid).draw(point, (), ()))
    zoom = 1700 // 80
    row, col = (80 - 40) * zoom - zoom // 2, 30 * zoom + zoom // 2
    assert (
        np.abs(image[row - 3 : row + 4, col - 3 : col + 4].astype(int) - [240, 128, 16]).sum(axis=2) == 0
    ).any()
