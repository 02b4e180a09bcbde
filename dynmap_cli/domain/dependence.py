"""Whether two things that are now on, now off change together, by how often they were seen in each combination."""

from __future__ import annotations

import numpy as np

from dynmap_cli.arrays import B1, I64

LEAST_SEEN, LEAST_CHI2 = 6, 6.63
"""Chi-squared with one degree of freedom exceeds 6.63 by chance once in a hundred."""


def depend(on: I64, off: I64) -> B1:
    """(n, n) whether two things change together (chi-squared test of a table of two by two).

    Parameters
    ----------
    on, off : (m, n) int64
        1 where a look saw a thing so; neither = it did not see it.
    """
    both, neither, one, other = combinations(on, off)
    count = both + neither + one + other
    sides = (both + one) * (other + neither) * (both + other) * (one + neither)
    chi2 = count * (both * neither - one * other) ** 2.0 / np.maximum(sides, 1)
    return np.asarray((count >= LEAST_SEEN) & (sides > 0) & (chi2 >= LEAST_CHI2))


def are_free(on: I64, off: I64) -> B1:
    """(n, n) whether two things were seen in all four combinations, and do not `depend` on one another.

    That this cannot be shown is no sign of dependence: a handful of looks leaves most pairs open.
    """
    seen = np.minimum.reduce(combinations(on, off)) > 0
    return np.asarray(seen & ~depend(on, off))


def combinations(on: I64, off: I64) -> tuple[I64, I64, I64, I64]:
    """How often both of each two things (n, n) were on, neither was, only the one, and only the other."""
    return on.T @ on, off.T @ off, on.T @ off, off.T @ on
