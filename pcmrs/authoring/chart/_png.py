"""The state chart as a PNG picture."""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree

from pcmrs.errors import ConfigurationError
from pcmrs.extras import missing_module

ZOOM = 2.0
"""Pixels per px of the drawing."""

MAX_PIXELS = 100_000_000
"""Largest picture; it takes 4 bytes per pixel in memory."""

_MONOSPACE = (None, "DejaVu Sans Mono", "Liberation Mono")
"""Fonts to try for the generic name. The renderer's own choice, None, does not exist on every system."""

_SAMPLE = (
    '<svg xmlns="http://www.w3.org/2000/svg" width="20" height="20">'
    '<text y="15" font-family="monospace, sans-serif">{}</text></svg>'
)


def png(svg: str) -> bytes:
    """Return a chart as PNG, drawn with the system's fonts, `ZOOM` pixels for each px of the drawing.

    Raises:
        ConfigurationError: The renderer is not installed, there is no font, so that the names would be missing, or the
            picture is too large.
    """
    root = ElementTree.fromstring(svg)  # noqa: S314  # drawn by this package
    pixels = float(root.attrib["width"]) * float(root.attrib["height"]) * ZOOM**2
    if pixels > MAX_PIXELS:
        text = f"the picture would have {pixels / 1e6:.0f} million pixels; {MAX_PIXELS / 1e6:.0f} are possible: use svg"
        raise ConfigurationError(text, pixels=pixels)
    for font in _MONOSPACE:
        if _shows_text(font):
            return _pixels(svg, font, zoom=ZOOM, background="#ffffff")
    raise ConfigurationError("no font to write the names with: install one (Debian: fonts-dejavu-core), or use svg")


def _shows_text(font: str | None) -> bool:
    """Return true if text is drawn: without a font, the renderer silently leaves it out."""
    texts = (_SAMPLE.format("M"), _SAMPLE.format(""))
    written, blank = (_pixels(text, font) for text in texts)
    return written != blank


def _pixels(svg: str, font: str | None, **options: Any) -> bytes:
    try:
        import resvg_py  # not needed for a chart as text or SVG
    except ModuleNotFoundError as error:
        raise missing_module(error) or error from None
    return resvg_py.svg_to_bytes(svg_string=svg, monospace_family=font, **options)
