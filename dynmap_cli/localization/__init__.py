"""Room 5: patch map and another recording -> pose and state of the world over time.

`odometry` is how the robot moved, `sensing` what a scan says of a pose, `particles` the filter, `beliefs` the states of
sub-maps, `starting` the search for a start, `watching` whether all that is right, `afterwards` smoothing; `tracking` is
the loop over scans.
"""
