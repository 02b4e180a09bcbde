"""The objects of sub-maps in patches.zip: `objects` in the manifest, objects.npy per sub-map, objects.csv.

objects.npy (rows, cols) int16 holds the number of the object that each cell belongs to, -1 = none; row 0 has the lowest
y. objects.csv has one row per visit and object: submap,visit,object,state, with the state on, off or unknown; the visit
is the sequence of sequences.csv.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from typing import Any

import numpy as np

from dynmap_cli.domain.grid import MAX_CELLS, GridFrame
from dynmap_cli.domain.patches import OFF, ON, UNKNOWN_STATE, ChangingObject, PatchSet
from dynmap_cli.files.csv_tables import rows_of, whole_in
from dynmap_cli.files.npy import Column, parse_npy
from dynmap_cli.files.plain_values import said

OBJECTS_TABLE = "objects.csv"
_COLUMNS = ("submap", "visit", "object", "state")
_STATES = (ON, OFF, UNKNOWN_STATE)


def entries_of(objects: Sequence[ChangingObject], frame: GridFrame) -> list[dict[str, Any]]:
    """What the manifest says of the objects of a sub-map: number, rectangle (left, bottom, right, top), cells."""
    entries = []
    for thing in objects:
        rows, cols = np.nonzero(thing.cells)
        left, bottom = frame.origin_x_m, frame.origin_y_m
        corners = (cols.min(), rows.min(), cols.max() + 1, rows.max() + 1)
        rectangle = [
            round(start + int(corner) * frame.resolution_m, 9)
            for corner, start in zip(corners, (left, bottom, left, bottom), strict=True)
        ]
        entries.append({"id": thing.object_id, "rectangle_m": rectangle, "cells": int(thing.cells.sum())})
    return entries


def cells_bytes(objects: Sequence[ChangingObject], frame: GridFrame) -> bytes:
    """objects.npy of a sub-map."""
    numbers = np.full(frame.shape, -1, dtype="<i2")
    for thing in objects:
        numbers[thing.cells] = thing.object_id
    stream = io.BytesIO()
    np.save(stream, numbers, allow_pickle=False)
    return stream.getvalue()


def table_bytes(patch_sets: Iterable[PatchSet]) -> bytes:
    """objects.csv, by sub-map, visit and object."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for patch_set in patch_sets:
        rows = [
            (patch_set.submap_id, visit, thing.object_id, state)
            for thing in patch_set.objects
            for visit, state in thing.states.items()
        ]
        writer.writerows(sorted(rows))
    return stream.getvalue().encode()


def parse_table(content: bytes) -> dict[tuple[int, int], dict[int, str]]:
    """States by number of the visit, for each sub-map and object; raises ValueError."""
    states: dict[tuple[int, int], dict[int, str]] = {}
    for where, row in rows_of(content, _COLUMNS, OBJECTS_TABLE):
        submap_id, visit, thing = (whole_in(row[name], f"{where}: {name}") for name in _COLUMNS[:3])
        if row["state"] not in _STATES:
            msg = f"{where}: state is {said(row['state'])}, not {', '.join(_STATES)}"
            raise ValueError(msg)
        seen = states.setdefault((submap_id, thing), {})
        if visit in seen:
            msg = f"{where}: visit {visit}, object {thing} of sub-map {submap_id} is there twice"
            raise ValueError(msg)
        seen[visit] = row["state"]
    return states


def check_table(
    states: Mapping[tuple[int, int], Mapping[int, str]],
    objects: AbstractSet[tuple[int, int]],
    visits: AbstractSet[tuple[int, int]],
) -> None:
    """Refuse states of objects or in visits that there are none of; both by sub-map and number; raises ValueError."""
    for (submap_id, thing), seen in states.items():
        if (submap_id, thing) not in objects:
            msg = f"{OBJECTS_TABLE}: object {thing} of sub-map {submap_id} is not in manifest.json"
            raise ValueError(msg)
        for visit in seen:
            if (submap_id, visit) not in visits:
                msg = f"{OBJECTS_TABLE}: visit {visit} of sub-map {submap_id} is not in sequences.csv"
                raise ValueError(msg)


def parse_objects(
    entries: Sequence[tuple[int, int]],
    cells: bytes,
    name: str,
    frame: GridFrame,
    states: Mapping[int, Mapping[int, str]],
) -> tuple[ChangingObject, ...]:
    """The objects of a sub-map as `entries_of`, `cells_bytes` and `table_bytes` wrote them; raises ValueError.

    Parameters
    ----------
    entries : sequence of (int, int)
        Number and count of cells of each, of the manifest.
    cells : bytes
        objects.npy.
    name : str
        Of that member.
    frame : GridFrame
    states : mapping of int to mapping of int to str
        By object and visit.
    """
    if len(entries) * frame.rows * frame.cols > 2 * MAX_CELLS:
        msg = f"{name}: {len(entries)} objects in {frame.cols} x {frame.rows} cells, more than are allowed"
        raise ValueError(msg)
    numbers = parse_npy(io.BytesIO(cells), len(cells), Column("<i2", frame.shape), name)
    found, counts = np.unique(numbers, return_counts=True)
    there = {
        number: count for number, count in zip(found.tolist(), counts.tolist(), strict=True) if number != -1
    }
    for number in sorted(there.keys() ^ dict(entries).keys()):
        missing, has = ("it", "manifest.json") if number in dict(entries) else ("manifest.json", "it")
        msg = f"{name}: {has} has an object {number}, {missing} has none"
        raise ValueError(msg)
    for number, count in entries:
        if there[number] != count:
            msg = f"{name} has {there[number]} cells of object {number}, manifest.json says {count}"
            raise ValueError(msg)
    return tuple(
        ChangingObject(number, numbers == number, dict(states.get(number, {}))) for number, _ in entries
    )
