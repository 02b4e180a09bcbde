"""The page: plain HTML, pictures inside, no script and nothing to load."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

_STYLE = """
body { font: 15px/1.5 sans-serif; color: #222; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.15rem; margin-top: 2rem; border-bottom: 1px solid #ddd; }
img { max-width: 100%; height: auto; } figure { margin: 1rem 0; }
figcaption { color: #555; font-size: 0.9rem; }
table { border-collapse: collapse; } td, th { padding: 0.15rem 1rem 0.15rem 0; text-align: left; vertical-align: top; }
th { font-weight: normal; color: #555; } code { font-size: 0.9em; }
.warning { color: #a02010; font-weight: bold; }
"""


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure of the page.

    Attributes
    ----------
    name : str
        File name in figures/.
    png : bytes
    caption : str
    """

    name: str
    png: bytes
    caption: str


@dataclass(frozen=True, slots=True)
class Section:
    """A part of the page.

    Attributes
    ----------
    title : str
    lines : tuple of str
        Sentences.
    rows : tuple of (str, str)
        A table of names and values.
    pictures : tuple of Picture
    """

    title: str
    lines: tuple[str, ...] = ()
    rows: tuple[tuple[str, str], ...] = ()
    pictures: tuple[Picture, ...] = ()


def write_page(title: str, sections: Sequence[Section]) -> str:
    """Return the whole page."""
    body = "\n".join(_section(section) for section in sections)
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{escape(title)}</title>\n'
        f"<style>{_STYLE}</style>\n</head>\n<body>\n<h1>{escape(title)}</h1>\n{body}\n</body>\n</html>\n"
    )


def _section(section: Section) -> str:
    parts = [f"<h2>{escape(section.title)}</h2>"]
    if section.lines:
        parts += ["<ul>", *map(_item, section.lines), "</ul>"]
    if section.rows:
        rows = (f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in section.rows)
        parts += ["<table>", *rows, "</table>"]
    return "\n".join([*parts, *map(_figure, section.pictures)])


def _item(line: str) -> str:
    mark = ' class="warning"' if line.startswith("warning") else ""
    return f"<li{mark}>{escape(line)}</li>"


def _figure(picture: Picture) -> str:
    code = base64.b64encode(picture.png).decode("ascii")
    caption = escape(picture.caption)
    return (
        f'<figure><img src="data:image/png;base64,{code}" alt="{caption}">'
        f"<figcaption>{caption}</figcaption></figure>"
    )
