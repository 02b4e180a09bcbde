"""One short file per verb: words into calls."""
