"""Where on the map a recording begins, when nobody said."""
