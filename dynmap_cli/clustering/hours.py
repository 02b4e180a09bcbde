"""Which state an area has at which hour of the day: learned from visits on enough days."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dynmap_cli.domain.patches import Patch, Visit
from dynmap_cli.domain.times import DAY_HOURS, day_of, hours_of

_LEAST_VISITS, _LEAST_DAYS = 30, 5
_SPREAD_HOURS, _PRIOR_VISITS = 1.0, 2.0


def with_shares_by_hour(patches: Sequence[Patch], visits: Sequence[Visit]) -> tuple[Patch, ...]:
    r"""Give each patch its share of the visits by hour of the day, where there are enough visits.

    For the middle t of each hour, with the visits weighted by their distance in time of day around the clock,

    .. math::
        P(k \mid t) = \frac{\sum_v w_v(t) [k_v = k] + 2 s_k}{\sum_v w_v(t) + 2}, \qquad
        w_v(t) = e^{-(t - t_v)^2 / 2}

    in hours, where s_k is the share of all visits, each state counted once more. At least 30 visits with a patch on 5
    days (UTC) are needed; with fewer, or clocks that never knew the date, nothing is said.

    Parameters
    ----------
    patches : sequence of Patch
        Of one sub-map.
    visits : sequence of Visit
        Of that sub-map.
    """
    numbers = [patch.patch_id for patch in patches]
    known = [visit for visit in visits if visit.patch in numbers]
    middle_ns = [(visit.start_ns + visit.end_ns) // 2 for visit in known]
    at = [hours_of(stamp_ns) for stamp_ns in middle_ns]
    days = {day_of(stamp_ns) for stamp_ns in middle_ns}
    if None in at or len(known) < _LEAST_VISITS or len(days) < _LEAST_DAYS:
        return tuple(replace(patch, share_by_hour=()) for patch in patches)
    is_in = np.array([[visit.patch == number for number in numbers] for visit in known], dtype=np.float64)
    overall = (is_in.sum(axis=0) + 1.0) / (len(known) + len(numbers))
    apart = np.abs(np.arange(DAY_HOURS)[:, None] + 0.5 - np.array(at, dtype=np.float64)[None, :])
    weights = np.exp(-0.5 * (np.minimum(apart, DAY_HOURS - apart) / _SPREAD_HOURS) ** 2)
    shares = (weights @ is_in + _PRIOR_VISITS * overall) / (
        weights.sum(axis=1, keepdims=True) + _PRIOR_VISITS
    )
    return tuple(
        replace(patch, share_by_hour=tuple(round(float(share), 6) for share in column))
        for patch, column in zip(patches, shares.T, strict=True)
    )
