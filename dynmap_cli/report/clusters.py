"""How the number of states was chosen: the BIC and the means of the clusters of each round (paper, Fig. 1.18)."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from PIL import Image, ImageDraw

from dynmap_cli.arrays import B1, F32, U8
from dynmap_cli.domain.patches import PatchSet
from dynmap_cli.report.curves import as_png
from dynmap_cli.report.ink import CHANGING, INK, PAPER, UNSEEN, font_of
from dynmap_cli.report.pictures import FULL_REFLECTANCE

_TILE_PIXELS, _MOST_ZOOM, _GAP, _LABEL_WIDTH, _CURVE = 80, 10, 8, 190, (3.4, 2.5)
_PALE = 0.3


def draw_clusters(patch_set: PatchSet, rounds: Sequence[F32]) -> Image.Image:
    """Draw the curve of the BIC, and beside it a row of cluster means for each round.

    Parameters
    ----------
    patch_set : PatchSet
        With the BIC of each round, in which a cluster was added.
    rounds : sequence of (k, rows, cols) float32
        Means of the clusters: 1 occupied, 0 free, NaN unknown.
    """
    best = int(np.argmax(patch_set.bic))
    curve = Image.open(io.BytesIO(_curve(patch_set.bic, best))).convert("RGB")
    rows, cols = patch_set.frame.shape
    zoom = max(1, min(_MOST_ZOOM, _TILE_PIXELS // max(rows, cols)))
    step_x, step_y = cols * zoom + _GAP, max(rows * zoom, 16) + _GAP
    left = curve.width + _GAP + _LABEL_WIDTH
    size = (left + max(map(len, rounds)) * step_x + _GAP, max(curve.height, len(rounds) * step_y + _GAP))
    sheet = Image.new("RGB", size, PAPER)
    sheet.paste(curve, (0, 0))
    pen = ImageDraw.Draw(sheet)
    varying = ~np.isnan(rounds[0][0])
    for number, (means, score) in enumerate(zip(rounds, patch_set.bic, strict=True)):
        top = _GAP + number * step_y
        tried = f"{number + 1} state{'s' * (number > 0)} tried"
        label = f"{tried}: BIC {score:.1f}" + (", best" if number == best else "")
        ink = CHANGING if number == best else INK
        pen.text((curve.width + _GAP, top), label, fill=ink, font=font_of(12))
        for k, mean in enumerate(means):
            x = left + k * step_x
            tile = _tile(mean, varying, patch_set).repeat(zoom, axis=0).repeat(zoom, axis=1)
            sheet.paste(Image.fromarray(tile), (x, top))
            edge = CHANGING if number == best else (176, 176, 176)
            pen.rectangle((x - 1, top - 1, x + cols * zoom, top + rows * zoom), outline=edge)
    return sheet


def _tile(mean: F32, varying: B1, patch_set: PatchSet) -> U8:
    """(rows, cols, 3) colours of a cluster, first row on top; what stands in all states is pale."""
    still = np.stack([np.nan_to_num(patch.reflectance) for patch in patch_set.patches]).min(axis=0)
    strength = np.where(varying, np.nan_to_num(mean), _PALE * np.clip(still / FULL_REFLECTANCE, 0.0, 1.0))
    ink = np.where(varying[..., None], np.array(CHANGING), np.array(INK))
    colours = np.array(PAPER) * (1.0 - strength[..., None]) + ink * strength[..., None]
    colours[varying & np.isnan(mean)] = UNSEEN
    return np.asarray(np.flipud(colours), dtype=np.uint8)


def _curve(bic: Sequence[float], best: int) -> bytes:
    """BIC by the number of states that were tried; a PNG."""
    figure = Figure(figsize=_CURVE, dpi=100, layout="constrained")
    axes = figure.subplots()
    numbers = np.arange(1, len(bic) + 1)
    axes.plot(numbers, bic, "o-", color="#2a6fb5")
    axes.plot(numbers[best], bic[best], "o", color="#be3c14", markersize=9, zorder=3)
    axes.set_title("the largest BIC is chosen", fontsize=9)
    axes.set_xlabel("states tried, one more in each round")
    axes.set_ylabel("BIC (larger: better)")
    axes.set_xticks(numbers)
    axes.grid(visible=True, color="#e4e4e4")
    return as_png(figure)
