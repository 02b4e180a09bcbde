"""What is believed of the state of a sub-map before anybody looked."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynmap_cli.arrays import F64
from dynmap_cli.domain.patches import Patch
from dynmap_cli.domain.times import DAY_HOURS, hours_of

_LEAST_SHARE = 1e-3
"""No state is impossible at any hour."""


def prior_by_hour(patches: Sequence[Patch], kind: str) -> F64:
    """Prior belief (25, n_states) in each hour of the day (UTC), and last where the clock does not know it.

    Parameters
    ----------
    patches : sequence of Patch
        Of one sub-map.
    kind : str
        "uniform"; "support" = by the visits that saw each state, each counted once more; "hour" = by the hour, and by
        support where the visits were too few to tell.
    """
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
