"""The cells of a draw.io file, compressed or not."""

from __future__ import annotations

import base64
import binascii
import html
import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from urllib.parse import unquote

from pcmrs.authoring.exchange.importing.markup import Element, read_xml
from pcmrs.fsm.files.bounded import MAX_BYTES
from pcmrs.fsm.finding import Place, refuse

RAW_DEFLATE = -15
TAG = re.compile(r"<[^<>]*>")
STARTS = frozenset({"startState"})
ENDS = frozenset({"endState", "doubleEllipse"})
UNSUPPORTED = {"rhombus": "choice"}
TEXTS = frozenset({"text", "note", "edgeLabel", "image"})


@dataclass(frozen=True, slots=True)
class Cell:
    """One thing on the page.

    Attributes:
        id: What others name it by.
        parent: The cell it is in.
        text: What is written on it.
        shape: Names of its shape in its style.
        kind: ``vertex``, ``edge``, or empty for a layer.
        source: Where an arrow begins.
        target: Where it ends.
        place: In the file.
    """

    id: str
    parent: str
    text: str
    shape: frozenset[str]
    kind: str
    source: str
    target: str
    place: Place

    @property
    def layer(self) -> bool:
        """Whether it only holds others."""
        return not self.kind

    @property
    def arrow(self) -> bool:
        """Whether it joins two others."""
        return self.kind == "edge"

    @property
    def start_marker(self) -> bool:
        """Whether it marks the start of what it is in."""
        return bool(self.shape & STARTS) or ("ellipse" in self.shape and not self.text and not self.end_marker)

    @property
    def end_marker(self) -> bool:
        """Whether an arrow to it says that the procedure may end."""
        return bool(self.shape & ENDS) and not self.text

    @property
    def unsupported(self) -> str:
        """What it is, where that cannot be read."""
        return next((UNSUPPORTED[name] for name in self.shape if name in UNSUPPORTED), "")

    @property
    def state(self) -> bool:
        """Whether it is a state."""
        marker = self.start_marker or self.end_marker
        return self.kind == "vertex" and not marker and not self.shape & TEXTS


def read_cells(raw: bytes, origin: str) -> tuple[str, list[Cell]]:
    """The name of the diagram and its cells, in the order of the file.

    Raises:
        BlueprintError: It is no draw.io diagram, has several pages, or is too large when decompressed.
    """
    document = read_xml(raw, origin)
    name, place, model = "", None, document
    if document.name == "mxfile":
        pages = document.every("diagram")
        if len(pages) != 1:
            text = f"The file has {len(pages)} pages: only one with exactly one is read."
            refuse(origin, "not_supported", text, pages[1].place if pages else document.place)
        name = pages[0].attributes.get("name", "")
        models = pages[0].every("mxGraphModel")
        place = None if models else pages[0].place
        model = models[0] if models else _decompressed(pages[0], origin)
    if model.name != "mxGraphModel":
        refuse(origin, "not_drawio", f"There is no diagram in this: it has a {model.name[:60]}.", model.place)
    roots = model.every("root")
    cells = [_cell(element, place) for root in roots for element in root.children]
    return "" if re.fullmatch(r"Page-\d+", name) else name, [cell for cell in cells if cell is not None]


def _decompressed(page: Element, origin: str) -> Element:
    try:
        packed = base64.b64decode("".join(page.text.split()), validate=True)
        raw = zlib.decompressobj(RAW_DEFLATE).decompress(packed, MAX_BYTES + 1)
    except (binascii.Error, zlib.error, ValueError):
        refuse(origin, "not_drawio", "The compressed diagram cannot be read.", page.place)
    if len(raw) > MAX_BYTES:
        refuse(origin, "too_large", f"The diagram is over {MAX_BYTES} bytes when decompressed.", page.place)
    return read_xml(unquote(raw.decode(errors="replace")).encode(errors="replace"), origin)


def _cell(element: Element, place: Place | None) -> Cell | None:
    """The cell in an element; draw.io puts one with data of its own inside of another element."""
    wrapped = element.every("mxCell")
    inner = wrapped[0] if wrapped else element
    if inner.name != "mxCell":
        return None
    given = {**inner.attributes, **element.attributes}
    kind = "vertex" if inner.attributes.get("vertex") == "1" else "edge" if inner.attributes.get("edge") == "1" else ""
    return Cell(
        id=given.get("id", ""),
        parent=inner.attributes.get("parent", ""),
        text=_text(given.get("label", given.get("value", ""))),
        shape=frozenset(_shapes(inner.attributes.get("style", ""))),
        kind=kind,
        source=inner.attributes.get("source", ""),
        target=inner.attributes.get("target", ""),
        place=place or element.place,
    )


def _shapes(style: str) -> Iterator[str]:
    for part in style.split(";"):
        key, _, value = part.partition("=")
        if not value:
            yield key
        elif key == "shape":
            yield value


def _text(label: str) -> str:
    """A label without its markup, on one line."""
    return " ".join(html.unescape(TAG.sub(" ", label)).split())
