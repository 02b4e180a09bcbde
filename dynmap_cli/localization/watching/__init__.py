"""Whether the filter is right: lost, changed surroundings, rooms that were never mapped."""
