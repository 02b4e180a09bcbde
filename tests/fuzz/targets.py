"""What is damaged and read again: a whole sample of each kind of input, and the reader it is for."""

from __future__ import annotations

import functools
import io
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from dynmap_cli.ingest.settings import IngestSettings
from tests.fuzz import artefacts, recordings

ARCHIVES = (".zip", ".npz")


@dataclass(frozen=True)
class Target:
    """A kind of input.

    Attributes
    ----------
    name : str
    make : callable
        Writes a whole sample into an empty folder.
    read : callable
        Reads what lies in a folder.
    inside : bool
        Archives are taken apart, so that what they hold is damaged and not their checksums.
    """

    name: str
    make: Callable[[Path], object]
    read: Callable[[Path], object]
    inside: bool = False

    def sample(self) -> dict[str, bytes]:
        """Content of each file by its path in the folder; members of archives as `archive!member`."""
        return _sample(self)

    def write(self, folder: Path, files: Mapping[str, bytes]) -> None:
        """Write files, and put archives together again."""
        members: dict[str, dict[str, bytes]] = {}
        for name, data in files.items():
            outer, _, inner = name.partition("!")
            if inner:
                members.setdefault(outer, {})[inner] = data
                continue
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        for outer, inside in members.items():
            path = folder / outer
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(_packed(inside))


@functools.cache
def _sample(target: Target) -> dict[str, bytes]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        target.make(folder)
        found: dict[str, bytes] = {}
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                place = path.relative_to(folder).as_posix()
                found.update(
                    _unpacked(place, path.read_bytes()) if target.inside else {place: path.read_bytes()}
                )
        return found


def _unpacked(name: str, data: bytes) -> dict[str, bytes]:
    if Path(name).suffix in ARCHIVES:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return {f"{name}!{member}": archive.read(member) for member in archive.namelist()}
    return {name: data}


def _packed(members: Mapping[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return stream.getvalue()


def _recording_targets() -> list[Target]:
    small = IngestSettings(max_unpacked_gib=0.05)

    def read(folder: Path) -> object:
        return recordings.ingest(folder, small)

    targets = [Target(name, make, read) for name, make in recordings.SAMPLES.items()]
    targets += [
        Target(f"packed {how}", functools.partial(recordings.write_packed, how=how), read)
        for how in ("gz", "bz2", "xz", "zst", "zip")
    ]
    targets += [
        Target(f"salvage {name}", recordings.SAMPLES[name], recordings.salvage)
        for name in ("ros1", "db3", "mcap plain", "mcap ros2", "folder")
    ]
    return targets


def _artefact_targets() -> list[Target]:
    return [
        Target(name, make, read, inside=inside)
        for name, (make, read) in artefacts.SAMPLES.items()
        for inside in ([False, True] if name in artefacts.WITH_ARCHIVES else [False])
    ]


TARGETS: dict[str, Target] = {
    f"{target.name}, inside" if target.inside else target.name: target
    for target in (*_recording_targets(), *_artefact_targets())
}
