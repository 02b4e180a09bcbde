"""What looks and watches say of each beam, by the cell it ends in."""

from __future__ import annotations

import math

from dynmap_cli.arrays import B1, F32, F64, I32, U8
from dynmap_cli.kernels.jit import kernel


@kernel
def number_cells(end_cells: I32, numbers: I32, out: I32) -> None:
    """Write the number of each beam's end cell; -1 where it has none.

    Parameters
    ----------
    end_cells : (n_scans, n_beams) int32
        Flat index of the end cell, -1 = none.
    numbers : (n_cells,) int32
        1 + number of each cell; 0 = none.
    out : (n_scans, n_beams) int32
        May be *end_cells*.
    """
    for scan in range(end_cells.shape[0]):
        for beam in range(end_cells.shape[1]):
            cell = end_cells[scan, beam]
            out[scan, beam] = numbers[cell] - 1 if cell >= 0 else -1


@kernel
def count_kept(end_cells: I32, by_beams: F32, least: F32, most: F32, out: F64) -> None:
    """Count the beams in their end cells that are static as far as beams and all looks tell (e >= 1/2).

    Parameters
    ----------
    end_cells : (n_scans, n_beams) int32
        Flat index of the end cell, -1 = none.
    by_beams : (n_scans, n_beams) float32
        e of the beam counts.
    least, most : (n_cells,) float32
        Bounds of e in each cell; the second one holds where they contradict.
    out : (n_cells,) float64
    """
    for scan in range(end_cells.shape[0]):
        for beam in range(end_cells.shape[1]):
            cell = end_cells[scan, beam]
            if cell >= 0 and min(max(by_beams[scan, beam], least[cell]), most[cell]) >= 0.5:
                out[cell] += 1.0


@kernel
def judge_beams(
    end_cells: I32,
    by_beams: F32,
    least: F32,
    most: F32,
    of_places: F32,
    of_things: F32,
    can_be_open: U8,
    most_of_open: float,
    least_of_all: float,
    out: F32,
    out_unknown: B1,
) -> None:
    """Write the final e of each beam, NaN where it has no end cell, and whether it is unknown.

    Parameters
    ----------
    end_cells, by_beams, least, most
        As for `count_kept`.
    of_places, of_things : (n_cells,) float32
        Largest e that the watches leave to any beam, and to one that is open.
    can_be_open : (n_cells,) uint8
        1 where a kept beam is open: no watch saw enough of the thing there.
    most_of_open, least_of_all : float
        Largest e of an open beam, least e of any.
    out : (n_scans, n_beams) float32
        May be *by_beams*.
    out_unknown : (n_scans, n_beams) bool
        Open, and kept in the end.
    """
    for scan in range(end_cells.shape[0]):
        for beam in range(end_cells.shape[1]):
            cell = end_cells[scan, beam]
            if cell < 0:
                out[scan, beam], out_unknown[scan, beam] = math.nan, False
                continue
            e = min(max(by_beams[scan, beam], least[cell]), most[cell])
            is_open = e >= 0.5 and can_be_open[cell] > 0
            e = min(e, of_places[cell])
            if is_open:
                e = min(e, of_things[cell], most_of_open)
            out_unknown[scan, beam] = is_open and e >= 0.5
            out[scan, beam] = max(e, least_of_all)
