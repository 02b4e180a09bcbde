"""What is believed of the state of a sub-map before anybody looked."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynmap_cli.arrays import F64, I64
from dynmap_cli.domain.patches import Patch
from dynmap_cli.domain.times import DAY_HOURS, hours_of

_LEAST_SHARE = 1e-3
"""No state is impossible at any hour."""


def never_seen_share(support: I64) -> float:
    """Probability that a visit sees a state that no visit saw before, from how many saw each of the others.

    As often as it was the case that one visit alone saw a state (Good 1953), with one such visit and two visits more.
    """
    seen = support[support > 0]
    return float(((seen == 1).sum() + 1.0) / (seen.sum() + 2.0))


def prior_by_hour(patches: Sequence[Patch], kind: str) -> F64:
    """Prior belief (25, n_states) in each hour of the day (UTC), and last where the clock does not know it.

    Parameters
    ----------
    patches : sequence of Patch
        Of one sub-map.
    kind : str
        "uniform"; "support" = by the visits that saw each state, each counted once more; "hour" = by the hour, and by
        support where the visits were too few to tell. States without support share what `never_seen_share` leaves them.
    """
    support = np.array([patch.support for patch in patches])
    never = (support == 0) & bool((support > 0).any())
    known = [patch for patch, is_never in zip(patches, never.tolist(), strict=True) if not is_never]
    shares = np.empty((DAY_HOURS + 1, len(patches)))
    shares[:, ~never] = _of_known(known, kind)
    if never.any():
        share = never_seen_share(support)
        shares[:, ~never] *= 1.0 - share
        shares[:, never] = share / never.sum()
    return shares


def _of_known(patches: Sequence[Patch], kind: str) -> F64:
    """Prior belief (25, n_states) in states that were seen."""
    if kind == "uniform":
        return np.full((DAY_HOURS + 1, len(patches)), 1.0 / len(patches))
    if kind == "hour" and all(patch.share_by_hour for patch in patches):
        by_hour = np.array([patch.share_by_hour for patch in patches]).T + _LEAST_SHARE
        shares = np.vstack([by_hour, by_hour.mean(axis=0)])
    else:
        shares = np.tile([patch.support + 1.0 for patch in patches], (DAY_HOURS + 1, 1))
    return np.asarray(shares / shares.sum(axis=1, keepdims=True))


def prior_at(prior: F64, stamp_ns: int) -> F64:
    """Prior belief (n_states,) at some time, of one of `prior_by_hour`."""
    hours = hours_of(stamp_ns)
    return np.asarray(prior[-1 if hours is None else int(hours)])
