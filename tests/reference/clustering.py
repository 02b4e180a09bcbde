"""Slow twins of the clustering arithmetic, as printed."""

import math

import numpy as np


def plain_distance(a, b, epsilon):
    """Eq. 1.18 with squares, cell by cell; NaN is xi."""
    total = 0.0
    for x, y in zip(a, b, strict=True):
        if not math.isnan(x) and not math.isnan(y):
            total += (x - y) ** 2
        elif math.isnan(x) != math.isnan(y):
            total += epsilon
    return total


def plain_fuzzy_kmeans(vectors, centers, fuzzifier=2.0, rounds=300):
    """The textbook algorithm on fully known vectors, one number at a time."""
    centers = [list(center) for center in centers]
    for _ in range(rounds):
        memberships = []
        for vector in vectors:
            distances = [max(plain_distance(vector, center, 0.0), 1e-12) for center in centers]
            memberships.append(
                [
                    1.0 / sum((d / other) ** (1.0 / (fuzzifier - 1.0)) for other in distances)
                    for d in distances
                ]
            )
        for j in range(len(centers)):
            weights = [row[j] ** fuzzifier for row in memberships]
            centers[j] = [
                sum(w * vector[i] for w, vector in zip(weights, vectors, strict=True)) / sum(weights)
                for i in range(len(vectors[0]))
            ]
    return np.array(centers), np.array(memberships)


def plain_rand_index(one, other):
    """Adjusted Rand index by counting pairs."""
    pairs = [(i, j) for i in range(len(one)) for j in range(i)]
    same_one = [one[i] == one[j] for i, j in pairs]
    same_other = [other[i] == other[j] for i, j in pairs]
    both = sum(a and b for a, b in zip(same_one, same_other, strict=True))
    expected = sum(same_one) * sum(same_other) / len(pairs)
    most = 0.5 * (sum(same_one) + sum(same_other))
    return 1.0 if most == expected else (both - expected) / (most - expected)
