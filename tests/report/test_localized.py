"""The picture of a localization."""

import numpy as np
import pytest

from dynmap_cli.domain.grid import FREE, GridFrame, OccupancyGrid
from dynmap_cli.domain.patches import Patch, PatchSet
from dynmap_cli.domain.poses import Trajectory
from dynmap_cli.files.trajectory import format_stamp, write_tum
from dynmap_cli.report.ink import INK
from dynmap_cli.report.localized import COLOURS, SeenSubMap, _believed_last, _called, draw_localized

HEADER = "stamp_s,submap,patch,probability,nearest"
FRAME = GridFrame(0.05, -1.0, -2.0, 100, 120)


def localized(folder, verdicts, x_m):
    """A robot that goes along y = 0, with a verdict every ten scans, and sees a door closed, then open."""
    stamps = np.arange(len(x_m), dtype=np.int64) * 10**8
    poses = np.column_stack([x_m, np.zeros(len(x_m)), np.zeros(len(x_m))])
    write_tum(folder / "trajectory.tum", Trajectory(stamps, poses))
    lines = ["stamp_s,verdict", *(f"{format_stamp(10**9 * k)},{v}" for k, v in enumerate(verdicts))]
    (folder / "health.csv").write_text("\n".join(lines) + "\n")
    states = [HEADER, "0.0,7,0,0.9,", "0.0,7,1,0.1,", "1.0,7,0,0.2,", "1.0,7,1,0.8,"]
    (folder / "states.csv").write_text("\n".join(states) + "\n")
    return folder


def door():
    """A sub-map of 10 x 20 cells that is full in state 0, empty in state 1."""
    frame = FRAME.window(70, 40, 10, 20)
    patches = [Patch(0, 3, np.full((10, 20), 0.9, np.float32)), Patch(1, 2, np.zeros((10, 20), np.float32))]
    return PatchSet(7, frame, np.ones((10, 20), dtype=bool), tuple(patches), 0.9)


def drawn(folder, sets=(), names=None, places=()):
    grid = OccupancyGrid(FRAME, np.full(FRAME.shape, FREE, dtype=np.int8))
    return np.asarray(draw_localized(grid, sets, names or {}, folder, places)).astype(int)


def count(pixels, colour):
    return int((pixels == np.array(colour)).all(axis=-1).sum())


def test_the_path_has_the_colours_of_its_verdicts(tmp_path):
    x_m = np.linspace(0, 3, 30)
    pixels = drawn(localized(tmp_path, ["tracking", "changed", "lost"], x_m))
    shares = [count(pixels, colour) for colour in COLOURS.values()]
    assert min(shares) > 0.6 * max(shares)
    pixels = drawn(localized(tmp_path, ["tracking"] * 3, x_m))
    assert count(pixels, COLOURS["changed"]) == count(pixels, COLOURS["lost"]) == 0


def test_no_line_is_drawn_where_the_robot_was_found_elsewhere(tmp_path):
    whole = drawn(localized(tmp_path, ["tracking"], np.linspace(0, 4, 30)))
    x_m = np.concatenate([np.linspace(0, 0.5, 15), np.linspace(3.5, 4, 15)])
    jumping = drawn(localized(tmp_path, ["tracking"], x_m))
    assert count(jumping, COLOURS["tracking"]) < 0.5 * count(whole, COLOURS["tracking"])


@pytest.mark.parametrize(("last", "is_dark"), [("0", True), ("1", False)])
def test_a_submap_is_shown_as_it_was_believed_to_be_last(tmp_path, last, is_dark):
    folder = localized(tmp_path, ["tracking"], np.linspace(0, 3, 30))
    (folder / "states.csv").write_text(f"{HEADER}\n2.0,7,{last},0.9,\n")
    assert (count(drawn(folder, [door()]), INK) > 5000) == is_dark


def test_names_are_written_and_what_was_not_seen_is_said(tmp_path):
    folder = localized(tmp_path, ["tracking"], np.linspace(0, 3, 30))
    plain, named = drawn(folder, [door()]), drawn(folder, [door()], {7: "lab door"})
    assert (plain != named).any()
    (folder / "states.csv").write_text(f"{HEADER}\n")
    assert (drawn(folder, [door()]) != plain).any()


@pytest.mark.parametrize(
    ("place", "label"),
    [
        ({"kind": "object", "submap": None}, "object (2.0, 1.5)"),
        ({"kind": "sub-map", "submap": 7}, "sub-map 7"),
    ],
)
def test_a_place_where_the_map_is_out_of_date_has_a_ring_and_a_name(tmp_path, place, label):
    folder = localized(tmp_path, ["tracking"], np.linspace(0, 3, 30))
    place = {**place, "x_m": 2.0, "y_m": 1.5}
    assert _called(place) == label
    plain, ringed = drawn(folder), drawn(folder, places=[place])
    assert count(plain, COLOURS["changed"]) == 0
    rows, cols = np.nonzero((ringed[: plain.shape[0] - 80] == np.array(COLOURS["changed"])).all(axis=-1))
    zoom = 1700 // 120
    x, y = (2.0 + 1.0) / 0.05 * zoom, (100 - (1.5 + 2.0) / 0.05) * zoom
    away = np.hypot(cols - x, rows - y)
    assert ((away > 9 * zoom) & (away < 11 * zoom)).sum() > 1000
    assert not (away < 9 * zoom).any()


@pytest.mark.parametrize(
    ("rows", "label"),
    [
        ((), "7: not seen"),
        (("2.0,7,0,0.9,", "2.0,7,1,0.1,"), "7: state 0 (0.90)"),
        (("1.0,7,0,0.9,", "2.0,7,0,0.6,", "2.0,7,1,0.4,"), "7: undecided, state 0 (0.60)"),
        (("2.0,7,0,0.1,", "2.0,7,-1,0.9,0 with object 1"), "7: state 0 with object 1 (0.90)"),
    ],
)
def test_a_state_is_called_as_the_terminal_calls_it(tmp_path, rows, label):
    (tmp_path / "states.csv").write_text("\n".join([HEADER, *rows]) + "\n")
    assert SeenSubMap(door(), "7", *_believed_last(tmp_path / "states.csv").get(7, ())).label == label
