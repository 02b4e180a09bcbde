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
from dynmap_cli.files.plain_values import (
    item_of,
    list_at,
    mapping_at,
    number_in,
    numbers_at,
    said,
    text_at,
    whole_at,
)

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
        content = mapping_at(parse_yaml(read_text(path)), "the file")
        found = item_of(content, "format_version", "it")
        if found != FORMAT_VERSION:
            msg = f"format version {said(found)}, this dynmap reads version {FORMAT_VERSION}"
            raise ValueError(msg)
        entries = list_at(item_of(content, "corrections", "it"), "corrections")
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


def name_at(value: object, where: str) -> str:
    """A name in a document; raises ValueError."""
    try:
        return check_name(text_at(value, where))
    except ValueError as err:
        msg = str(err) if str(err).startswith(where) else f"{where}: {err}"
        raise ValueError(msg) from err


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
            x, y = (number_in(word) for word in words)
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


def _numbered(number: int, entry: object) -> Correction:
    """One entry; what is wrong is said with its number."""
    try:
        content = dict(mapping_at(entry, "it"))
        if len(content) != 1:
            msg = f"it says {len(content)} things, not one of merge, drop, name, add"
            raise ValueError(msg)
        kind, words = next(iter(content.items()))
        return _correction(str(kind), mapping_at(words, f"'{kind}'"))
    except ValueError as err:
        msg = f"correction {number}: {err}"
        raise ValueError(msg) from err


def _correction(kind: str, words: dict[str, Any]) -> Correction:
    """A correction from plain values."""
    submap_id = _count(_taken(words, "submap"))
    made: Correction
    if kind == "add":
        corners = list_at(_taken(words, "polygon_m"), "polygon_m")
        made = Addition(submap_id, check_corners([numbers_at(corner, "a corner") for corner in corners]))
    else:
        place = Place(submap_id, _rectangle(_taken(words, "rectangle_m")))
        if kind == "merge":
            made = Merge(place, _states(_taken(words, "states")))
        elif kind == "name":
            made = Name(place, name_at(_taken(words, "name"), "name"))
        elif kind == "drop":
            made = Drop(place)
        else:
            msg = f"'{kind}' is none of merge, drop, name, add"
            raise ValueError(msg)
    if words:
        msg = f"'{next(iter(words))}' is not known in '{kind}'"
        raise ValueError(msg)
    return made


def _taken(words: dict[str, Any], key: str) -> Any:
    """A value that must be there, taken out of the others; raises ValueError."""
    value = item_of(words, key, "it")
    del words[key]
    return value


def _rectangle(sides: object) -> Rectangle:
    """Left, bottom, right, top."""
    numbers = numbers_at(sides, "rectangle_m")
    left, bottom, right, top = numbers if len(numbers) == _SIDES else (math.nan,) * _SIDES
    if not (left < right and bottom < top and max(map(abs, (left, bottom, right, top))) <= FARTHEST_M):
        msg = f"rectangle_m is left, bottom, right, top, not {said(sides)}"
        raise ValueError(msg)
    return Rectangle(left, bottom, right, top)


def _states(numbers: object) -> tuple[int, ...]:
    """Two states or more."""
    states = tuple(sorted({_count(number) for number in list_at(numbers, "states")}))
    if len(states) < 2:
        msg = "states are two or more"
        raise ValueError(msg)
    return states


def _count(value: object) -> int:
    """A number from 0."""
    return whole_at(value, "a number of a sub-map or state", 0, 2**31 - 1)
