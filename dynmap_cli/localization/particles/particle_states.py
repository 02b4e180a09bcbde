"""A state in every particle (paper, 1.4), drawn by transition and scan together."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from dynmap_cli.arrays import F64, I32
from dynmap_cli.localization.beliefs.transitions import nearest_submaps, state_priors
from dynmap_cli.localization.particles.particle_filter import Particles, reweigh
from dynmap_cli.localization.sensing.map_pool import MapPool
from dynmap_cli.localization.sensing.weighing import Weighing


@dataclass(frozen=True, slots=True)
class CarriedStates:
    """Particles at their new poses, and what transition and scan say about the state of each.

    p(s | s', z) is proportional to p(s | s') p(z | s), and a particle's weight is multiplied by the sum over s:
    Eq. 1.24 with the optimal proposal (Doucet et al. 2000). Were states drawn from p(s | s') alone, no particle of
    a few hundred would leave a state that lasts for minutes, and a door that opens would not be noticed.

    Attributes
    ----------
    particles : Particles
        In their new sub-maps, with the weights and states of before.
    priors : (n, most states) float64
        p(s | s') of each particle; a particle in no sub-map has one state, 0.
    log_likelihoods : (n, most states) float64
        Of the scan, tempered; -inf where a sub-map has no such state.
    """

    particles: Particles
    priors: F64
    log_likelihoods: F64

    def weighed(self) -> Particles:
        """The particles weighed by the scan, whatever their states."""
        highest, joint = self._joint()
        return reweigh(self.particles, highest + np.log(joint.sum(axis=1)))

    def with_evidence(self, number: int, log_likelihoods: F64) -> CarriedStates:
        """Add what else is known about the states (n_states,) of one sub-map."""
        here, more = self.particles.submaps == number, self.log_likelihoods.copy()
        more[np.ix_(here, np.arange(log_likelihoods.size))] += log_likelihoods
        return replace(self, log_likelihoods=more)

    def belief(self, number: int, n_states: int) -> F64 | None:
        """Belief (n_states,) of the particles in one sub-map; None with less than half of the weight in it."""
        weights, (_, joint) = self.weighed().weights, self._joint()
        here = self.particles.submaps == number
        if float(weights[here].sum()) < 0.5:
            return None
        shares = weights[here] @ (joint[here] / joint[here].sum(axis=1, keepdims=True))
        return np.asarray(shares[:n_states] / shares.sum())

    def drawn(self, random: np.random.Generator) -> Particles:
        """The particles weighed by the scan, each with a state drawn under it."""
        _, joint = self._joint()
        sums = np.cumsum(joint, axis=1)
        states = (sums <= (random.random(self.particles.count) * sums[:, -1])[:, None]).sum(axis=1)
        in_none = self.particles.submaps < 0
        return replace(self.weighed(), states=np.where(in_none, -1, states).astype(np.int32))

    def _joint(self) -> tuple[F64, F64]:
        """Highest log-likelihood (n,) of each particle's possible states, and p(s, z | s') divided by it."""
        highest = np.where(self.priors > 0.0, self.log_likelihoods, -np.inf).max(axis=1)
        gains = np.exp(np.minimum(self.log_likelihoods - highest[:, None], 0.0))
        return highest, np.asarray(self.priors * gains)


def carry_states(
    particles: Particles,
    weighing: Weighing,
    *,
    seconds: float,
    within_m: float,
    entering: Callable[[int], F64],
    executor: ThreadPoolExecutor,
) -> CarriedStates:
    """Weigh a scan from every pose, in all states of the sub-map each particle is in.

    Parameters
    ----------
    particles : Particles
        At their new poses, in the sub-maps and states of before.
    weighing : Weighing
        The scan.
    seconds : float
        Since the last update.
    within_m : float
        Being this close to the rectangle of a sub-map is being in it.
    entering : function of the index of a sub-map
        What is believed of its states (n_states,) by a particle that comes into it.
    executor : ThreadPoolExecutor
    """
    pool = weighing.pool
    submaps = nearest_submaps(particles.poses[:, :2], pool.submaps, within_m)
    priors = state_priors(particles.submaps, particles.states, submaps, pool.submaps, seconds, entering)
    windows, fields = _window_table(pool), np.full(priors.shape, -np.inf)
    n_states = np.array([*(submap.n_states for submap in pool.submaps), 1])[submaps]
    for state in range(int(n_states.max())):
        here = np.flatnonzero(n_states > state)
        chosen = np.ascontiguousarray(windows[submaps[here], state])
        fields[here, state] = weighing.log_likelihoods(particles.poses[here], chosen, executor)
    return CarriedStates(
        replace(particles, submaps=submaps), priors, weighing.tempered(fields, particles.weights)
    )


def _window_table(pool: MapPool) -> I32:
    """(n_submaps + 1, most states, 5): the window of each state; sub-map -1 = none."""
    most = max((submap.n_states for submap in pool.submaps), default=1)
    table = np.zeros((len(pool.submaps) + 1, most, 5), dtype=np.int32)
    for number, submap in enumerate(pool.submaps):
        table[number, : submap.n_states] = submap.windows()
    return table
