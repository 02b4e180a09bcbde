"""edits.yaml: the corrections of a run by hand, in the order in which they are applied."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import yaml

from dynmap_cli.domain.corrections import Addition, Correction, Drop, Merge, Name, Place
from dynmap_cli.domain.grid import FARTHEST_M
from dynmap_cli.domain.submaps import Rectangle
from dynmap_cli.errors import ArtifactError
from dynmap_cli.files.atomic import replacing
from dynmap_cli.files.damage import refusing_damage
from dynmap_cli.files.documents import parse_yaml, read_text
from dynmap_cli.files.manifest import FORMAT_VERSION, sha256_of

NAME = "edits.yaml"
_LONGEST_NAME, _MOST_CORNERS, _LEAST_AREA_M2 = 60, 10_000, 1e-6
_SIDES = 4


def edit_digests(run_dir: Path) -> dict[str, str]:
    """Digest of the file, by its name; nothing where nothing was corrected."""
    path = run_dir / NAME
    return {NAME: sha256_of(path)} if path.is_file() else {}


def write_edits(run_dir: Path, corrections: Sequence[Correction]) -> None:
    """Write edits.yaml; without corrections there is none."""
    path = run_dir / NAME
    if not corrections:
        path.unlink(missing_ok=True)
        return
    content = {"format_version": FORMAT_VERSION, "corrections": [_entry(one) for one in corrections]}
    with replacing(path) as part:
        text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, allow_unicode=True)
        part.write_text(text, encoding="utf-8")


def read_edits(run_dir: Path) -> tuple[Correction, ...]:
    """Read edits.yaml; nothing where nothing was corrected.

    Raises
    ------
    ArtifactError
        If it is damaged, of another format version, or says something that is not a correction.
    """
    path = run_dir / NAME
    if not path.is_file():
        return ()
    with refusing_damage(f"{path}: not a list of corrections", "Mend it or take it away.", ArtifactError):
        content = _mapping(parse_yaml(read_text(path)), "the file")
        found = content["format_version"]
        if found != FORMAT_VERSION:
            msg = f"format version {found}, this dynmap reads version {FORMAT_VERSION}"
            raise ValueError(msg)
        entries = _list(content["corrections"], "corrections")
        corrections = tuple(_numbered(number, entry) for number, entry in enumerate(entries, start=1))
        added = [one.submap_id for one in corrections if isinstance(one, Addition)]
        if len(set(added)) < len(added):
            msg = f"two areas are added with one number: {added}"
            raise ValueError(msg)
        return corrections


def check_name(name: str) -> str:
    """The name without spaces around it.

    Raises
    ------
    ValueError
        If it is empty, long, or not printable in one line.
    """
    stripped = name.strip()
    if not stripped or len(stripped) > _LONGEST_NAME or not stripped.isprintable():
        msg = f"a name has 1 to {_LONGEST_NAME} printable characters, not {name[: 2 * _LONGEST_NAME]!r}"
        raise ValueError(msg)
    return stripped


def check_corners(corners: Sequence[Sequence[float]]) -> tuple[tuple[float, float], ...]:
    """The corners of a polygon, as they are.

    Raises
    ------
    ValueError
        If there are less than three, or they span no area.
    """
    if any(len(corner) != len("xy") for corner in corners):
        msg = "a corner is two numbers, x and y in metres"
        raise ValueError(msg)
    points = tuple((float(x), float(y)) for x, y in corners)
    if not 3 <= len(points) <= _MOST_CORNERS:
        msg = f"{len(points)} corners, a polygon has 3 to {_MOST_CORNERS}"
        raise ValueError(msg)
    if not all(math.isfinite(value) and abs(value) <= FARTHEST_M for point in points for value in point):
        msg = f"coordinates are finite and within {FARTHEST_M:g} m of the origin"
        raise ValueError(msg)
    enclosed_m2 = 0.5 * abs(
        sum(x * next_y - next_x * y for (x, y), (next_x, next_y) in pairwise((*points, points[0])))
    )
    if enclosed_m2 < _LEAST_AREA_M2:
        msg = f"the corners enclose {enclosed_m2:.1g} m2, at least {_LEAST_AREA_M2:g} m2 is needed"
        raise ValueError(msg)
    return points


def read_polygon(path: Path) -> tuple[tuple[float, float], ...]:
    """Corners of a polygon in the map frame: a corner per line, `x,y` in metres; what follows a # is passed over.

    Raises
    ------
    OSError, ValueError
        If it cannot be read or is none.
    """
    corners = []
    for number, line in enumerate(read_text(path).removeprefix("\ufeff").splitlines(), start=1):
        words = line.partition("#")[0].split(",")
        if words == [""] or not line.strip():
            continue
        try:
            x, y = (float(word) for word in words)
        except ValueError as err:
            msg = f"line {number} is not `x,y` in metres: {line[:60]!r}"
            raise ValueError(msg) from err
        corners.append((x, y))
    return check_corners(corners)


def _entry(correction: Correction) -> dict[str, Any]:
    """A correction as plain values."""
    if isinstance(correction, Addition):
        corners = [list(corner) for corner in correction.corners_m]
        return {"add": {"submap": correction.submap_id, "polygon_m": corners}}
    box = correction.place.rectangle
    sides = [round(side, 9) for side in (box.left_m, box.bottom_m, box.right_m, box.top_m)]
    where = {"submap": correction.place.submap_id, "rectangle_m": sides}
    if isinstance(correction, Merge):
        return {"merge": {**where, "states": list(correction.states)}}
    if isinstance(correction, Name):
        return {"name": {**where, "name": correction.name}}
    return {"drop": where}


def _mapping(value: object, what: str) -> dict[str, Any]:
    """Keys with values."""
    if not isinstance(value, dict):
        msg = f"{what} is {_said(value)}, not `key: value` lines"
        raise ValueError(msg)
    return dict(value)


def _list(value: object, what: str) -> list[Any]:
    """Values in a row."""
    if not isinstance(value, list):
        msg = f"{what} is {_said(value)}, not a list"
        raise ValueError(msg)
    return value


def _numbers(value: object, what: str) -> list[float]:
    """Numbers in a row."""
    row = _list(value, what)
    try:
        return [float(one) for one in row]
    except (TypeError, ValueError, OverflowError) as err:
        msg = f"{what} holds something that is no number: {_said(value)}"
        raise ValueError(msg) from err


def _said(value: object) -> str:
    """A value as it may stand in a message."""
    return "empty" if value is None else f"{value!r:.60}"


def _numbered(number: int, entry: object) -> Correction:
    """One entry; what is wrong is said with its number."""
    try:
        content = _mapping(entry, "it")
        if len(content) != 1:
            msg = f"it says {len(content)} things, not one of merge, drop, name, add"
            raise ValueError(msg)
        kind, words = next(iter(content.items()))
        return _correction(str(kind), _mapping(words, f"'{kind}'"))
    except (ValueError, KeyError) as err:
        why = f"{err} is missing" if isinstance(err, KeyError) else str(err)
        msg = f"correction {number}: {why}"
        raise ValueError(msg) from err


def _correction(kind: str, words: dict[str, Any]) -> Correction:
    """A correction from plain values."""
    submap_id = _count(words.pop("submap"))
    made: Correction
    if kind == "add":
        corners = _list(words.pop("polygon_m"), "polygon_m")
        made = Addition(submap_id, check_corners([_numbers(corner, "a corner") for corner in corners]))
    else:
        place = Place(submap_id, _rectangle(words.pop("rectangle_m")))
        if kind == "merge":
            made = Merge(place, _states(words.pop("states")))
        elif kind == "name":
            made = Name(place, check_name(str(words.pop("name"))))
        elif kind == "drop":
            made = Drop(place)
        else:
            msg = f"'{kind}' is none of merge, drop, name, add"
            raise ValueError(msg)
    if words:
        msg = f"'{next(iter(words))}' is not known in '{kind}'"
        raise ValueError(msg)
    return made


def _rectangle(sides: object) -> Rectangle:
    """Left, bottom, right, top."""
    numbers = _numbers(sides, "rectangle_m")
    left, bottom, right, top = numbers if len(numbers) == _SIDES else (math.nan,) * _SIDES
    if not (left < right and bottom < top and max(map(abs, (left, bottom, right, top))) <= FARTHEST_M):
        msg = f"rectangle_m is left, bottom, right, top, not {_said(sides)}"
        raise ValueError(msg)
    return Rectangle(left, bottom, right, top)


def _states(numbers: object) -> tuple[int, ...]:
    """Two states or more."""
    states = tuple(sorted({_count(number) for number in _list(numbers, "states")}))
    if len(states) < 2:
        msg = "states are two or more"
        raise ValueError(msg)
    return states


def _count(value: object) -> int:
    """A number from 0."""
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        msg = f"a number of a sub-map or state is a whole number from 0, not {value!r}"
        raise ValueError(msg)
    return value
