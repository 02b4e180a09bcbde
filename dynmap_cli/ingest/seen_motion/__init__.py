"""How a laser moved by its sweeps alone: what odometry, clocks and mountings are held against before any is believed.

Nothing is decided here; each measure says how well something goes with the sweeps, and `choices` asks one of them.

- `turns`: by how much the laser turned between two sweeps. Coarse, but needs nothing else. `agreement` compares it
  with an odometry. It decides which way up a laser hangs (`reading`), whether stamps or times of recording are right
  (`choices.clock_offsets`, `choices.clock_evidence`), which of two tracks is that of the robot (`choices.two_robots`),
  and which odometry is doubted (`choices.odometry`).
- `laid_sweeps`: how well a motion lays the later sweep on the earlier one. It is asked where turns may be seen wrongly:
  it decides whether an odometry that is doubted is used all the same (`speak_for`), and, between two motions, whether
  the sweeps really tell them apart (`share_nearer`, for `choices.odometry_axes`).
- `range_flow`: where to, and how far, the laser moved in a short step. It decides whether the positions of an odometry
  go where its headings say, and what mends them (`choices.odometry_axes`).
"""
