"""Room 3: map -> submaps/ (areas that change)."""
