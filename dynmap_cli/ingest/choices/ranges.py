"""What a range value means: REP 117, the codes of old drivers, and what a beam without return says.

REP 117: `min <= r < max` is a return, +inf = nothing within reach, NaN = no measurement, -inf = too close. Drivers
older than it write range_max or more, 0, or a code of their own (SICK: 81.83 to 81.91 m) where nothing came back.
In a `ScanLog` +inf says "free up to the usable range" and NaN says nothing.

The policy `auto` decides per laser, from the recording:

1. beams without return that pass through what other beams hit did not find free space, they failed (dark, oblique or
   glossy surfaces; indoors this is true of 40 to 80 % of the +inf of small scanners). Where more than 15 % do so, and
   twice as many as of the beams with a return, which shows what errors of the poses explain, they say nothing;
2. otherwise, where +inf occurs the driver keeps to REP 117, and no return means free;
3. where no return is a number at or beyond the reach, it means free only if real returns come near that reach
   (the farthest 0.1 % beyond 80 % of it). Otherwise nothing in that place is as far away as the reach, so the beam
   was absorbed, mirrored away or dazzled, and tracing it as free would erase what it went through: ignored;
4. zero, negative, -inf, NaN and values below the shortest range never say anything.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dynmap_cli.arrays import B1, F32
from dynmap_cli.domain.mapped import give_back
from dynmap_cli.ingest.choices.free_space import Contradiction, Sweeps, find_contradiction, kinds_of
from dynmap_cli.ingest.raw.columns import blocks_of
from dynmap_cli.ingest.raw.plausible import LONGEST_RANGE_M

Policy = Literal["auto", "free", "ignore"]

_CODE_WINDOW, _GAP_WINDOW = 0.99, 0.9
_CODE_EXCESS, _CODE_SHARE = 3.0, 0.9
_LEAST_CODES, _MOST_CODES = 10, 5
_NEAR_REACH = 0.8
_FARTHEST_QUANTILE = 0.999
_VALUES_AT_ONCE = 1 << 16
_MOST_CONTRADICTED, _CONTRADICTED_EXCESS = 0.15, 2.0


@dataclass(frozen=True, slots=True)
class NoReturn:
    """What beams without return say in a recording, and why.

    Attributes
    ----------
    policy : "free" or "ignore"
    why : str
        The evidence, in words.
    reach_m : float
        Values at or beyond it are no returns.
    share_no_return, share_nothing : float
        Shares of all beams: +inf or a number at or beyond the reach; no measurement.
    farthest_m : float
        Distance which only one return in a thousand exceeds; NaN without returns.
    """

    policy: Literal["free", "ignore"]
    why: str
    reach_m: float
    share_no_return: float
    share_nothing: float
    farthest_m: float


def find_reach_m(ranges_m: F32) -> float:
    """Where returns end and the codes of a driver begin, for a sensor whose reach the recording does not state.

    The values within 1 % of the largest are codes if five of them at most make up nine tenths of these beams, and
    they are three times as frequent as values per percent of distance are below (90 to 99 % of the largest). A wall
    scatters more. Without codes the reach lies just above the largest value. Values that no laser measures are codes.
    """
    largest = max((float(finite.max(initial=0.0)) for finite in _measurable(ranges_m)), default=0.0)
    if largest <= 0.0:
        return LONGEST_RANGE_M
    found, often = [], []
    near, n_top = 0, 0
    for finite in _measurable(ranges_m):
        top = finite[finite >= _CODE_WINDOW * largest]
        n_top += top.size
        near += int(np.count_nonzero(finite >= _GAP_WINDOW * largest))
        values, counts = np.unique(np.round(top, 3), return_counts=True)
        found.append(values)
        often.append(counts)
    _, number = np.unique(np.concatenate(found), return_inverse=True)
    counts = np.bincount(number, weights=np.concatenate(often)).astype(np.int64)
    codes = int(np.sort(counts)[-_MOST_CODES:].sum())
    per_percent = (near - n_top) / (100.0 * (_CODE_WINDOW - _GAP_WINDOW))
    if codes >= max(_LEAST_CODES, _CODE_EXCESS * per_percent) and codes >= _CODE_SHARE * n_top:
        return _CODE_WINDOW * largest
    return float(np.nextafter(np.float32(largest), np.float32(np.inf)))


def _measurable(ranges_m: F32) -> Iterator[F32]:
    """Yield the values (n,) that a laser could measure, block by block."""
    for rows in blocks_of(ranges_m):
        block = ranges_m[rows]
        yield block[np.abs(block) <= LONGEST_RANGE_M]
        give_back(ranges_m)


def judge_no_return(sweeps: Sweeps, range_min_m: float, range_max_m: float, wish: Policy) -> NoReturn:
    """Find what beams without return say.

    Parameters
    ----------
    sweeps : Sweeps
    range_min_m, range_max_m : float
        As the recording states them; +inf = not stated.
    wish : str
        "free" or "ignore" overrule the evidence.
    """
    ranges_m = sweeps.ranges_m
    reach_m = range_max_m if np.isfinite(range_max_m) else find_reach_m(ranges_m)
    farthest = Farthest(_FARTHEST_QUANTILE, ranges_m.size)
    n_infinite, n_no_return = 0, 0
    for rows in blocks_of(ranges_m):
        block = ranges_m[rows]
        is_return, is_no_return = kinds_of(block, range_min_m, reach_m)
        n_infinite += int(np.count_nonzero(block == np.inf))
        n_no_return += int(np.count_nonzero(is_no_return))
        farthest.add(block, is_return)
        give_back(ranges_m)
    size = max(ranges_m.size, 1)
    infinite, no_return = n_infinite / size, n_no_return / size
    nothing = max(1.0 - no_return - farthest.n_values / size, 0.0)
    farthest_m = farthest.value
    if wish != "auto":
        return NoReturn(wish, "as set", reach_m, no_return, nothing, farthest_m)
    found = find_contradiction(sweeps, range_min_m, reach_m)
    policy, why = _weigh(infinite, no_return, farthest_m, reach_m, found)
    return NoReturn(policy, why, reach_m, no_return, nothing, farthest_m)


class Farthest:
    """A high quantile of values that come in blocks: only as many of the largest are kept as it needs.

    Parameters
    ----------
    quantile : float
    most_values : int
        No more values than that will come.
    """

    def __init__(self, quantile: float, most_values: int) -> None:
        self.n_values = 0
        self._quantile = quantile
        self._needed = math.ceil((1.0 - quantile) * most_values) + 2
        self._kept: F32 = np.zeros(0, dtype=np.float32)
        self._least = np.float32(-np.inf)

    def add(self, block: F32, mask: B1) -> None:
        """Add the values of a block under a mask."""
        self.n_values += int(np.count_nonzero(mask))
        values, counts = np.ravel(block), np.ravel(mask)
        # In parts, so that after the first one few are left to be sorted.
        for start in range(0, values.size, _VALUES_AT_ONCE):
            part = values[start : start + _VALUES_AT_ONCE]
            is_far = counts[start : start + _VALUES_AT_ONCE] & (part >= self._least)
            self._kept = np.concatenate([self._kept, part[is_far]])
            if self._kept.size > self._needed:
                self._kept = np.partition(self._kept, -self._needed)[-self._needed :]
                self._least = self._kept[0]

    @property
    def value(self) -> float:
        """The quantile, between two values as numpy has it; NaN without values."""
        if self.n_values == 0:
            return math.nan
        at = self._quantile * (self.n_values - 1)
        left = math.floor(at)
        kept = np.sort(self._kept)
        before = self.n_values - kept.size
        low = float(kept[left - before])
        high = float(kept[min(left + 1 - before, kept.size - 1)])
        return low + (at - left) * (high - low)


def _weigh(
    infinite: float, no_return: float, farthest_m: float, reach_m: float, found: Contradiction | None
) -> tuple[Literal["free", "ignore"], str]:
    """Decide by the rules above; returns the policy and the evidence in words."""
    if no_return == 0.0:
        return "ignore", "none can be told from a measurement that failed"
    shares = "; not compared with other beams, which takes odometry and enough of them"
    if found is not None:
        shares = (
            f"{100 * found.of_no_returns:.0f} % of them would pass through what other beams hit "
            f"({100 * found.of_returns:.0f} % of the beams with a return seem to)"
        )
        if found.of_no_returns > max(_MOST_CONTRADICTED, _CONTRADICTED_EXCESS * found.of_returns):
            return "ignore", f"{shares}, so the laser failed to measure there rather than saw nothing"
        shares = f", and only {shares}"
    if infinite > 0.0:
        return "free", f"the recording has +inf for them, which says so (REP 117){shares}"
    if farthest_m >= _NEAR_REACH * reach_m:
        return "free", (
            f"real returns come from up to {farthest_m:.1f} m, close to {reach_m:.1f} m, from where on a number stands "
            f"for no return{shares}"
        )
    return "ignore", (
        f"real returns end at {farthest_m:.1f} m, far below {reach_m:.1f} m, from where on a number stands for no "
        "return, so something swallowed or dazzled these beams rather than let them through"
    )


def apply_no_return(ranges_m: F32, range_min_m: float, verdict: NoReturn) -> None:
    """Rewrite recorded ranges in place: returns stay, no returns become +inf or NaN, the rest NaN."""
    no_return = np.float32(np.inf if verdict.policy == "free" else np.nan)
    reach = np.float32(verdict.reach_m)
    for rows in blocks_of(ranges_m):
        block = ranges_m[rows]
        is_nothing = ~((block >= np.float32(range_min_m)) & (block > 0.0))
        is_beyond = block >= reach
        block[is_beyond] = no_return
        block[is_nothing] = np.nan
        give_back(ranges_m)
