"""Points of the map as people write them."""

from __future__ import annotations


def point_for_people(x_m: float, y_m: float) -> str:
    """A point to a decimetre."""
    return f"({x_m:.1f}, {y_m:.1f})"
