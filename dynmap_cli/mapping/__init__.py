"""Room 2: scans -> map/ (poses, static probability of each beam, counting map)."""
