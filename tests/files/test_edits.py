"""edits.yaml and polygon files: what is written is read again, anything else is refused in one line."""

import pytest

from dynmap_cli.domain.corrections import Addition, Drop, Merge, Name, Place
from dynmap_cli.domain.submaps import Rectangle
from dynmap_cli.errors import ArtifactError
from dynmap_cli.files.edits import check_name, edit_digests, read_edits, read_polygon, write_edits

PLACE = Place(3, Rectangle(-1.25, 0.5, 2.0, 1.75))
AREA = "{add: {submap: 7, polygon_m: [[0, 0], [1, 0], [1, 1]]}}"
ALL = (
    Merge(PLACE, (0, 2)),
    Addition(7, ((0.0, 0.0), (1.0, 0.0), (0.5, 2.0))),
    Name(PLACE, "Labortür: 'süd' # 3"),
    Drop(PLACE),
)


def test_what_is_written_is_read_again(tmp_path):
    write_edits(tmp_path, ALL)
    assert read_edits(tmp_path) == ALL
    assert list(edit_digests(tmp_path)) == ["edits.yaml"]


def test_without_corrections_there_is_no_file(tmp_path):
    assert read_edits(tmp_path) == ()
    write_edits(tmp_path, ALL)
    write_edits(tmp_path, ())
    assert list(tmp_path.iterdir()) == []
    assert edit_digests(tmp_path) == {}


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("[1, 2]", "the file is [1, 2], not `key: value` lines"),
        ("", "the file is empty"),
        ("{format_version: 1, corrections: 3}", "corrections is 3, not a list"),
        (
            "{format_version: 1, corrections: [{drop: 3}]}",
            "correction 1: 'drop' is 3, not `key: value` lines",
        ),
        ("{format_version: 1, corrections: [{}]}", "correction 1: it says 0 things, not one of merge"),
        (
            "{format_version: 1, corrections: [{drop: {submap: 1, rectangle_m: [0, 0, 1]}}]}",
            "correction 1: rectangle_m is left, bottom, right, top, not [0, 0, 1]",
        ),
        (
            "{format_version: 1, corrections: [{drop: {submap: 1, rectangle_m: [0, 0, {}, wide]}}]}",
            "correction 1: rectangle_m[2] is 0 `key: value` lines",
        ),
        (
            "{format_version: 1, corrections: [{merge: {submap: 1, rectangle_m: [0, 0, 1, 1], states: 2}}]}",
            "correction 1: states is 2, not a list",
        ),
        ("corrections: []", "it has no format_version"),
        ("{format_version: 2, corrections: []}", "format version 2, this dynmap reads version 1"),
        ("{format_version: 1, corrections: [{drop: {submap: 1}}]}", "correction 1: it has no rectangle_m"),
        ("{format_version: 1, corrections: [drop]}", "correction 1: it is 'drop', not `key: value` lines"),
        ("{format_version: 1, corrections: [{paint: {submap: 1, rectangle_m: [0, 0, 1, 1]}}]}", "'paint' is"),
        (
            "{format_version: 1, corrections: [{drop: {submap: 1, rectangle_m: [0, 0, .nan, 1]}}]}",
            "rectangle_m[2] is nan, not a finite number",
        ),
        (
            "{format_version: 1, corrections: [{drop: {submap: -1, rectangle_m: [0, 0, 1, 1]}}]}",
            "is -1, not a whole number from 0",
        ),
        (
            "{format_version: 1, corrections: [{drop: {submap: 1, rectangle_m: [0, 0, 1, 1], x: 1}}]}",
            "'x' is not",
        ),
        (
            "{format_version: 1, corrections: [{merge: {submap: 1, rectangle_m: [0, 0, 1, 1], states: [2, 2]}}]}",
            "two or more",
        ),
        ("{format_version: 1, corrections: [{add: {submap: 1, polygon_m: [[0, 0], [1, 1]]}}]}", "2 corners"),
        (f"{{format_version: 1, corrections: [{AREA}, {AREA}]}}", "two areas are added with one number"),
        (
            "{format_version: 1, corrections: [{add: {submap: 1, polygon_m: [[0, 0], [1], [1, 1]]}}]}",
            "correction 1: a corner is two numbers",
        ),
    ],
)
def test_anything_else_is_refused(text, found, tmp_path):
    (tmp_path / "edits.yaml").write_text(text)
    with pytest.raises(ArtifactError) as caught:
        read_edits(tmp_path)
    message = str(caught.value)
    assert found in message
    assert "\n" not in message
    assert not any(word in message for word in ("object", "unpack", "argument", "subscript"))


def test_a_polygon_is_a_corner_per_line(tmp_path):
    path = tmp_path / "area.csv"
    path.write_text("# the shelf\n0,0\n\n 1.5 , 0 # door side\n1.5,-2e0\n")
    assert read_polygon(path) == ((0.0, 0.0), (1.5, 0.0), (1.5, -2.0))


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("", "0 corners"),
        ("0,0\n1,0\n", "2 corners"),
        ("0,0\n1,0\nx,y\n", "line 3"),
        ("0,0\n1,0,2\n", "line 2"),
        ("0,0\n1,0\n2,0\n", "the corners enclose 0 m2"),
        ("0,0\n1,0\nnan,1\n", "line 3 is not"),
        ("0,0\n1,0\n1_0,1\n", "line 3 is not"),
        ("0,0\n1,0\n1,1e9\n", "within"),
    ],
)
def test_what_is_no_polygon_is_refused(text, found, tmp_path):
    path = tmp_path / "area.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=found):
        read_polygon(path)


@pytest.mark.parametrize("name", ["", "  ", "a\nb", "x" * 61, "\x1b[31m"])
def test_what_is_no_name_is_refused(name):
    with pytest.raises(ValueError, match="printable characters"):
        check_name(name)
