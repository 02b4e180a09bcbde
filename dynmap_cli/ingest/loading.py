"""From plain files to recordings as they are: each is read by the reader of its format."""

from __future__ import annotations

import logging
from collections.abc import Sequence

from dynmap_cli.errors import LogError
from dynmap_cli.ingest.choices.clock_sets import interleaved_ns, undo_set_back
from dynmap_cli.ingest.choices.mixed import drop_mixed
from dynmap_cli.ingest.containers.opening import Source
from dynmap_cli.ingest.raw.recording import RawRecording, file_name
from dynmap_cli.ingest.settings import IngestSettings
from dynmap_cli.ingest.space import Space
from dynmap_cli.ingest.text.carmen import read_carmen
from dynmap_cli.ingest.text.wean import read_wean
from dynmap_cli.printable import printable

_log = logging.getLogger(__name__)
_BAG_NAMES = {"ros1": "ROS 1 bag", "ros2": "ROS 2 bag", "db3": "ROS 2 bag (.db3)", "mcap": "MCAP file"}


def load_all(
    sources: Sequence[Source], settings: IngestSettings, space: Space
) -> list[tuple[Source, RawRecording]]:
    """Read the recording at one path, or those of a folder that can be read; the first says which cannot.

    Raises
    ------
    LogError
        If there is none.
    """
    loaded: list[tuple[Source, RawRecording]] = []
    lost = [why for source in sources for why in source.lost]
    refusal: LogError | None = None
    for source in sources:
        try:
            loaded.append((source, _load(source, settings, space)))
        except LogError as err:
            refusal = refusal or err
            lost.append(str(err).replace(source.name, printable(file_name(source.name)), 1))
            continue
        recording = loaded[-1][1]
        recording.warnings += [f"{printable(file_name(source.name))}: {told.words}" for told in source.said]
        recording.damage += [told.words for told in source.said if told.is_loss]
    if refusal is not None and not loaded:
        raise refusal
    loaded[0][1].warnings += lost
    loaded[0][1].damage += lost
    return loaded


def _load(source: Source, settings: IngestSettings, space: Space) -> RawRecording:
    """Read one recording with the reader of its format."""
    _log.debug("%s: %s", source.name, source.kind)
    if source.kind in {"carmen", "wean"}:
        read = read_carmen if source.kind == "carmen" else read_wean
        return read(source.path, source.name, space.folder)
    # Text logs do without the libraries for bags.
    from dynmap_cli.ingest.clouds import add_clouds, wanted_clouds
    from dynmap_cli.ingest.containers.bag_checks import UnreadableBagError
    from dynmap_cli.ingest.containers.bags import read_bag
    from dynmap_cli.ingest.containers.salvage import read_salvaged

    kind = _BAG_NAMES[source.kind]
    recording = None
    refusal = UnreadableBagError(source.damage)
    if not source.damage:
        try:
            recording = read_bag(source.path, source.name, kind, space)
        except UnreadableBagError as err:
            # A new one, for that one holds on to what was read so far.
            refusal = UnreadableBagError(err.why)
    if recording is None:
        recording = read_salvaged(source.path, source.name, kind, refusal, space.folder)
    elif (mixed_ns := interleaved_ns(recording)) is not None:
        written = read_salvaged(source.path, source.name, kind, UnreadableBagError(""), space.folder)
        if written.n_read == recording.n_read and not written.damage and undo_set_back(written):
            recording = written
        else:
            drop_mixed(recording, *mixed_ns)
    clouds = wanted_clouds(recording, settings)
    if clouds:
        add_clouds(recording, source.path, clouds, settings)
    return recording
