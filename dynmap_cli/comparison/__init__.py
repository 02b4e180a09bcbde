"""Side room: one recording localized in the patch map of a run, and in maps without it (paper, Fig. 1.13 and 1.15)."""
