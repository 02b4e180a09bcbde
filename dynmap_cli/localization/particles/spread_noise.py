"""Normal noise for particles that is spread evenly over them, instead of drawn for each on its own.

The mean of n independent draws is off by 1 / sqrt(n); points of a lattice, shifted at random as a whole, are nearer to
it. They stay even after the particles were moved if neighbours get points that follow one another: particles are taken
in their order along a curve that fills space (sequential quasi-Monte Carlo, Gerber and Chopin 2015; for Markov chains
array-RQMC, L'Ecuyer et al. 2008). Each particle by itself still gets normal noise that is independent of its pose.
"""

from __future__ import annotations

from functools import cache
from statistics import NormalDist

import numpy as np

from dynmap_cli.arrays import F64, U16
from dynmap_cli.kernels.particles import places_on_curve, spread_normals

_CURVE_BITS = 5
_QUANTILES = 4096
_DIMENSIONS = 4


def spread_noise(poses: F64, random: np.random.Generator) -> F64:
    """(4, n) standard normal noise for particles at poses (n, 3)."""
    n = poses.shape[0]
    places, noise = np.empty(n, dtype=np.uint16), np.empty((_DIMENSIONS, n))
    places_on_curve(poses, hilbert_curve(), places)
    order = np.argsort(places, kind="stable")
    spread_normals(order, lattice_steps(), random.random(_DIMENSIONS), normal_quantiles(), noise)
    return noise


@cache
def lattice_steps() -> F64:
    """(4,) steps from one point of the lattice to the next: 1/g, 1/g^2, ... with g^5 = g + 1 (Roberts 2018)."""
    g = 1.0
    for _ in range(60):
        g = (1.0 + g) ** (1.0 / (_DIMENSIONS + 1))
    return np.asarray(g ** -np.arange(1.0, _DIMENSIONS + 1.0))


@cache
def normal_quantiles() -> F64:
    """(4096,) quantiles of the standard normal distribution, in the middle of equal parts."""
    normal = NormalDist()
    return np.array([normal.inv_cdf((k + 0.5) / _QUANTILES) for k in range(_QUANTILES)])


@cache
def hilbert_curve() -> U16:
    """(32, 32, 32) number of each cell along the Hilbert curve (Skilling 2004)."""
    size = 2**_CURVE_BITS
    axes = [axis.ravel() for axis in np.meshgrid(*3 * [np.arange(size)], indexing="ij")]
    for level in range(_CURVE_BITS - 1, 0, -1):
        bit, below = 1 << level, (1 << level) - 1
        for k in range(3):
            is_set = (axes[k] & bit) > 0
            swapped = np.where(is_set, 0, (axes[0] ^ axes[k]) & below)
            axes[k] = axes[k] ^ swapped
            axes[0] = axes[0] ^ np.where(is_set, below, swapped if k else 0)
    axes[1] = axes[1] ^ axes[0]
    axes[2] = axes[2] ^ axes[1]
    turned = np.zeros_like(axes[0])
    for level in range(_CURVE_BITS - 1, 0, -1):
        turned ^= np.where((axes[2] & (1 << level)) > 0, (1 << level) - 1, 0)
    number = np.zeros_like(turned)
    for level in range(_CURVE_BITS - 1, -1, -1):
        for axis in axes:
            number = number << 1 | ((axis ^ turned) >> level & 1)
    return number.astype(np.uint16).reshape(size, size, size)
