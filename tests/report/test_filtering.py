"""Pictures of what the filter did."""

import io

import numpy as np
from PIL import Image

from dynmap_cli.domain.grid import FREE, OCCUPIED, UNKNOWN, GridFrame, OccupancyGrid
from dynmap_cli.report.filtering import _in_one_frame, draw_filtered, draw_rounds_of_map, side_by_side
from dynmap_cli.report.pictures import _FEW, _FEW_PIXELS, MapPicture

ORANGE = (240, 128, 16)


def grid_with(points, origin=(-1.0, -1.0), shape=(40, 40)):
    frame = GridFrame(0.05, *origin, *shape)
    cells = np.full(shape, FREE, dtype=np.int8)
    for row, col in frame.to_cells(np.array(points)).tolist():
        cells[row, col] = OCCUPIED
    return OccupancyGrid(frame, cells)


def count(image, colour):
    return int((np.asarray(image) == colour).all(axis=2).sum())


def test_grids_keep_their_place_in_one_frame():
    first, second = grid_with([(0.1, 0.2)]), grid_with([(0.1, 0.2), (1.3, 0.0)], (-0.5, -2.0), (60, 50))
    for before, after in zip((first, second), _in_one_frame((first, second)), strict=True):
        assert after.frame.shape == (60, 60)
        old, new = (one.frame.to_points(np.argwhere(one.cells == OCCUPIED)) for one in (before, after))
        np.testing.assert_allclose(new, old, atol=1e-9)
        assert (after.cells != UNKNOWN).sum() == before.cells.size


def test_removed_beams_are_coloured_only_in_the_filtered_map():
    picture = draw_filtered(grid_with([(0, 0)]), np.array([[0.5, 0.5], [9.0, 9.0]]), 2)
    half = picture.width // 2
    assert count(picture.crop((0, 0, half, picture.height)), ORANGE) == 0
    assert count(picture.crop((half, 0, picture.width, picture.height)), ORANGE) == _FEW_PIXELS**2


def test_cells_that_fade_out_are_coloured():
    stream = io.BytesIO()
    Image.new("RGB", (40, 20), (1, 2, 3)).save(stream, format="PNG")
    wall, person = (0.0, 0.0), (0.5, 0.5)
    final, titled = grid_with([wall]), [("all", grid_with([wall, person])), ("round 1", grid_with([wall]))]
    sheet = draw_rounds_of_map(titled, final, stream.getvalue())
    assert count(sheet, ORANGE) == _FEW_PIXELS**2
    assert count(sheet, (1, 2, 3)) == 800


def test_a_title_is_wider_than_its_picture():
    picture = Image.new("RGB", (20, 60), (255, 255, 255))
    titles = [("a", "b"), ("a long title over a narrow picture", "b")]
    short, long = (side_by_side([(title, picture) for title in pair]) for pair in titles)
    assert long.width > short.width
    last = side_by_side([("b", picture), ("a long title over a narrow picture", picture)])
    assert (np.asarray(last)[:, -10:] == 255).all(axis=2).any()
    assert last.width == long.width


def test_a_wall_that_moves_by_one_cell_is_no_change():
    stream = io.BytesIO()
    Image.new("RGB", (4, 4)).save(stream, format="PNG")
    titled = [("all", grid_with([(0.05, 0.0)]))]
    assert count(draw_rounds_of_map(titled, grid_with([(0.0, 0.0)]), stream.getvalue()), ORANGE) == 0


def test_few_spots_are_drawn_larger_than_many():
    grid = grid_with([(0.0, 0.0)])
    many = np.random.default_rng(1).uniform(0.0, 1.0, (_FEW + 1, 2))
    one, none, crowd = (count(MapPicture(grid).draw(p, (), ()), ORANGE) for p in (many[:1], many[:0], many))
    assert (one, none) == (_FEW_PIXELS**2, 0)
    assert 0 < crowd <= 4 * many.shape[0]
