"""What a scan says about the states of sub-maps, and the belief in them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import B1, F64
from dynmap_cli.kernels.sweeps import place_beams, weigh_states
from dynmap_cli.localization.sensing.map_pool import MapPool, SubMapStates
from dynmap_cli.localization.sensing.sensor import Sweep, best_log_likelihood, least_log_likelihood
from dynmap_cli.localization.settings import LocalizationSettings

LEAST_SINE = math.sin(math.radians(20.0))
"""A beam that meets a surface at less than 20 degrees slides along it and proves nothing."""
BEYOND_M = 0.3
"""A beam passed through a surface if it ends at least this far behind it."""
TELLS_APART = math.log(2.0)
"""A beam tells states apart that is twice as likely in one as in another."""
LEAST_BEAMS = 3
"""A sub-map is in view of a scan with so many beams that tell its states apart."""


@dataclass(frozen=True, slots=True)
class StateEvidence:
    """What one scan from one pose says about the states of one sub-map.

    Attributes
    ----------
    at_ends : (n_states,) float64
        Log-likelihood of the ends inside the rectangle.
    through : (n_states,) float64
        What has to be added because beams went through what is solid in a state.
    n_beams : int
        Beams that tell the states apart.
    objects_in_view : (n_objects,) bool
        Of which so many beams as `LEAST_BEAMS` tell on from off.
    """

    at_ends: F64
    through: F64
    n_beams: int
    objects_in_view: B1

    @property
    def log_likelihoods(self) -> F64:
        """(n_states,) ends and crossings together."""
        return np.asarray(self.at_ends + self.through)


@dataclass(frozen=True, slots=True)
class PlacedSweep:
    """The beams of a scan in the map frame.

    Attributes
    ----------
    sensor_m : (2,) float64
    directions_rad : (n,) float64
    lengths_m : (n,) float64
        How far each beam is known to have gone: to its end, or to the sensor's reach.
    ends_m : (n, 2) float64
        Ends; where nothing was hit, the end of the known length.
    hits : (n,) bool
        Whether something was hit.
    """

    sensor_m: F64
    directions_rad: F64
    lengths_m: F64
    ends_m: F64
    hits: B1


def place_sweep(sweep: Sweep, pose: F64) -> PlacedSweep:
    """Put the beams of a scan where the robot is."""
    hits = np.isfinite(sweep.ranges_m)
    lengths = np.where(hits, sweep.ranges_m, sweep.reach_m)
    sensor = np.empty(3)
    sensor[:2], sensor[2] = transform_point(pose, sweep.sensor), pose[2]
    directions, ends = np.empty(lengths.size), np.empty((lengths.size, 2))
    place_beams(sweep.directions_rad, lengths, sensor, directions, ends)
    return PlacedSweep(sensor[:2], directions, lengths, ends, hits)


def transform_point(pose: F64, point: F64) -> F64:
    """One point (2,) of the robot frame in the map frame, as `transform_points` for many."""
    (x, y, yaw), (ahead, left) = pose.tolist(), point.tolist()
    cos, sin = math.cos(yaw), math.sin(yaw)
    return np.array([x + cos * ahead - sin * left, y + sin * ahead + cos * left])


def state_evidence(
    placed: PlacedSweep, pool: MapPool, submap: SubMapStates, settings: LocalizationSettings
) -> StateEvidence:
    """Compare the states of a sub-map under one scan.

    A likelihood field alone cannot see that a door opened, because nothing explains a scan better than
    an empty patch does. So a beam that went through something solid, of which a share p of the beams passed when the
    state was mapped, has the likelihood p L + (1 - p) L_far: L of its end (inside), or of an end on the map (behind
    the rectangle), and L_far of one far from everything.
    """
    at_ends, through = np.empty((2, submap.n_states))
    told = np.zeros(submap.n_objects, dtype=np.int64)
    n_beams = weigh_states(
        submap.surfaces,
        submap.passes,
        submap.owned,
        pool.pool,
        submap.field_start,
        submap.frame.corner,
        placed.sensor_m,
        placed.directions_rad,
        placed.lengths_m,
        placed.ends_m,
        placed.hits,
        np.array([best_log_likelihood(settings), least_log_likelihood(settings)]),
        np.array([LEAST_SINE, BEYOND_M, settings.view_m, TELLS_APART]),
        submap.switches,
        at_ends,
        through,
        told,
    )
    return StateEvidence(at_ends, through, n_beams, told >= LEAST_BEAMS)


def update_belief(belief: F64, log_likelihoods: F64) -> F64:
    """Bayes: belief (n_states,) times likelihoods given as logarithms, normalized."""
    with np.errstate(divide="ignore"):
        logs = np.log(belief) + log_likelihoods
    weights = np.exp(logs - logs.max())
    return np.asarray(weights / weights.sum())


def entropy_bits(belief: F64) -> float:
    """Uncertainty of a belief, bits."""
    known = belief[belief > 0.0]
    return float(-(known * np.log2(known)).sum()) + 0.0
