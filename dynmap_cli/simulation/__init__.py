"""Side room: recordings with known truth."""
