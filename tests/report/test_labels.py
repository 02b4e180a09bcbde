"""Words on a map hide neither one another nor walls, where there is room."""

from itertools import combinations

import numpy as np
import pytest
from PIL import Image

from dynmap_cli.report import labels
from dynmap_cli.report.ink import INK, PAPER
from dynmap_cli.report.labels import Label, above_legend, draw_labels

RED = (200, 20, 50)


def places_of(image, named, monkeypatch):
    """Where the labels were written."""
    places = []
    pen_of = labels.ImageDraw.Draw

    def noted(sheet):
        pen = pen_of(sheet)
        rectangle = pen.rectangle

        def draw(box, **colours):
            places.append(box)
            rectangle(box, **colours)

        pen.rectangle = draw
        return pen

    monkeypatch.setattr(labels.ImageDraw, "Draw", noted)
    draw_labels(image, named)
    return places


def common(one, other):
    width = min(one[2], other[2]) - max(one[0], other[0])
    height = min(one[3], other[3]) - max(one[1], other[1])
    return max(width, 0.0) * max(height, 0.0)


@pytest.mark.parametrize("step", [0, 12, 40])
def test_labels_of_near_rectangles_lie_apart(step, monkeypatch):
    boxes = [(200.0 + step * k, 150.0 + step * k, 230.0 + step * k, 170.0 + step * k) for k in range(5)]
    named = [Label(f"{k}: state {k} (1.00)", box, RED) for k, box in enumerate(boxes)]
    places = places_of(Image.new("RGB", (600, 500), PAPER), named, monkeypatch)
    assert len(places) == 5
    assert all(common(one, other) == 0.0 for one, other in combinations(places, 2))
    assert all(common(place, box) == 0.0 for place in places for box in boxes)
    assert all(0 <= left < right <= 600 and 0 <= top < bottom <= 500 for left, top, right, bottom in places)


def test_a_label_stands_where_nothing_is_drawn(monkeypatch):
    image = Image.new("RGB", (400, 300), PAPER)
    image.paste(INK, (205, 0, 400, 300))
    (place,) = places_of(image, [Label("3", (160.0, 140.0, 200.0, 160.0), RED)], monkeypatch)
    assert place[2] < 205


def test_a_label_at_the_edge_stays_in_the_picture(monkeypatch):
    named = [Label("a long name", (90.0, 40.0, 99.0, 49.0), RED), Label("b", (0.0, 0.0, 9.0, 9.0), RED)]
    for left, top, right, bottom in places_of(Image.new("RGB", (100, 50), PAPER), named, monkeypatch):
        assert 0 <= top < bottom <= 50
        assert left >= 0
        assert right <= 100 or right - left > 100


def test_a_legend_breaks_its_lines_and_keeps_the_picture():
    image = Image.new("RGB", (120, 40), RED)
    words = [(f"word {k}", INK) for k in range(6)]
    sheet = np.asarray(above_legend(image, words))
    assert (sheet[:40, :120] == RED).all()
    one_line = np.asarray(above_legend(image, words[:1]))
    assert sheet.shape[0] > one_line.shape[0] > 40
