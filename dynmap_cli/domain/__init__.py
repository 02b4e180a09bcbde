"""What is carried between rooms: scans, poses, grids, sub-maps, patches."""
