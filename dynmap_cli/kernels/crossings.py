"""Beams through a grid of surfaces: where they first cross one, and how likely they get through those on their way."""

from __future__ import annotations

import math

from dynmap_cli.arrays import F32, U8
from dynmap_cli.kernels.jit import kernel


@kernel
def _stretch_inside(start: float, step: float, size: int) -> tuple[float, float]:
    """From where to where along a ray one of its coordinates lies within [0, size)."""
    if step != 0.0:
        a, b = -start / step, (size - start) / step
        return min(a, b), max(a, b)
    return (-math.inf, math.inf) if 0.0 <= start < size else (math.inf, -math.inf)


@kernel
def _stretch_in_grid(
    x: float, y: float, dx: float, dy: float, length: float, rows: int, cols: int
) -> tuple[float, float]:
    """From where to where a ray lies in a grid; nowhere if the first is not the smaller one."""
    enter_x, leave_x = _stretch_inside(x, dx, cols)
    enter_y, leave_y = _stretch_inside(y, dy, rows)
    return max(0.0, enter_x, enter_y), min(length, leave_x, leave_y)


@kernel
def _first_cell(
    x: float, y: float, dx: float, dy: float, enter: float, rows: int, cols: int
) -> tuple[int, int]:
    """Row and column of the cell in which a ray enters a grid."""
    col = min(max(int(math.floor(x + dx * enter)), 0), cols - 1)
    row = min(max(int(math.floor(y + dy * enter)), 0), rows - 1)
    return row, col


@kernel
def _first_border(start: float, step: float, cell: int) -> tuple[float, float]:
    """Distance along a ray to where it leaves its first row or column of cells, and from one border to the next."""
    if step == 0.0:
        return math.inf, math.inf
    return (cell + (step > 0.0) - start) / step, abs(1.0 / step)


@kernel
def _step(
    row: int, col: int, next_x: float, next_y: float, ahead: tuple[int, int], deltas: tuple[float, float]
) -> tuple[int, int, float, float, float]:
    """The cell behind the nearer border, where a ray enters it, and its next borders (Amanatides and Woo, 1987)."""
    if next_x < next_y:
        return row, col + ahead[1], next_x, next_x + deltas[1], next_y
    return row + ahead[0], col, next_y, next_x, next_y + deltas[0]


@kernel
def _is_met(code: int, dx: float, dy: float, least_sine: float) -> bool:
    """Whether a ray of a direction meets a surface: 255 = whatever its own direction, else 1 + that in degrees."""
    along = math.radians(code - 1.0)
    return code == 255 or abs(dx * math.sin(along) - dy * math.cos(along)) >= least_sine


@kernel
def first_crossing(
    surfaces: U8, x: float, y: float, dx: float, dy: float, length: float, least_sine: float
) -> tuple[float, float]:
    """Where a beam enters a grid, and where it first crosses a surface in it; in cells.

    A beam that slides along a surface crosses nothing: only cells whose surface it meets at an angle
    with a sine of at least *least_sine* count.

    Parameters
    ----------
    surfaces : (rows, cols) uint8
        0 = nothing solid, 1 to 180 = solid, direction of the surface in degrees plus one,
        255 = solid from all sides.
    x, y : float
        The sensor, in cells of this grid (may lie outside).
    dx, dy : float
        Direction of the beam, of length 1.
    length : float
        How far the beam is followed, cells; finite.
    least_sine : float

    Returns
    -------
    enter, crossed : float
        Distance at which the beam enters the grid, and the cell with its first crossing; +inf where it does
        not within its length.
    """
    rows, cols = surfaces.shape
    enter, leave = _stretch_in_grid(x, y, dx, dy, length, rows, cols)
    if enter >= leave:
        return math.inf, math.inf
    row, col = _first_cell(x, y, dx, dy, enter, rows, cols)
    next_x, delta_x = _first_border(x, dx, col)
    next_y, delta_y = _first_border(y, dy, row)
    ahead, deltas = (1 if dy > 0 else -1, 1 if dx > 0 else -1), (delta_y, delta_x)
    at = enter
    while at < leave and 0 <= col < cols and 0 <= row < rows:
        code = surfaces[row, col]
        if code != 0 and _is_met(code, dx, dy, least_sine):
            return enter, at
        row, col, at, next_x, next_y = _step(row, col, next_x, next_y, ahead, deltas)
    return enter, math.inf


@kernel
def passing_share(
    surfaces: U8,
    passes: F32,
    x: float,
    y: float,
    dx: float,
    dy: float,
    length: float,
    beyond: float,
    least_sine: float,
) -> tuple[float, float]:
    """Where a beam enters a grid, in cells, and how likely one gets as far as this one.

    What is solid lets some beams through: panes that mirror only from the front, shelves, legs of chairs. So of each
    surface that the beam crosses, see `first_crossing`, the share of beams counts that passed its cells before; none
    passed where nobody has seen what lies behind.

    Parameters
    ----------
    surfaces, x, y, dx, dy, length, least_sine
        As for `first_crossing`.
    passes : (rows, cols) float32
        Share of the beams that pass each cell; NaN in cells without a surface that no beam has reached.
    beyond : float
        A cell is crossed by a beam that goes on this far behind where it enters it, cells.

    Returns
    -------
    enter, share : float
        Distance at which the beam enters the grid, +inf where it does not within its length; share of beams.
    """
    rows, cols = surfaces.shape
    enter, leave = _stretch_in_grid(x, y, dx, dy, length, rows, cols)
    if enter >= leave:
        return math.inf, 1.0
    row, col = _first_cell(x, y, dx, dy, enter, rows, cols)
    next_x, delta_x = _first_border(x, dx, col)
    next_y, delta_y = _first_border(y, dy, row)
    ahead, deltas = (1 if dy > 0 else -1, 1 if dx > 0 else -1), (delta_y, delta_x)
    at, share = enter, 1.0
    while at < leave and at + beyond <= length and 0 <= col < cols and 0 <= row < rows:
        code = surfaces[row, col]
        if code != 0:
            if _is_met(code, dx, dy, least_sine):
                share *= passes[row, col]
        elif share < 1.0 and math.isnan(passes[row, col]):
            share = 0.0
        row, col, at, next_x, next_y = _step(row, col, next_x, next_y, ahead, deltas)
    return enter, share
