"""Worlds drawn from a seed: `expand` writes out the walls, doors, boxes, people and path of a scenario."""

from dynmap_cli.simulation.worlds.expand import expand

__all__ = ["expand"]
