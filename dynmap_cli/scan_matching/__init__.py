"""Matching of scans against the scans before them: for the path of a map, and outside of one."""
