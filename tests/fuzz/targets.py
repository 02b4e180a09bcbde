"""What is damaged and read again: a whole sample of each kind of input, and the reader it is for."""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from tests.fuzz import artefacts, recordings
from tests.fuzz.parts import PARTS, taken_apart


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
    parts : str
        How files are taken apart, so that what they hold is damaged and not their checksums; one of `PARTS`, or "".
    """

    name: str
    make: Callable[[Path], object]
    read: Callable[[Path], object]
    parts: str = ""

    def sample(self) -> dict[str, bytes]:
        """Content of each file by its path in the folder; parts of those that are taken apart as `file!part`."""
        return _sample(self)

    def write(self, folder: Path, files: Mapping[str, bytes]) -> None:
        """Write files, and put together what was taken apart."""
        members: dict[str, dict[str, bytes]] = {}
        for name, data in files.items():
            outer, _, inner = name.partition("!")
            if inner:
                members.setdefault(outer, {})[inner] = data
                continue
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        for outer, parts in members.items():
            path = folder / outer
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(PARTS[self.parts].put(parts))


@functools.cache
def _sample(target: Target) -> dict[str, bytes]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        target.make(folder)
        found: dict[str, bytes] = {}
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                place = path.relative_to(folder).as_posix()
                found |= taken_apart(target.parts, place, path.read_bytes())
        return found


def _recording_targets() -> list[Target]:
    def read(folder: Path) -> object:
        return recordings.ingest(folder, recordings.SMALL)

    targets = [Target(name, make, read) for name, make in recordings.SAMPLES.items()]
    targets += [
        Target(f"packed {how}", functools.partial(recordings.write_packed, how=how), read)
        for how in ("gz", "bz2", "xz", "zst", "zip")
    ]
    targets += [
        Target(f"salvage {name}", recordings.SAMPLES[name], recordings.salvage)
        for name in ("ros1", "db3", "mcap plain", "mcap ros2", "folder")
    ]
    for use in (read, recordings.salvage):
        by = "salvage " if use is recordings.salvage else ""
        targets += [
            Target(f"{by}{name}", make, use, kind) for name, (make, kind) in recordings.INSIDE.items()
        ]
    return targets


def _artefact_targets() -> list[Target]:
    return [
        Target(f"{name}, {parts}" if parts else name, make, read, parts)
        for name, (make, read) in artefacts.SAMPLES.items()
        for parts in (["", "inside"] if name in artefacts.WITH_ARCHIVES else [""])
    ]


TARGETS: dict[str, Target] = {target.name: target for target in (*_recording_targets(), *_artefact_targets())}
