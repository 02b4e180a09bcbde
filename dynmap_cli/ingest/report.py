"""What was found in recordings and what was made of it, for people and for programs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from dynmap_cli.ingest.choices.timing import Timing
from dynmap_cli.ingest.choices.track_quality import TrackQuality
from dynmap_cli.ingest.raw.recording import Topic

_MUCH = 0.05
"""Share of the scans from which on what is left out for one reason is a warning."""


@dataclass(frozen=True, slots=True)
class RecordingReport:
    """One recording.

    Attributes
    ----------
    name, kind : str
        File or folder name, and format.
    messages_read : int
        Messages or lines that were read and understood.
    topics : tuple of Topic
    """

    name: str
    kind: str
    messages_read: int
    topics: tuple[Topic, ...]


@dataclass(frozen=True, slots=True)
class LaserReport:
    """One laser, used or not.

    Attributes
    ----------
    name, frame : str
    used : bool
    why : str
    scans : int
        Recorded sweeps.
    beams : tuple of (int, int)
        Fewest and most beams of a sweep.
    field_of_view_deg, rate_hz : float
    reach_m : float or None
        What the recording states; None where it does not.
    pose : tuple of float or None
        x m, y m, yaw rad on the robot, as it is taken to be; None where it is not known and the laser not used.
    is_pose_known : bool
        Set, or found in the recording.
    upside_down : bool
    no_return, no_return_why : str
        What beams without return say; "" where the laser is not used.
    share_no_return, share_no_measurement : float
        Of all its beams.
    timing : Timing
    masked : str
        Which beams are left out as set, or because they see the robot itself; "" = none.
    """

    name: str
    frame: str
    used: bool
    why: str
    scans: int
    beams: tuple[int, int]
    field_of_view_deg: float
    rate_hz: float
    reach_m: float | None
    pose: tuple[float, float, float] | None
    is_pose_known: bool
    upside_down: bool
    timing: Timing
    no_return: str = ""
    no_return_why: str = ""
    share_no_return: float = 0.0
    share_no_measurement: float = 0.0
    masked: str = ""

    @property
    def no_return_line(self) -> str:
        """What beams without return mean, and why."""
        means = "count as free space" if self.no_return == "free" else "are left out"
        return f"beams without a return ({100 * self.share_no_return:.1f} % of all) {means}: {self.no_return_why}"


@dataclass(frozen=True, slots=True)
class IngestReport:
    """What `read_recordings` found and decided.

    Attributes
    ----------
    recordings : tuple of RecordingReport
    lasers : tuple of LaserReport
    scans : int
        Sweeps that were accepted.
    geometries : int
        Rows of the geometry table.
    span_s : float
    out_of_order : int
        Sweeps that were stamped before their predecessor; they were sorted.
    base_frame : str
        "" where the recording has no frames.
    frames : tuple of str
    odometry, odometry_why : str
    odometry_rejected : tuple of str
    odometry_path_m : float
    odometry_longest_gap_s, odometry_rate_hz : float
        Of the source itself.
    odometry_quality : TrackQuality or None
        None where no two scans have a pose, and of several drives.
    scans_without_odometry : int
    dropped : mapping of str to int
        Messages, lines or sweeps left out, by reason.
    warnings : tuple of str
    notes : tuple of str
        What was decided while reading, where nothing is wrong.
    why_apart : str
        Why this drive does not continue what was recorded before; "" for the first.
    first_stamp_ns : int
        Of the first sweep.
    damage : tuple of str
        What is broken in the files.
    drives : tuple of IngestReport
        One of each drive, where there are several; what stands above is then of all of them.
    """

    recordings: tuple[RecordingReport, ...]
    lasers: tuple[LaserReport, ...]
    scans: int
    geometries: int
    span_s: float
    out_of_order: int
    base_frame: str
    frames: tuple[str, ...]
    odometry: str
    odometry_why: str
    odometry_rejected: tuple[str, ...]
    odometry_path_m: float
    odometry_longest_gap_s: float
    odometry_rate_hz: float
    odometry_quality: TrackQuality | None
    scans_without_odometry: int
    dropped: Mapping[str, int]
    warnings: tuple[str, ...]
    first_stamp_ns: int
    notes: tuple[str, ...] = ()
    damage: tuple[str, ...] = ()
    why_apart: str = ""
    drives: tuple[IngestReport, ...] = ()

    def summary(self) -> dict[str, Any]:
        """Plain numbers and words, with "lines" for people."""
        return {**asdict(self), "lines": self.lines()}

    def lines(self) -> list[str]:
        """Sentences for people."""
        if self.drives:
            return [line for drive in self.drives for line in drive.lines()]
        names = ", ".join(f"{found.name} ({found.kind})" for found in self.recordings)
        lines = [f"a drive of its own: {self.why_apart}"] if self.why_apart else []
        lines += [
            f"{names}: {self.scans} scans over {self.span_s:.1f} s",
            *(line for laser in self.lasers for line in _laser_lines(laser)),
            self._odometry_line(),
        ]
        lines += self.notes
        if self.odometry_rejected:
            lines.append(f"not used as odometry: {'; '.join(self.odometry_rejected)}")
        if self.out_of_order:
            lines.append(
                f"{self.out_of_order} scans were stamped before their predecessor and were sorted in"
            )
        lines += [
            f"{'warning: ' if count > _MUCH * (self.scans + count) else ''}dropped {count}: {reason}"
            for reason, count in sorted(self.dropped.items())
        ]
        lines += [f"warning: {warning}" for warning in self.warnings]
        return lines

    def _odometry_line(self) -> str:
        """Which odometry, and how far it went."""
        if self.odometry == "none":
            return f"odometry: none, {self.odometry_why}"
        return (
            f"odometry: {self.odometry} ({self.odometry_why}), path {self.odometry_path_m:.1f} m, "
            f"longest gap {self.odometry_longest_gap_s:.2f} s"
        )


def join_reports(drives: Sequence[IngestReport]) -> IngestReport:
    """One report of several drives: sums, and the words of each."""
    if len(drives) == 1:
        return drives[0]
    span_s = sum(drive.span_s for drive in drives)
    dropped: Counter[str] = Counter()
    for drive in drives:
        dropped.update(drive.dropped)
    return IngestReport(
        recordings=tuple(found for drive in drives for found in drive.recordings),
        lasers=tuple(laser for drive in drives for laser in drive.lasers),
        scans=sum(drive.scans for drive in drives),
        geometries=sum(drive.geometries for drive in drives),
        span_s=round(span_s, 3),
        out_of_order=sum(drive.out_of_order for drive in drives),
        base_frame=_each(drive.base_frame for drive in drives),
        frames=tuple(sorted({frame for drive in drives for frame in drive.frames})),
        odometry=_each(drive.odometry for drive in drives),
        odometry_why=_each(drive.odometry_why for drive in drives),
        odometry_rejected=tuple(dict.fromkeys(name for drive in drives for name in drive.odometry_rejected)),
        odometry_path_m=round(sum(drive.odometry_path_m for drive in drives), 3),
        odometry_longest_gap_s=max(drive.odometry_longest_gap_s for drive in drives),
        odometry_rate_hz=min(drive.odometry_rate_hz for drive in drives),
        odometry_quality=None,
        scans_without_odometry=sum(drive.scans_without_odometry for drive in drives),
        dropped=dict(dropped),
        warnings=tuple(warning for drive in drives for warning in drive.warnings),
        first_stamp_ns=drives[0].first_stamp_ns,
        notes=tuple(note for drive in drives for note in drive.notes),
        damage=tuple(dict.fromkeys(why for drive in drives for why in drive.damage)),
        drives=tuple(drives),
    )


def _each(words: Iterable[str]) -> str:
    """What all drives have in common, or what each has."""
    return "; ".join(dict.fromkeys(words))


def _laser_lines(laser: LaserReport) -> list[str]:
    """A sentence on a laser, and where it is used one on its beams without a return."""
    beams = "-".join(str(count) for count in sorted(set(laser.beams)))
    what = (
        f"laser {laser.name}: {laser.scans} x {beams} beams over {laser.field_of_view_deg:.0f} deg, "
        f"{laser.rate_hz:.1f} per second"
    )
    if not laser.used:
        return [f"{what}; not used, {laser.why}"]
    where = "pose on the robot not known"
    if laser.pose is not None:
        x, y, yaw = laser.pose
        where = f"at x {x:.3f} m, y {y:.3f} m, yaw {np.degrees(yaw):.1f} deg"
    turned = ", upside down" if laser.upside_down else ""
    masked = f"; {laser.masked}" if laser.masked else ""
    return [
        f"{what}, {where}{turned}; used, {laser.why}{masked}",
        f"laser {laser.name}: {laser.no_return_line}",
    ]
