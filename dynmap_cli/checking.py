"""Whether recordings can be built, told from what is in them, before anything is made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from dynmap_cli.config import Config
from dynmap_cli.errors import LogError
from dynmap_cli.ingest.choices.odometry import SECOND_CHOICE
from dynmap_cli.ingest.raw.recording import Topic
from dynmap_cli.ingest.reading import load_recordings, merge_recordings
from dynmap_cli.ingest.report import IngestReport
from dynmap_cli.ingest.settings import IngestSettings
from dynmap_cli.mapping.demands import check_scans

_SECOND_CHOICE = f" ({SECOND_CHOICE}"
_FROZEN_SHARE = 0.05


@dataclass(frozen=True, slots=True)
class Advice:
    """An option that the recordings call for.

    Attributes
    ----------
    option, why : str
    """

    option: str
    why: str


@dataclass(frozen=True, slots=True)
class Refusal:
    """Recordings of which nothing can be built.

    Attributes
    ----------
    names : tuple of str
        As they were passed.
    why : str
        In one line.
    topics : tuple of (str, str, tuple of Topic)
        Name, format and content of what could be read at all.
    """

    names: tuple[str, ...]
    why: str
    topics: tuple[tuple[str, str, tuple[Topic, ...]], ...] = ()


@dataclass(frozen=True, slots=True)
class Check:
    """What was found.

    Attributes
    ----------
    drives : tuple of IngestReport
        One of each drive that can be read.
    refusals : tuple of Refusal
        None = `build` will work.
    advice : tuple of Advice
    """

    drives: tuple[IngestReport, ...]
    refusals: tuple[Refusal, ...]
    advice: tuple[Advice, ...]


def check_recordings(paths: Sequence[Path], config: Config) -> Check:
    """Read recordings as `build` would; those that cannot be used together are looked at one by one.

    Parameters
    ----------
    paths : sequence of Path
    config : Config
    """
    together = _check(paths, config)
    found = [together]
    if len(paths) > 1 and together.refusals:
        found = [_check([path], config) for path in paths]
        if not any(one.refusals for one in found):
            found.append(Check((), together.refusals, ()))
    advice = dict.fromkeys(advised for one in found for advised in one.advice)
    return Check(
        tuple(drive for one in found for drive in one.drives),
        tuple(refusal for one in found for refusal in one.refusals),
        tuple(advice),
    )


def _check(paths: Sequence[Path], config: Config) -> Check:
    """Read recordings that are to become one map."""
    names = tuple(str(path) for path in paths)
    topics: tuple[tuple[str, str, tuple[Topic, ...]], ...] = ()
    try:
        recordings = load_recordings(paths, config.ingest)
        topics = tuple((one.name, one.kind, tuple(one.topics)) for one in recordings)
        log, report = merge_recordings(recordings, config.ingest)
        check_scans(log, config.map, ", ".join(names))
    except LogError as err:
        return Check((), (Refusal(names, str(err), topics),), ())
    drives = report.drives or (report,)
    advice = [advised for drive in drives for advised in _advice(drive, config.ingest)]
    return Check(drives, (), tuple(advice))


def _advice(drive: IngestReport, settings: IngestSettings) -> list[Advice]:
    """Options without which the map of a drive would be worse."""
    found = []
    unknown = [laser.name for laser in drive.lasers if laser.used and not laser.is_pose_known]
    if unknown:
        why = f"the recording does not say where {', '.join(unknown)} sits on the robot"
        found.append(Advice("--laser-pose X,Y,YAW", f"{why}; its centre is assumed"))
    quality = drive.odometry_quality
    if quality is not None and settings.odom is None:
        others = [
            name.partition(_SECOND_CHOICE)[0] for name in drive.odometry_rejected if _SECOND_CHOICE in name
        ]
        other = f"--odom {others[0]}" if others else "--odom none"
        if quality.jumps:
            found.append(Advice(other, f"{drive.odometry} jumps {quality.jumps} times"))
        elif quality.frozen > _FROZEN_SHARE * quality.moving and quality.frozen > 1:
            share = quality.frozen / quality.moving
            why = f"{drive.odometry} stands still in {100 * share:.0f} % of the half seconds in which "
            found.append(
                Advice(other, f"{why}the ranges change; worth a second try if the map comes out bent")
            )
    return found
