"""What lies in a folder from before: whether it is of the same recordings, and why a stage runs again."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dynmap_cli import __version__
from dynmap_cli.errors import ArtifactError
from dynmap_cli.files.manifest import Manifest, damaged

_MOST_NAMED = 3
_DIGITS = 8


def check_same_recordings(folder: Path, done: Manifest | None, recordings: Mapping[str, str]) -> None:
    """Refuse to replace what was made from other recordings; where they lie does not matter.

    Parameters
    ----------
    folder : Path
        What would be replaced, as the operator knows it.
    done : Manifest or None
        Of the stage that read recordings there.
    recordings : mapping of str to str
        Path -> sha256 of those that were given.

    Raises
    ------
    ArtifactError
        If they are others than those of the manifest.
    """
    if done is None or sorted(done.inputs.values()) == sorted(recordings.values()):
        return
    msg = (
        f"{folder}: made from {_named(done.inputs)}, not from {_named(recordings)}. "
        f"Name the same recordings, choose another output with -o, {_or_update(done, recordings)}"
        "or pass --force to replace it."
    )
    raise ArtifactError(msg)


def _or_update(done: Manifest, recordings: Mapping[str, str]) -> str:
    """Where a run is asked to hold more, or another recording, it may be one more drive of the same place."""
    return "" if set(recordings.values()) <= set(done.inputs.values()) else "add to it with `dynmap update`, "


def why_again(
    done: Manifest, section: str, settings: dict[str, Any], inputs: dict[str, str], folder: Path
) -> str:
    """Say what differs from the last time, in one line; "" where the result is up to date."""
    changes = _changed_settings(section, done.settings, settings)
    if changes:
        return _first(changes)
    if done.inputs != inputs:
        names = sorted({name for name, _ in done.inputs.items() ^ inputs.items()})
        return f"changed: {_first(names)}"
    if done.dynmap_version != __version__:
        return f"dynmap {done.dynmap_version} -> {__version__}"
    path = damaged(folder, done)
    return "" if path is None else f"missing or damaged: {path}"


def _changed_settings(section: str, before: dict[str, Any], now: dict[str, Any]) -> list[str]:
    """Name every setting with its old and its new value; the seed and options belong to no section."""
    return [
        f"{key if key == 'seed' or key.startswith('--') else f'{section}.{key}'} "
        f"{_shown(before, key)} -> {_shown(now, key)}"
        for key in sorted(before.keys() | now.keys())
        if before.get(key) != now.get(key) or (key in before) != (key in now)
    ]


def _shown(settings: dict[str, Any], key: str) -> str:
    """Value of a setting; settings come and go with versions."""
    return str(settings[key]) if key in settings else "not there"


def _first(words: list[str]) -> str:
    """A few of many."""
    more = len(words) - _MOST_NAMED
    return ", ".join(words[:_MOST_NAMED]) + (f" and {more} more" if more > 0 else "")


def _named(recordings: Mapping[str, str]) -> str:
    """Recordings with the first digits of their sha256, since two may have one name."""
    return _first([f"{path} (sha256 {digest[:_DIGITS]})" for path, digest in recordings.items()])
