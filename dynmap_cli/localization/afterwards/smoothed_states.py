"""States of sub-maps with what was seen later taken into account (forward-backward, Rabiner 1989)."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dynmap_cli.arrays import F32, F64
from dynmap_cli.localization.beliefs.transitions import look_back, predict_belief
from dynmap_cli.localization.found import StateRow
from dynmap_cli.localization.sensing.map_pool import MapPool

REPAINT_ABOVE = 0.01
_LEAST = 1e-12


def smooth_states(rows: Sequence[StateRow], pool: MapPool) -> list[StateRow]:
    """Beliefs at the same times, in the same order, given also what came after them.

    The belief of the filter f_t and the transitions P since the row before are all that is needed:
    g_t(i) = f_t(i) sum_j P(i -> j) g_{t+1}(j) / sum_i f_t(i) P(i -> j).
    """
    smoothed = list(rows)
    following: dict[int, int] = {}
    for index in range(len(rows) - 1, -1, -1):
        row = rows[index]
        if row.submap in following:
            later = smoothed[following[row.submap]]
            seconds = max(later.stamp_ns - row.stamp_ns, 0) * 1e-9
            submap = pool.submaps[row.submap]
            ratio = later.belief / np.maximum(predict_belief(row.belief, submap, seconds), _LEAST)
            belief = row.belief * look_back(ratio / ratio.sum(), submap, seconds)
            smoothed[index] = replace(row, belief=np.asarray(belief / belief.sum()))
        following[row.submap] = index
    return smoothed


class StateHistory:
    """The likelihood field of the map, with every sub-map as it was believed to be at some time.

    Attributes
    ----------
    field : (rows, cols) float32
        Likelihood of an end in each cell, not as logarithm.
    """

    def __init__(self, rows: Sequence[StateRow], pool: MapPool) -> None:
        frame = pool.frame
        self.field: F32 = np.exp(pool.pool[: frame.rows * frame.cols].reshape(frame.shape))
        self._pool = pool
        self._stamps: dict[int, list[int]] = {}
        self._beliefs: dict[int, list[F64]] = {}
        for row in rows:
            self._stamps.setdefault(row.submap, []).append(row.stamp_ns)
            self._beliefs.setdefault(row.submap, []).append(row.belief)
        self._painted: dict[int, F64] = {}
        self._shown_ns: int | None = None

    def show(self, stamp_ns: int) -> None:
        """Every sub-map as in its last row until then, or as in its first."""
        if stamp_ns == self._shown_ns:
            return
        self._shown_ns = stamp_ns
        for number, stamps in self._stamps.items():
            belief = self._beliefs[number][max(bisect_right(stamps, stamp_ns) - 1, 0)]
            painted = self._painted.get(number)
            if painted is None or np.abs(belief - painted).max() > REPAINT_ABOVE:
                self._paint(number, belief)
                self._painted[number] = belief

    def _paint(self, number: int, belief: F64) -> None:
        """The mixture of the states under a belief."""
        submap = self._pool.submaps[number]
        rows = slice(submap.row, submap.row + submap.frame.rows)
        window = self.field[rows, submap.col : submap.col + submap.frame.cols]
        window[submap.owned] = np.tensordot(belief, submap.likelihoods, axes=1)[submap.owned]
