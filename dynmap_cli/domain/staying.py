"""How long a state lasts: learned from what successive visits saw."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from dynmap_cli.domain.patches import Visit

_PRIOR_SECONDS, _PRIOR_SPREAD = 300.0, 1.5
_MINUTE_S = 60.0


def stay_probability(visits: Sequence[Visit], n_states: int) -> float:
    r"""Probability that the state is the same one minute later.

    At rate r the state is drawn anew, so that over dt seconds

    .. math::
        P(\text{same}) = \frac{1}{k} + \left(1 - \frac{1}{k}\right) e^{-r\,dt}

    The rate has a log-normal prior around one change in 300 s, wide by a factor of e^1.5; the result is the
    posterior mean over a grid of rates.

    Parameters
    ----------
    visits : sequence of Visit
        Of one sub-map; those without a patch are passed over.
    n_states : int
        Number k of patches.
    """
    if n_states < 2:
        return 1.0
    known = sorted((visit for visit in visits if visit.patch is not None), key=lambda visit: visit.start_ns)
    log_rates = math.log(1.0 / _PRIOR_SECONDS) + np.linspace(-6.0, 4.0, 201)
    rates = np.exp(log_rates)
    score = -0.5 * ((log_rates + math.log(_PRIOR_SECONDS)) / _PRIOR_SPREAD) ** 2
    for before, after in pairwise(known):
        seconds = 0.5e-9 * (after.start_ns + after.end_ns - before.start_ns - before.end_ns)
        same = 1.0 / n_states + (1.0 - 1.0 / n_states) * np.exp(-rates * max(seconds, 0.0))
        score += np.log(same if before.patch == after.patch else np.maximum(1.0 - same, 1e-12))
    weights = np.exp(score - score.max())
    minute = 1.0 / n_states + (1.0 - 1.0 / n_states) * np.exp(-rates * _MINUTE_S)
    return round(float((weights * minute).sum() / weights.sum()), 6)
