r"""How a laser moved between two sweeps, by the changes of its ranges.

From one sweep to a next one ranges r at bearing b, u = (cos b, sin b), v = (-sin b, cos b), change by

.. math::
    \Delta r = -d \cdot u + \frac{r'}{r} d \cdot v + r' \varphi

where the laser moves by d and turns by phi (the range flow of Gonzalez and Gutierrez, 1999): three unknowns of as many
equations as there are beams.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dynmap_cli.arrays import B1, F64, I64

LEAST_BEAMS = 20
_MOST_SLOPE_M, _MOST_CHANGE_M, _OUTLIERS, _LEAST_KNOWN = 0.3, 0.6, 3.0, 0.03
_ROUNDS, _REACH_RAD, _ABOVE_NOISE, _SIGMA_OF_MEDIAN = 3, np.radians(1.0), 3.0, 1.4826
C128 = NDArray[np.complex128]


def range_flow(before: F64, after: F64, bearings_rad: F64) -> tuple[C128, F64, B1]:
    """How a laser moved between pairs of its sweeps, by the changes of its ranges.

    Parameters
    ----------
    before, after : (m, n_beams) float64
        Ranges in metres; NaN = no return.
    bearings_rad : (n_beams,) float64

    Returns
    -------
    moved : (m,) complex128
        x + iy in metres, in the frame of the laser before.
    turned_rad : (m,) float64
    is_known : (m,) bool
        Whether the beams say how far it moved in both directions.
    """
    reach = _reach(bearings_rad)
    inner = slice(reach, bearings_rad.size - reach)
    middle = (before + after) / 2.0
    rise = middle[:, 2 * reach :] - middle[:, : -2 * reach]
    span_rad = bearings_rad[2 * reach :] - bearings_rad[: -2 * reach]
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = rise / span_rad
    along = np.exp(1j * bearings_rad[inner])
    change, range_m = (after - before)[:, inner], middle[:, inner]
    factor = -along + slope / range_m * (1j * along)
    columns = np.stack([factor.real, factor.imag, slope], axis=2)
    is_used = np.isfinite(columns).all(axis=2) & np.isfinite(change)
    is_used &= (np.abs(rise) < _MOST_SLOPE_M) & (np.abs(change) < _MOST_CHANGE_M)
    # A code for no return stays exactly the same.
    is_used &= (rise != 0.0) | (change != 0.0)
    columns[~is_used], change = 0.0, np.where(is_used, change, 0.0)
    off_m, usual_m = np.zeros(change.shape), np.zeros(change.shape[0])
    for _ in range(_ROUNDS):
        with np.errstate(invalid="ignore"):
            weights = (is_used & (off_m <= _OUTLIERS * usual_m[:, None])).astype(np.float64)
        normal = np.einsum("mb,mbi,mbj->mij", weights, columns, columns) + 1e-9 * np.eye(3)
        right = np.einsum("mb,mbi,mb->mi", weights, columns, change)
        found = np.linalg.solve(normal, right[..., None])[..., 0]
        off_m = np.abs(change - np.einsum("mbi,mi->mb", columns, found))
        off_m[~is_used] = np.nan
        usual_m = np.nanmedian(np.where(is_used.any(axis=1, keepdims=True), off_m, 0.0), axis=1)
    across = 1j * along / np.where(is_used, range_m, 1.0)
    of_slope = np.stack([across.real, across.imag, np.ones(across.shape)], axis=2)
    variance = (_SIGMA_OF_MEDIAN * usual_m[:, None] / span_rad) ** 2 / 2.0
    noise = np.einsum("mb,mbi,mbj->mij", weights * variance, of_slope, of_slope)
    is_known = _stands_out(normal, noise, np.count_nonzero(is_used, axis=1))
    return found[:, 0] + 1j * found[:, 1], found[:, 2], is_known


def _reach(bearings_rad: F64) -> int:
    """How many beams before and after one its slope is taken over: near ones tell little but noise."""
    step_rad = abs(float(bearings_rad[1] - bearings_rad[0]))
    return max(1, min(int(_REACH_RAD / max(step_rad, 1e-9) + 0.5), bearings_rad.size // 4))


def _stands_out(normal: F64, noise: F64, n_used: I64) -> B1:
    r"""Whether pairs of sweeps (m,) say more of the way in each direction than the noise of their ranges seems to.

    A slope is a difference of two ranges at bearings 2 delta apart, here in the middle of two sweeps. As an error of
    the factors, noise sigma of a range adds to the normal equations in the mean (Fuller, Measurement Error Models,
    1987)

    .. math:: \sum_b \frac{\sigma^2}{4 \delta^2} (v / r, 1) (v / r, 1)^T

    which looks like walls across where there are none. What is known of the way while the turn is not is what is left
    of the equations when the turn is eliminated (the Schur complement).

    Parameters
    ----------
    normal, noise : (m, 3, 3) float64
        Normal equations and what noise adds to them.
    n_used : (m,) int64
        Beams in them.
    """
    sure = normal - _ABOVE_NOISE * noise
    is_known: B1 = (n_used >= LEAST_BEAMS) & (sure[:, 2, 2] > 0.0)
    sure = sure[is_known]
    left = sure[:, :2, :2] - sure[:, :2, 2:] * sure[:, 2:, :2] / sure[:, 2:, 2:]
    is_known[is_known] = np.linalg.eigvalsh(left)[:, 0] > _LEAST_KNOWN * n_used[is_known]
    return is_known
