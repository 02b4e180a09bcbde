"""Grey images that somebody else may have written, or a `ValueError`."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from PIL import Image

from dynmap_cli.arrays import U8
from dynmap_cli.domain.grid import MAX_CELLS

_EIGHT_BITS = {"1", "L", "LA", "P", "RGB", "RGBA"}


def read_grey(path: Path) -> U8:
    """Read an image as shades of grey, (rows, cols) 0 to 255, first row on top.

    Raises
    ------
    OSError, ValueError
        If it is missing, damaged, larger than any grid may be, or has more than 8 bits a pixel and colour.
    """
    with warnings.catch_warnings():
        # Pillow warns from fewer pixels on than a grid may have cells; the size is checked here.
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        try:
            with Image.open(path) as image:
                if image.width * image.height > MAX_CELLS:
                    msg = f"{image.width} x {image.height} pixels, at most {MAX_CELLS:.2g} are read"
                    raise ValueError(msg)
                if image.mode not in _EIGHT_BITS:
                    msg = f"pixels of mode {image.mode}, expected 8 bits of grey"
                    raise ValueError(msg)
                return np.asarray(image.convert("L"), dtype=np.uint8)
        except Image.DecompressionBombError as err:
            msg = f"more pixels than the {MAX_CELLS:.2g} that are read"
            raise ValueError(msg) from err
        except (SyntaxError, IndexError, TypeError, EOFError, ArithmeticError, MemoryError) as err:
            msg = f"damaged image, {err}"
            raise ValueError(msg) from err
