"""dynmap: maps of places that change, from recorded robot logs.

The rooms, in the order in which data flows: `cli` and `commands` turn words into calls, `pipeline` runs
the stages of the `floor_plan` and `finished` what is read from a finished run, both after `consistency`
has looked whether what is there belongs together; then `ingest` (recordings -> scans), `mapping` (scans
-> filtered map and trajectory), `segmentation` (map -> sub-maps), `clustering` (sub-maps -> patches) and
`localization`. They share `counting` (the counting map and the EM filter), `kernels` (compiled
arithmetic), `files` (what lies on disk between rooms) and `domain` (what is carried). `simulation`,
`evaluation`, `comparison` (one recording in several maps of a run), `report`, `export` (recordings
without what moves, for `clean`), `planner` (maps in a chosen state, for `export`) and `history` (for
`timeline` and `explain`) are side rooms.
"""

__version__ = "0.1.0"
