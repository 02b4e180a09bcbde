"""Particles: how they move, are weighed and drawn again, and the states they carry."""
