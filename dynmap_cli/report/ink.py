"""Colours and letters that all pictures share."""

from __future__ import annotations

from PIL import ImageFont

Colour = tuple[int, int, int]
INK, PAPER, UNSEEN = (32, 32, 32), (255, 255, 255), (216, 216, 214)
MOVED, PATH, CHANGING = (240, 128, 16), (40, 110, 200), (190, 60, 20)
_OF_SUBMAPS = ((122, 95, 176), (138, 109, 59), (190, 70, 160), (0, 140, 150), (128, 138, 20))
"""None of them means anything else in a picture of the map."""
_SMALLEST_FONT, _PIXELS_PER_FONT = 16, 80
"""Words stay readable where a large picture is shown as wide as a page."""


def colour_of_submap(submap_id: int) -> Colour:
    """Of its frame and name, the same in all pictures."""
    return _OF_SUBMAPS[submap_id % len(_OF_SUBMAPS)]


def font_of(pixels: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """The font that comes with Pillow."""
    return ImageFont.load_default(pixels)


def font_pixels(size: tuple[int, int]) -> int:
    """Height of the words on a picture of this width and height."""
    return max(_SMALLEST_FONT, max(size) // _PIXELS_PER_FONT)
