"""Why a recording is refused, in one line: it holds no laser, or it is damaged and only whole ones are wanted."""

from __future__ import annotations

from collections.abc import Sequence

from dynmap_cli.errors import LogError
from dynmap_cli.ingest.messages.kinds import LASER_TYPES
from dynmap_cli.ingest.messages.stored import ORPHAN, words_of
from dynmap_cli.ingest.raw.recording import RawRecording, file_name

_WANTED = {
    "CARMEN text": "FLASER, RLASER, ROBOTLASER or RAWLASER lines",
    "Wean Hall text": "L lines of 180 readings",
}
"""What text logs hold sweeps in."""
_REPAIRS = {
    "ROS 1 bag": ", or repair it first (`rosbag reindex`)",
    "MCAP file": ", or repair it first (`mcap recover`)",
    "ROS 2 bag (.db3)": ", or repair it first (`.recover` of sqlite3)",
    "ROS 2 bag": ", or repair its files first (`.recover` of sqlite3, `mcap recover`)",
}
"""What may help where nothing can be read, by format."""


def require_lasers(recordings: Sequence[RawRecording]) -> None:
    """Refuse recordings without a laser, or without any sweep that can be used."""
    for recording in recordings:
        if recording.lasers:
            continue
        if recording.dropped and LASER_TYPES & {topic.kind for topic in recording.topics}:
            what = f"none of the laser scans in this {recording.kind} can be used"
            then = "Check the driver of the laser"
        else:
            found = ", ".join(
                f"{topic.name} ({topic.kind or 'type not known'})" for topic in recording.topics[:30]
            ) or ("no topic" if ORPHAN in recording.dropped else "nothing")
            what = f"no laser scans in this {recording.kind}; it holds {found}"
            then = f"Record {_WANTED.get(recording.kind, 'sensor_msgs/LaserScan or PointCloud2')}"
        msg = f"{recording.name}: {what}{losses_of(recording)}. {then}, or pass another recording."
        raise LogError(msg)


def damage_refused(recording: RawRecording) -> LogError:
    """One line for a damaged recording that is not to be read in part."""
    head = f"{recording.name}: this {recording.kind} is "
    short = f"{file_name(recording.name)}: this {recording.kind} is "
    told = [line.removeprefix(short) for line in recording.warnings]
    told.sort(key=lambda line: not line.startswith("cut off or damaged"))
    left = [
        why
        for why in recording.damage[:3]
        if why not in recording.dropped and not any(why in line for line in told)
    ]
    dropped = [f"{count} x {reason}" for reason, count in recording.dropped.items()]
    damage = [] if told and told[0].startswith("cut off or damaged") else ["damaged"]
    if left:
        damage = [f"damaged ({'; '.join(left)})"]
    return LogError(
        f"{head}{'; '.join([*damage, *told, *dropped])}. "
        "Copy it again from the robot, or leave out --strict (ingest.strict: false) to use what is whole."
    )


def damaged(name: str, kind: str, err: Exception) -> LogError:
    """One line for what a reading library could not digest."""
    return LogError(
        f"{name}: this {kind} is cut off or damaged ({words_of(err)}). Copy it again from the robot"
        f"{_REPAIRS.get(kind, '')}."
    )


def losses_of(recording: RawRecording) -> str:
    """What was left out of a recording that is refused, to be put at the end of a clause."""
    dropped = [f"{count} x {reason}" for reason, count in recording.dropped.items()]
    return "".join(f"; {found}" for found in (*dropped, *recording.warnings))
