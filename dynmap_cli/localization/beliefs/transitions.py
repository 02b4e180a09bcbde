"""The map transition model p(m_t | x_t, m_{t-1}) of Eq. 1.24: how long the states of sub-maps last."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from dynmap_cli.arrays import F64, I32
from dynmap_cli.localization.sensing.map_pool import SubMapStates

UNKNOWN_STATE_LASTS_S = 300.0
"""Mean time between changes where nothing is known."""
LONGEST_STATE_LASTS_S = 1.0e5
"""No state is believed to last for ever, however rarely it was seen to change."""


def change_rate(stay_probability: float, n_states: int) -> float:
    """Changes per second that make the state the same one minute later with this probability.

    Changes lead to all other states alike, so the probability tends to 1 / n: a *stay_probability* at or
    below that says no more than that changes are fast, one that is not a number says nothing.
    """
    if n_states < 2:
        return 0.0
    if not 0.0 < stay_probability <= 1.0:
        return 1.0 / UNKNOWN_STATE_LASTS_S
    above_chance = max((stay_probability - 1.0 / n_states) / (1.0 - 1.0 / n_states), 1e-3)
    rate = -math.log(above_chance) / 60.0 * (n_states - 1) / n_states
    return max(rate, 1.0 / LONGEST_STATE_LASTS_S)


def kept_probability(submap: SubMapStates, seconds: float) -> float:
    """Probability that the state of a sub-map was not drawn anew within some seconds."""
    n_states = submap.n_states
    if n_states < 2:
        return 1.0
    rate = change_rate(submap.stay_probability, n_states)
    return math.exp(-rate * seconds * n_states / (n_states - 1))


def predict_belief(belief: F64, submap: SubMapStates, seconds: float) -> F64:
    """Belief over the states (..., n) of a sub-map some seconds later: kept, or drawn anew."""
    kept = kept_probability(submap, seconds)
    return np.asarray(kept * belief + (1.0 - kept) * submap.drawn)


def look_back(ratio: F64, submap: SubMapStates, seconds: float) -> F64:
    """Sum over the states j some seconds later of P(i -> j) ratio_j, for each state i (n,)."""
    kept = kept_probability(submap, seconds)
    return np.asarray(kept * ratio + (1.0 - kept) * float(submap.drawn @ ratio))


def state_priors(
    was_in: I32,
    states: I32,
    now_in: I32,
    submaps: tuple[SubMapStates, ...],
    seconds: float,
    entering: Callable[[int], F64],
) -> F64:
    """p(m_t | x_t, m_{t-1}) of the current sub-map of each particle (paper, 1.4).

    A particle that stays in its sub-map keeps the state or has one drawn anew; one that comes into a sub-map has what
    is believed of it (the paper: all states alike).

    Parameters
    ----------
    was_in, now_in : (n,) int32
        Index of each particle's sub-map before and after the motion, -1 = none.
    states : (n,) int32
        Index of each particle's state before, -1 = none.
    submaps : tuple of SubMapStates
    seconds : float
    entering : function of the index of a sub-map
        Belief (n_states,) on coming into it.

    Returns
    -------
    (n, most states) float64
        Rows sum to 1; a particle in no sub-map has one state, 0.
    """
    most = max((submap.n_states for submap in submaps), default=1)
    priors = np.zeros((now_in.size, most))
    priors[now_in < 0, 0] = 1.0
    for number in np.unique(now_in[now_in >= 0]).tolist():
        submap = submaps[number]
        n_states, here = submap.n_states, now_in == number
        priors[here, :n_states] = entering(number)
        stays = here & (was_in == number)
        kept = np.eye(n_states)[states[stays]]
        priors[stays, :n_states] = predict_belief(kept, submap, seconds)
    return priors


def nearest_submaps(points_m: F64, submaps: tuple[SubMapStates, ...], within_m: float) -> I32:
    """Index of the sub-map whose rectangle is nearest to each point (n, 2); -1 where none is within reach.

    The rectangle of a door is hardly ever entered, so being near it counts as being in it.
    """
    best = np.full(points_m.shape[0], -1, dtype=np.int32)
    nearest = np.full(points_m.shape[0], np.inf)
    if points_m.shape[0] == 0:
        return best
    low, high = points_m.min(axis=0) - within_m, points_m.max(axis=0) + within_m
    for number, submap in enumerate(submaps):
        x0, y0, x1, y1 = submap.rectangle_m
        if x1 < low[0] or x0 > high[0] or y1 < low[1] or y0 > high[1]:
            continue
        dx = np.maximum(np.maximum(x0 - points_m[:, 0], points_m[:, 0] - x1), 0.0)
        dy = np.maximum(np.maximum(y0 - points_m[:, 1], points_m[:, 1] - y1), 0.0)
        distance = np.hypot(dx, dy)
        closer = (distance <= within_m) & (distance < nearest)
        best[closer] = number
        nearest[closer] = distance[closer]
    return best
