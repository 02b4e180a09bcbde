"""What scans must have for a map to be made of them."""

from __future__ import annotations

from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.errors import LogError
from dynmap_cli.mapping.settings import MapSettings


def check_scans(log: ScanLog, settings: MapSettings, name: str) -> None:
    """Refuse scans of which no map can be made; *name* is where they are, for the message.

    Raises
    ------
    LogError
    """
    if log.n_scans < 2:
        msg = f"{name}: {log.n_scans} scans, a map needs at least 2. Use a longer recording."
        raise LogError(msg)
    if settings.poses == "recorded" and not log.has_odometry.all():
        missing = int((~log.has_odometry).sum())
        msg = f"{name}: {missing} scans without recorded pose. Use map.poses: estimate."
        raise LogError(msg)
