"""Many poses weighed by one scan: in fixed parts, so that threads may share them and the bytes stay the same."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from dynmap_cli.arrays import F64, I32

_POSES_PER_CHUNK = 50_000
_NO_WINDOW = np.zeros((1, 5), dtype=np.int32)
"""All poses read from the map."""


def weigh_in_chunks(
    weigh: Callable[[F64, I32, F64], None],
    poses: F64,
    windows: I32 | None,
    executor: ThreadPoolExecutor | None,
) -> F64:
    """Weigh all poses part by part.

    Parameters
    ----------
    weigh : callable
        Is given some poses (m, 3), their windows (m, 5), or one (1, 5) of zeros for all, and where to write (m,).
    poses : (n_poses, 3) float64
        map_from_robot.
    windows : (n_poses, 5) int32 or None
        The patch each pose reads from; none = all read from the map.
    executor : ThreadPoolExecutor or None
        Shares the parts among threads, if there are several.

    Returns
    -------
    (n_poses,) float64
    """
    n_poses = poses.shape[0]
    out = np.empty(n_poses)

    def weigh_chunk(chunk: slice) -> None:
        weigh(poses[chunk], _NO_WINDOW if windows is None else windows[chunk], out[chunk])

    chunks = [slice(k, k + _POSES_PER_CHUNK) for k in range(0, n_poses, _POSES_PER_CHUNK)]
    if executor is None or len(chunks) == 1:
        for chunk in chunks:
            weigh_chunk(chunk)
    else:
        list(executor.map(weigh_chunk, chunks))
    return out
