"""Patches and objects keep their numbers when states are learned again from more visits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from scipy.optimize import linear_sum_assignment

from dynmap_cli.arrays import B1, F64, I8
from dynmap_cli.domain.grid import UNKNOWN, GridFrame
from dynmap_cli.domain.patches import ChangingObject, PatchSet, Visit

_LEAST_AGREEMENT, _TIE_BREAK = 0.75, 1e-3
_LEAST_SHARED = 0.5
_SHIFTS = sorted(
    ((row, col) for row in range(-2, 3) for col in range(-2, 3)),
    key=lambda shift: abs(shift[0]) + abs(shift[1]),
)
"""Rows and columns by which a map may have moved when drives were added to it; of equal ones the least is chosen."""
Cells = TypeVar("Cells", B1, I8)


def keep_numbers(
    patch_sets: Sequence[PatchSet], visits: Sequence[Visit], known: Sequence[PatchSet]
) -> tuple[tuple[PatchSet, ...], tuple[Visit, ...]]:
    """Give each patch the number of the known patch of its sub-map that shows the same, and new numbers to the others.

    Objects likewise: the number of the known object with which they share most cells, at least half of those of both.

    Pairs are chosen for the largest sum of agreements, each the share of the varying cells that both know which are
    occupied in both or free in both, the known ones shifted by up to two cells where more agree then; of pairs
    that agree as much those are chosen that know the same cells.

    Parameters
    ----------
    patch_sets, visits
        As learned, patches numbered by their support; sub-maps already have the numbers of before.
    known : sequence of PatchSet
        Of the map before.
    """
    before = {patch_set.submap_id: patch_set for patch_set in known}
    renumbered: list[PatchSet] = []
    numbers: dict[tuple[int, int], int] = {}
    for patch_set in patch_sets:
        given = _numbers_of(patch_set, before.get(patch_set.submap_id))
        patches = [replace(patch, patch_id=given[patch.patch_id]) for patch in patch_set.patches]
        renumbered.append(
            replace(
                patch_set,
                patches=tuple(sorted(patches, key=lambda patch: patch.patch_id)),
                objects=_renumbered_objects(patch_set, before.get(patch_set.submap_id)),
            )
        )
        numbers |= {(patch_set.submap_id, old): new for old, new in given.items()}
    return tuple(renumbered), tuple(
        visit if visit.patch is None else replace(visit, patch=numbers[visit.submap_id, visit.patch])
        for visit in visits
    )


def _numbers_of(patch_set: PatchSet, known: PatchSet | None) -> dict[int, int]:
    """Number of each patch, by the number it was learned with."""
    if known is None or known.frame.resolution_m != patch_set.frame.resolution_m:
        return {patch.patch_id: patch.patch_id for patch in patch_set.patches}
    agreement, in_common = max(
        (_compared(patch_set, known, shift) for shift in _SHIFTS),
        key=lambda found: float(found[0].max(axis=1).sum()),
    )
    given: dict[int, int] = {}
    for row, col in zip(*linear_sum_assignment(-(agreement + _TIE_BREAK * in_common)), strict=True):
        if agreement[row, col] >= _LEAST_AGREEMENT:
            given[patch_set.patches[int(row)].patch_id] = known.patches[int(col)].patch_id
    new = max(patch.patch_id for patch in known.patches) + 1
    for patch in patch_set.patches:
        if patch.patch_id not in given:
            given[patch.patch_id], new = new, new + 1
    return given


def _compared(patch_set: PatchSet, known: PatchSet, shift: tuple[int, int]) -> tuple[F64, F64]:
    """Agreement of each patch with each known one shifted by some cells, and the share of cells known in common."""
    frame = known.frame.window(*shift, known.frame.rows, known.frame.cols)
    varying = patch_set.varying | _brought_over(known.varying, frame, patch_set.frame, fill=False)
    before = [_brought_over(patch.cells, frame, patch_set.frame, fill=UNKNOWN) for patch in known.patches]
    return (
        np.array(
            [[_agreement(patch.cells, cells, varying) for cells in before] for patch in patch_set.patches]
        ),
        np.array([[_known_in_common(patch.cells, cells) for cells in before] for patch in patch_set.patches]),
    )


def _renumbered_objects(patch_set: PatchSet, known: PatchSet | None) -> tuple[ChangingObject, ...]:
    """Objects with the numbers of before, in their order."""
    if known is None or not known.objects or known.frame.resolution_m != patch_set.frame.resolution_m:
        return patch_set.objects
    before = [_brought_over(thing.cells, known.frame, patch_set.frame, fill=False) for thing in known.objects]
    shared = np.array(
        [
            [(thing.cells & cells).sum() / (thing.cells | cells).sum() for cells in before]
            for thing in patch_set.objects
        ]
    ).reshape(len(patch_set.objects), len(before))
    given: dict[int, int] = {}
    for row, col in zip(*linear_sum_assignment(-shared), strict=True):
        if shared[row, col] >= _LEAST_SHARED:
            given[int(row)] = known.objects[int(col)].object_id
    new = max(thing.object_id for thing in known.objects) + 1
    for row in range(len(patch_set.objects)):
        if row not in given:
            given[row], new = new, new + 1
    renumbered = [replace(thing, object_id=given[row]) for row, thing in enumerate(patch_set.objects)]
    return tuple(sorted(renumbered, key=lambda thing: thing.object_id))


def _agreement(cells: I8, other: I8, varying: B1) -> float:
    """Share of the varying cells that are known in both and the same; 1 where none varies."""
    if not varying.any():
        return 1.0
    both = varying & (cells != UNKNOWN) & (other != UNKNOWN)
    return float((cells == other)[both].mean()) if both.any() else 0.0


def _known_in_common(cells: I8, other: I8) -> float:
    """Share of the cells that any of both knows which both know."""
    one, two = cells != UNKNOWN, other != UNKNOWN
    return float((one & two).sum() / max((one | two).sum(), 1))


def _brought_over(cells: Cells, frame: GridFrame, to: GridFrame, *, fill: int) -> Cells:
    """The cells of one frame on another one of the same lattice."""
    result = np.full(to.shape, fill, dtype=cells.dtype)
    row = round((frame.origin_y_m - to.origin_y_m) / to.resolution_m)
    col = round((frame.origin_x_m - to.origin_x_m) / to.resolution_m)
    rows = slice(max(row, 0), min(row + frame.rows, to.rows))
    cols = slice(max(col, 0), min(col + frame.cols, to.cols))
    if rows.start < rows.stop and cols.start < cols.stop:
        result[rows, cols] = cells[rows.start - row : rows.stop - row, cols.start - col : cols.stop - col]
    return result
