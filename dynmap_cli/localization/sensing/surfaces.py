"""Which way the surfaces run that block beams: who slides along one proves nothing."""

from __future__ import annotations

import numpy as np

from dynmap_cli.arrays import B1, U8

FROM_ALL_SIDES = 255


def surface_codes(solid: B1) -> U8:
    """Direction of the surface through each solid cell, from the solid cells of the 5 x 5 around it.

    Returns
    -------
    (rows, cols) uint8
        0 = not solid; 1 to 180 = direction of the surface in degrees plus one; `FROM_ALL_SIDES` where
        the cells around form no line.
    """
    rows, cols = np.nonzero(solid)
    padded = np.pad(solid, 2)
    offsets = np.arange(-2, 3)
    dy, dx = (axis.ravel().astype(np.float64) for axis in np.meshgrid(offsets, offsets, indexing="ij"))
    around = np.stack(
        [padded[rows + 2 + int(a), cols + 2 + int(b)] for a, b in zip(dy, dx, strict=True)], axis=-1
    ).astype(np.float64)
    count = np.maximum(around.sum(axis=1), 1.0)
    mean_x, mean_y = around @ dx / count, around @ dy / count
    xx = around @ dx**2 / count - mean_x**2
    yy = around @ dy**2 / count - mean_y**2
    xy = around @ (dx * dy) / count - mean_x * mean_y
    angle_deg = np.degrees(0.5 * np.arctan2(2.0 * xy, xx - yy)) % 180.0
    elongation = np.hypot(xx - yy, 2.0 * xy) / np.maximum(xx + yy, 1e-9)
    codes = np.zeros(solid.shape, dtype=np.uint8)
    is_line = (count >= 3) & (elongation >= 0.5)
    codes[rows, cols] = np.where(is_line, np.minimum(angle_deg, 179.0).astype(np.int64) + 1, FROM_ALL_SIDES)
    return codes
