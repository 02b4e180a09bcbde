"""The counting map and the EM filter (Eq. 1.1-1.15), once for all rooms."""
