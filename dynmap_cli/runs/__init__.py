"""A run directory as a whole: its stages run in order, what in it is out of date, and what a finished run is used for.

`floor_plan` has the stages, `pipeline` runs, skips and publishes them by `reruns` and `consistency`; `update` and
`edit` change a run, `finished` uses it, `outdated` says what was made with maps that it has no more.
"""
