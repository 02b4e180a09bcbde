"""The objects of sub-maps in patches.zip: `objects` in the manifest, objects.npy per sub-map, objects.csv.

objects.npy (rows, cols) int16 holds the number of the object that each cell belongs to, -1 = none; row 0 has the lowest
y. objects.csv has one row per visit and object: submap,visit,object,state, with the state on, off or unknown; the visit
is the sequence of sequences.csv.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from dynmap_cli.domain.grid import MAX_CELLS, GridFrame
from dynmap_cli.domain.patches import OFF, ON, UNKNOWN_STATE, ChangingObject, PatchSet
from dynmap_cli.files.npy import Column, parse_npy

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
    for row in csv.DictReader(io.StringIO(content.decode("utf-8"))):
        if row["state"] not in _STATES:
            msg = f"{OBJECTS_TABLE}: state {row['state']!r}"
            raise ValueError(msg)
        states.setdefault((int(row["submap"]), int(row["object"])), {})[int(row["visit"])] = row["state"]
    return states


def parse_objects(
    entries: Sequence[Mapping[str, Any]],
    cells: bytes,
    frame: GridFrame,
    states: Mapping[int, Mapping[int, str]],
) -> tuple[ChangingObject, ...]:
    """The objects of a sub-map as `entries_of`, `cells_bytes` and `table_bytes` wrote them; raises ValueError.

    Parameters
    ----------
    entries : sequence of mapping
        Of the manifest.
    cells : bytes
        objects.npy.
    frame : GridFrame
    states : mapping of int to mapping of int to str
        By object and visit.
    """
    if len(entries) * frame.rows * frame.cols > 2 * MAX_CELLS:
        msg = f"{len(entries)} objects in {frame.cols} x {frame.rows} cells"
        raise ValueError(msg)
    numbers = parse_npy(io.BytesIO(cells), len(cells), Column("<i2", frame.shape), "objects.npy")
    ids = [int(entry["id"]) for entry in entries]
    if sorted(ids) != [int(number) for number in np.unique(numbers[numbers >= 0])]:
        msg = f"objects {ids}, but other numbers in their cells"
        raise ValueError(msg)
    return tuple(ChangingObject(number, numbers == number, dict(states.get(number, {}))) for number in ids)
