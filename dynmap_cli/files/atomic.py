"""Writes that are whole or absent."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from dynmap_cli.errors import ArtifactError


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a scratch path beside *path*; rename it over *path* on success."""
    part = path.with_name(path.name + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield part
        part.replace(path)
    except OSError as err:
        msg = f"{path}: cannot be written ({err.strerror or err}). Choose another output or free the place."
        raise ArtifactError(msg) from err
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def scratch_folder(folder: Path) -> Iterator[Path]:
    """Yield an empty folder `.part` beside the files it will become; it is gone afterwards."""
    part = folder.with_name(f".{folder.name}.part")
    try:
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir(parents=True)
        yield part
    except OSError as err:
        where = err.filename or part
        msg = f"{where}: cannot be written ({err.strerror or err}). Choose another output or free the place."
        raise ArtifactError(msg) from err
    finally:
        shutil.rmtree(part, ignore_errors=True)
