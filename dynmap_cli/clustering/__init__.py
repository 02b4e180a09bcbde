"""Room 4: scans and sub-maps -> patches/ (the states each area takes)."""
