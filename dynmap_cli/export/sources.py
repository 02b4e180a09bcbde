"""Recordings opened to be copied: read with their index, or record by record where that fails, be it on the way."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

from dynmap_cli.errors import LogError
from dynmap_cli.export.messages import UnreadableContainerError
from dynmap_cli.ingest.containers.opening import Source, find_sources
from dynmap_cli.ingest.settings import IngestSettings

Written = TypeVar("Written")


def copy_sources(
    paths: Sequence[Path],
    settings: IngestSettings,
    write: Callable[[Sequence[Source], Mapping[Path, str]], Written],
) -> Written:
    """Find the recordings at *paths* and pass them on, until a copy is whole.

    Parameters
    ----------
    paths : sequence of Path
    settings : IngestSettings
        How much may be unpacked, and whether damaged recordings are used.
    write : callable
        (sources, refused) -> result; *refused* has the files that are to be read record by record, and why. It is
        called anew, with one file more, when it raises UnreadableContainerError.

    Raises
    ------
    LogError
        If a recording cannot be read, or is damaged and not to be used.
    """
    with tempfile.TemporaryDirectory(prefix="dynmap-") as scratch:
        limit_bytes = int(settings.max_unpacked_gib * 2**30)
        sources = [source for path in paths for source in find_sources(path, Path(scratch), limit_bytes)]
        refused = {source.path: source.damage for source in sources if source.damage}
        if settings.strict and refused:
            names = ", ".join(source.name for source in sources if source.damage)
            raise _refused(names, "; ".join(refused.values()))
        while True:
            try:
                return write(sources, refused)
            except UnreadableContainerError as err:
                if settings.strict:
                    raise _refused(", ".join(source.name for source in sources), err.why) from err
                refused[err.path] = err.why


def _refused(names: str, why: str) -> LogError:
    """One line for a damaged recording that is not to be used."""
    return LogError(f"{names}: cut off or damaged ({why}), which --strict (ingest.strict) refuses")
