"""Room 5: patch map and another recording -> pose and state of the world over time."""
