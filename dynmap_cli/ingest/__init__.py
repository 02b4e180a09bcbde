"""Room 1: recordings -> scans/.

`containers` and `text` open what was recorded, `messages` takes it apart into `raw` recordings, `seen_motion` measures
what their sweeps show, `choices` decides which lasers, odometry, frames and times are used, and `reading` has the order
of this work.
"""
