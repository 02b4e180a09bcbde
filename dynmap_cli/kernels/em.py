"""The E-step (Eq. 1.10) over all beams."""

from __future__ import annotations

import math

from dynmap_cli.arrays import F32, F64, I32
from dynmap_cli.kernels.jit import kernel


@kernel
def static_probability(end_reflectance: F64, static_prior: float, out: F64) -> None:
    r"""Write the expectation that a beam which ended at reflectance m was reflected by something static.

    .. math::
        e = \frac{p\,m}{p\,m + (1 - p)(1 - m)}

    Eq. 1.10 of the paper, multiplied out so that m = 0 needs no special case.

    Parameters
    ----------
    end_reflectance : (n,) float64
        Counting-map value m in [0, 1]; NaN stays NaN.
    static_prior : float
        Prior p(c = 1), in (0.5, 1).
    out : (n,) float64
        e in [0, 1].
    """
    for k in range(end_reflectance.size):
        hit = static_prior * end_reflectance[k]
        out[k] = hit / (hit + (1.0 - static_prior) * (1.0 - end_reflectance[k]))


@kernel
def look_up(end_cells: I32, cell_values: F32, out: F32) -> None:
    """Write the value of each beam's end cell; NaN where a beam has none.

    Parameters
    ----------
    end_cells : (n_scans, n_beams) int32
        Flat index of the end cell, -1 = none.
    cell_values : (n_cells,) float32
    out : (n_scans, n_beams) float32
    """
    for scan in range(end_cells.shape[0]):
        for beam in range(end_cells.shape[1]):
            cell = end_cells[scan, beam]
            out[scan, beam] = cell_values[cell] if cell >= 0 else math.nan


@kernel
def add_to_cells(end_cells: I32, values: F32, out: F64) -> None:
    """Add the value of each beam to its end cell.

    Parameters
    ----------
    end_cells : (n_scans, n_beams) int32
        Flat index of the end cell, -1 = none.
    values : (n_scans, n_beams) float32
    out : (n_cells,) float64
    """
    for scan in range(end_cells.shape[0]):
        for beam in range(end_cells.shape[1]):
            cell = end_cells[scan, beam]
            if cell >= 0:
                out[cell] += values[scan, beam]
