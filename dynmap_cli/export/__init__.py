"""Side room: recordings written again without the beams that hit something that moves."""
