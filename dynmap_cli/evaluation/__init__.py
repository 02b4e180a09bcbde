"""Side room: how good a result is, against truth or without."""
