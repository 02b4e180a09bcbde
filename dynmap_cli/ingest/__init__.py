"""Room 1: recordings -> scans/."""
