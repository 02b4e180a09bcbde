"""Recordings and maps that are passed on the command line: whether they are there, once, and their digests."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from dynmap_cli.errors import ArtifactError, DynmapError, LogError
from dynmap_cli.files.manifest import sha256_of
from dynmap_cli.ingest.containers.opening import check_path


def check_recordings(recordings: Sequence[Path]) -> None:
    """Refuse recordings that are not there, or there twice, before anything is made."""
    if not recordings:
        msg = "no recording given. Pass one or more files or folders."
        raise LogError(msg)
    for path, count in Counter(recordings).items():
        if count > 1:
            msg = f"{path} and {path}: the same recording. Pass it once."
            raise LogError(msg)
    for path in recordings:
        check_path(path)


def check_apart(output: Path, recordings: Sequence[Path]) -> None:
    """Refuse an output that is, or lies in, a recording that is read: it would change what was recorded."""
    if any(output.resolve().is_relative_to(path.resolve()) for path in recordings):
        msg = f"{output}: is, or lies in, the recording that is read. Choose another output."
        raise ArtifactError(msg)


def digests_of(paths: Sequence[Path], error: type[DynmapError]) -> dict[str, str]:
    """Digest of each file or folder, by its path as given."""
    digests = {}
    for path in paths:
        try:
            digests[str(path)] = sha256_of(path)
        except OSError as err:
            msg = f"{path}: cannot be read ({err.strerror})"
            raise error(msg) from err
    return digests
