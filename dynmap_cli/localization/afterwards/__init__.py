"""Poses and states once the whole recording is known."""
