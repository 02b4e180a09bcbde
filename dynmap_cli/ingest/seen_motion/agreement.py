"""How an odometry turns where the sweeps do: alike, the other way round, or in its own way."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import F64, I64
from dynmap_cli.domain.poses import wrap_angle
from dynmap_cli.ingest.seen_motion.pairs import rows_at
from dynmap_cli.ingest.seen_motion.turns import TURNING_RAD, ScanTurns

_LEAST_TURNING = 8
_CLEARLY = 0.4
_CHANCE = 1e-3
"""Of as many pairs or more being mirrored, were each as likely to be."""


@dataclass(frozen=True, slots=True)
class Agreement:
    """How the turns of an odometry agree with those of the sweeps, over the pairs in which either turns.

    Attributes
    ----------
    n_pairs : int
        Of which no two overlap in time.
    same_rad, opposite_rad, still_rad : float
        Median of what is left of the turns of the sweeps without those of the odometry, with them, and as they are;
        inf where fewer pairs turn than say anything.
    opposite : float
        Share of the pairs in which least is left with the turns of the odometry.
    """

    n_pairs: int
    same_rad: float
    opposite_rad: float
    still_rad: float
    opposite: float

    @property
    def is_mirrored(self) -> bool:
        """Whether the sweeps clearly turn against the odometry, as those of a laser that hangs upside down."""
        if self.opposite_rad >= _CLEARLY * min(self.same_rad, self.still_rad):
            return False
        return chance_of(round(self.opposite * self.n_pairs), self.n_pairs) < _CHANCE


def chance_of(n_found: int, n_pairs: int) -> float:
    """Chance that so many or more of the pairs go one way where either is as likely: the tail of a sign test."""
    return sum(math.comb(n_pairs, k) for k in range(n_found, n_pairs + 1)) * 0.5**n_pairs


NO_AGREEMENT = Agreement(0, np.inf, np.inf, np.inf, 0.0)


def agreement(turns: ScanTurns, yaws_rad: tuple[F64, F64]) -> Agreement:
    """Compare the turns of sweeps with headings (n,) of an odometry at both sweeps of each pair; NaN = none."""
    driven_rad = wrap_angle(yaws_rad[1] - yaws_rad[0])
    is_turning = np.isfinite(driven_rad) & (
        (np.abs(driven_rad) > TURNING_RAD) | (np.abs(turns.turns_rad) > TURNING_RAD)
    )
    if np.count_nonzero(is_turning) < _LEAST_TURNING:
        return NO_AGREEMENT
    seen_rad, driven_rad = turns.turns_rad[is_turning], driven_rad[is_turning]
    left_rad = np.abs(wrap_angle(np.stack([seen_rad - driven_rad, seen_rad + driven_rad, seen_rad])))
    same_rad, opposite_rad, still_rad = np.median(left_rad, axis=1).tolist()
    return Agreement(
        _n_apart(turns.first_ns[is_turning], turns.second_ns[is_turning]),
        same_rad,
        opposite_rad,
        still_rad,
        float(np.mean(np.argmin(left_rad, axis=0) == 1)),
    )


def _n_apart(first_ns: I64, second_ns: I64) -> int:
    """How many pairs there are of which no two overlap; pairs (n,) are in the order of time."""
    n_apart, end_ns = 0, first_ns[0]
    for begin_ns, finish_ns in zip(first_ns.tolist(), second_ns.tolist(), strict=True):
        if begin_ns >= end_ns:
            n_apart, end_ns = n_apart + 1, finish_ns
    return n_apart


def agreement_at(turns: ScanTurns, stamps_ns: I64, poses: F64) -> Agreement:
    """Compare the turns of sweeps with poses (n, 3) of an odometry at the stamps (n,), ascending, of all sweeps."""
    yaws = [poses[rows_at(stamps_ns, at_ns), 2] for at_ns in (turns.first_ns, turns.second_ns)]
    return agreement(turns, (yaws[0], yaws[1]))
