"""A recording written again without the beams that hit something that moves, every other byte as it was."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path

from dynmap_cli.errors import ArtifactError, LogError
from dynmap_cli.export.labels import LABEL_SUFFIX, BeamLabels
from dynmap_cli.export.mcap_copy import McapCopy
from dynmap_cli.export.messages import Container, in_order, open_container
from dynmap_cli.export.scan_bytes import parse_scan
from dynmap_cli.export.sources import copy_sources
from dynmap_cli.export.text_logs import TextChoices, text_container
from dynmap_cli.files.atomic import replacing
from dynmap_cli.ingest.containers.opening import Source
from dynmap_cli.ingest.messages.kinds import CLOUD_TYPES, FOXGLOVE_TYPES, LASER_TYPES
from dynmap_cli.ingest.messages.stored import StoredMessage
from dynmap_cli.ingest.raw.recording import file_name
from dynmap_cli.ingest.settings import IngestSettings
from dynmap_cli.ingest.text.carmen import read_carmen
from dynmap_cli.ingest.text.wean import read_wean

_FOREIGN_TYPES = {*CLOUD_TYPES, *(name for name in FOXGLOVE_TYPES if name.endswith("LaserScan"))}
_ENCODINGS = ("cdr", "ros1")
_TEXT_READERS = {"carmen": read_carmen, "wean": read_wean}


@dataclass(slots=True)
class Cleaned:
    """What was written.

    Attributes
    ----------
    scans : Counter
        Sweeps that the run has labels for, by topic.
    beams, removed : int
        Beams of these sweeps that have an end point, and how many of them are NaN now (or labelled so).
    other_scans : Counter
        Sweeps that the run has no labels for, copied as they were, by topic.
    other_messages : int
        Copied byte for byte.
    losses : list of str
        What was lost of recordings that are damaged, one sentence each.
    foreign_scans : set of str
        Topics of scans and clouds of types that are not rewritten.
    """

    scans: Counter[str] = field(default_factory=Counter)
    beams: int = 0
    removed: int = 0
    other_scans: Counter[str] = field(default_factory=Counter)
    other_messages: int = 0
    losses: list[str] = field(default_factory=list)
    foreign_scans: set[str] = field(default_factory=set)


def write_clean(
    paths: Sequence[Path],
    out_path: Path,
    labels: BeamLabels,
    *,
    text: TextChoices,
    is_label: bool,
    settings: IngestSettings,
) -> Cleaned:
    """Write recordings as one MCAP file in which the removed beams are NaN; damaged ones as far as they are whole.

    Parameters
    ----------
    paths : sequence of Path
        The recordings the labels were made from.
    out_path : Path
    labels : BeamLabels
    text : TextChoices
        What a text log leaves open.
    is_label : bool
        Keep the scans, and put the static probabilities beside them: intensities of scans on
        TOPIC/static_probability.
    settings : IngestSettings
        How much may be unpacked, and whether damaged recordings are used.

    Raises
    ------
    LogError
        If a recording cannot be read.
    ArtifactError
        If the recordings are not those of the labels, or the output cannot be written.
    """
    return copy_sources(
        paths,
        settings,
        lambda sources, refused: _write(sources, refused, out_path, labels, text=text, is_label=is_label),
    )


def _write(
    sources: Sequence[Source],
    refused: Mapping[Path, str],
    out_path: Path,
    labels: BeamLabels,
    *,
    text: TextChoices,
    is_label: bool,
) -> Cleaned:
    """Write once; see `write_clean`."""
    done = Cleaned()
    labels.was_found[:] = False
    with ExitStack() as stack:
        containers = [one for source in sources for one in _opened(source, refused, text, stack)]
        with replacing(out_path) as part, part.open("wb") as stream:
            writer = McapCopy(stream, containers, "dynmap clean")
            for stored in in_order(containers):
                _take(stored, writer, labels, done, is_label=is_label)
            missing = labels.missing
            if missing == labels.was_found.size or (missing and not refused):
                raise _not_found(sources, missing, labels, done)
            if len(labels.drives) > 1:
                raise _several_drives(labels.drives)
            writer.finish()
    done.losses = [one.damage.line() for one in containers if one.damage]
    done.losses += [
        f"{file_name(source.name)}: {source.damage}; cleaned as far as it could be unpacked"
        for source in sources
        if source.damage and source.kind in _TEXT_READERS
    ]
    return done


def _not_found(sources: Sequence[Source], missing: int, labels: BeamLabels, done: Cleaned) -> ArtifactError:
    """One line for scans of the run that are not in the recordings."""
    names, total = ", ".join(source.name for source in sources), labels.was_found.size
    if missing == total and done.foreign_scans:
        topics = ", ".join(sorted(done.foreign_scans))
        return ArtifactError(
            f"{names}: only LaserScan and MultiEchoLaserScan of ROS are rewritten, not {topics}"
        )
    return ArtifactError(
        f"{names}: {missing} of the {total} scans of the run are not in it. Pass the recordings that the run was made "
        "from, or leave out --run."
    )


def _several_drives(drives: Sequence[str]) -> ArtifactError:
    """One line for recordings that one file cannot hold: its odometry would jump where nobody knows how."""
    return ArtifactError(
        f"{'; '.join(drives)}: {len(drives)} drives, and a recording holds one. Clean each on its own; with --run RUN "
        "all take their labels from the map they share."
    )


def _opened(
    source: Source, refused: Mapping[Path, str], text: TextChoices, stack: ExitStack
) -> list[Container]:
    """Open one recording of any kind."""
    if source.kind in _TEXT_READERS:
        return [text_container(_TEXT_READERS[source.kind](source.path, source.name), text)]
    return open_container(source, refused, stack)


def _take(
    stored: StoredMessage, writer: McapCopy, labels: BeamLabels, done: Cleaned, *, is_label: bool
) -> None:
    """Write one message, and its labels."""
    channel = stored.channel
    if channel.message_encoding not in _ENCODINGS or channel.message_type not in LASER_TYPES:
        done.other_messages += 1
        if channel.message_type in _FOREIGN_TYPES:
            done.foreign_scans.add(channel.topic)
        writer.add(stored)
        return
    try:
        scan = parse_scan(stored.data, channel.message_encoding, channel.message_type)
    except LogError:
        row = None
    else:
        row = labels.row_of(scan.stamp_ns or stored.logged_ns, scan.first_echoes_m)
    if row is None:
        done.other_scans[channel.topic] += 1
        writer.add(stored)
        return
    removed = labels.removed(row, scan.offsets.size)
    done.scans[channel.topic] += 1
    done.beams += labels.n_ended(row, scan.offsets.size)
    done.removed += int(removed.sum())
    if not is_label:
        writer.add(stored._replace(data=scan.without(removed)))
        return
    writer.add(stored)
    beside = replace(channel, topic=channel.topic + LABEL_SUFFIX)
    values = labels.static_probability(row, scan.offsets.size)
    writer.add(stored._replace(channel=beside, data=scan.with_intensities(values)))
