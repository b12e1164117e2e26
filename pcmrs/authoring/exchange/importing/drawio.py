"""Reads draw.io diagrams: shapes are states, shapes inside shapes nested states, arrows with labels transitions.

Containers that stand side by side without arrows between them are active together. Every other container, and the
page, needs a small circle without text with an arrow to the state it starts in. An arrow without text to an end
marker says that the procedure may end there. Notes and texts are ignored.
"""

from __future__ import annotations

import base64
import binascii
import html
import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from urllib.parse import unquote

from pcmrs.authoring.exchange.importing._chart import Edge, Node
from pcmrs.authoring.exchange.importing._markup import Element, read_xml
from pcmrs.authoring.exchange.importing._reading import MAX_DEPTH, NO_EVENTS, Findings, events_of
from pcmrs.authoring.exchange.importing.imported import import_chart
from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.files.toml import MAX_BYTES
from pcmrs.fsm.finding import Finding, Place, refuse

RAW_DEFLATE = -15
TAG = re.compile(r"<[^<>]*>")
STARTS = frozenset({"startState"})
ENDS = frozenset({"endState", "doubleEllipse"})
UNSUPPORTED = {"rhombus": "choice"}
TEXTS = frozenset({"text", "note", "edgeLabel", "image"})


@dataclass(frozen=True, slots=True)
class MxCell:
    """One thing on the page.

    Attributes:
        id: Its identity in the file.
        parent: The cell it is in.
        text: Its text.
        shape: Names of its shape in its style.
        kind: ``vertex``, ``edge``, or empty for a layer.
        source: Cell at which an arrow begins.
        target: Cell at which it ends.
        place: Its place in the file.
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
        """It only holds others."""
        return not self.kind

    @property
    def arrow(self) -> bool:
        """It joins two others."""
        return self.kind == "edge"

    @property
    def start_marker(self) -> bool:
        """It marks the start of the state or page that contains it."""
        return bool(self.shape & STARTS) or ("ellipse" in self.shape and not self.text and not self.end_marker)

    @property
    def end_marker(self) -> bool:
        """An arrow to it says that the procedure may end."""
        return bool(self.shape & ENDS) and not self.text

    @property
    def unsupported(self) -> str:
        """Name of its kind, if that cannot be read; else empty."""
        return next((UNSUPPORTED[name] for name in self.shape if name in UNSUPPORTED), "")

    @property
    def state(self) -> bool:
        """It is a state."""
        marker = self.start_marker or self.end_marker
        return self.kind == "vertex" and not marker and not self.shape & TEXTS


def _read_cells(raw: bytes, origin: str) -> tuple[str, list[MxCell]]:
    """Return the name of the diagram and its cells, in the order of the file.

    Args:
        raw: The file, its diagram compressed or not.
        origin: Name of the file in findings.

    Raises:
        BlueprintError: It is not a draw.io diagram, has several pages, or is too large when decompressed.
    """
    document = read_xml(raw, origin)
    name, place, model = "", None, document
    if document.name == "mxfile":
        pages = document.every("diagram")
        if len(pages) != 1:
            text = f"The file has {len(pages)} pages; it must have exactly one."
            refuse(origin, "not_supported", text, pages[1].place if pages else document.place)
        name = pages[0].attributes.get("name", "")
        models = pages[0].every("mxGraphModel")
        place = None if models else pages[0].place
        model = models[0] if models else _decompressed(pages[0], origin)
    if model.name != "mxGraphModel":
        refuse(origin, "not_drawio", f"There is no diagram in this file: it has a {model.name[:60]}.", model.place)
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


def _cell(element: Element, place: Place | None) -> MxCell | None:
    """Return the cell in an element; draw.io wraps a cell that has its own data in another element."""
    wrapped = element.every("mxCell")
    inner = wrapped[0] if wrapped else element
    if inner.name != "mxCell":
        return None
    given = {**inner.attributes, **element.attributes}
    kind = "vertex" if inner.attributes.get("vertex") == "1" else "edge" if inner.attributes.get("edge") == "1" else ""
    return MxCell(
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
    """Return a label without its markup, on one line."""
    return " ".join(html.unescape(TAG.sub(" ", label)).split())


def from_drawio(raw: bytes, origin: str = "drawio") -> tuple[Blueprint | None, list[Finding]]:
    """Return a blueprint with the behaviour that a draw.io diagram shows.

    Args:
        raw: The file, its diagram compressed or not.
        origin: Name of the file in findings.

    Returns:
        The blueprint, or None and the unsupported elements, each with its line and column. Cells of a compressed
        diagram have the place of the diagram.
    """
    return import_chart(raw, origin, _read)


def _read(raw: bytes, findings: Findings) -> Node:
    name, cells = _read_cells(raw, findings.origin)
    return _Maker(cells, findings).chart(name)


class _Maker:
    def __init__(self, cells: list[MxCell], findings: Findings) -> None:
        self._findings = findings
        self._cells: dict[str, MxCell] = {}
        self._inside: dict[str, list[MxCell]] = {}
        for cell in cells:
            self._inside.setdefault(cell.parent, []).append(cell)
            if self._cells.setdefault(cell.id, cell) is not cell:
                findings.add("name_collision", f"Two cells have the id {cell.id[:70]!r}.", cell.place)
        self._nodes: dict[str, Node] = {}

    def chart(self, name: str) -> Node:
        root = Node("", (1, 1), name=name)
        if self._findings:
            return root
        for layer in [cell for cell in self._cells.values() if cell.layer]:
            self._add_states(layer, root, 0)
        for arrow in [cell for cell in self._cells.values() if cell.arrow]:
            self._add_arrow(arrow)
        for node in root.walk():
            self._check_start(node)
        return _with_frame(root) if root.parallel else root

    def _add_states(self, cell: MxCell, node: Node, depth: int) -> None:
        if depth > MAX_DEPTH:
            refuse(self._findings.origin, "too_deep", f"Shapes are nested over {MAX_DEPTH} deep.", cell.place)
        for inner in self._inside.get(cell.id, []):
            if inner.unsupported:
                self._refuse(f"A {inner.unsupported} is not supported", inner.place)
            elif inner.state and not inner.text and not self._inside.get(inner.id):
                self._findings.add("bad_name", "This shape has no text: a state needs a name.", inner.place)
            elif inner.state:
                made = node.add(Node(inner.id, inner.place, name=inner.text or "region"))
                self._nodes[inner.id] = made
                self._add_states(inner, made, depth + 1)

    def _add_arrow(self, arrow: MxCell) -> None:
        source, target = self._cells.get(arrow.source), self._cells.get(arrow.target)
        text = " ".join([arrow.text, *(cell.text for cell in self._inside.get(arrow.id, []))]).strip()
        if source is None or target is None:
            self._refuse("This arrow is not attached to a shape at both ends: attach it", arrow.place)
        elif source.start_marker and target.id in self._nodes and not text:
            node = self._nodes[target.id]
            if node.above is not None and node.above.initial not in ("", node.id):
                self._refuse("There are two arrows from start markers", arrow.place)
            elif node.above is not None:
                node.above.initial = node.id
        elif target.end_marker and source.id in self._nodes and not text:
            self._nodes[source.id].final = True
        elif source.id not in self._nodes or target.id not in self._nodes:
            self._refuse("This arrow does not lead from state to state", arrow.place)
        elif not (events := events_of(text)):
            self._refuse(NO_EVENTS, arrow.place)
        else:
            node = self._nodes[source.id]
            node.edges.append(Edge(node, events, [target.id], arrow.place))

    def _check_start(self, node: Node) -> None:
        """Set whether the states inside a state are active together; if not, one must be the first."""
        inside = {child.id for child in node.children}
        joined = any(target in inside for child in node.children for edge in child.edges for target in edge.targets)
        node.parallel = len(inside) > 1 and all(child.children for child in node.children) and not joined
        node.parallel = node.parallel and not node.initial
        if len(inside) > 1 and not node.parallel and not node.initial:
            text = f"{node.display_name or 'The diagram'} has no start: draw an arrow from a small circle to a state."
            self._findings.add("no_start", text, node.place)

    def _refuse(self, text: str, place: Place) -> None:
        self._findings.add("not_supported", f"{text}.", place)


def _with_frame(root: Node) -> Node:
    """Return a chart whose only state is parallel, in place of a parallel root."""
    framed = Node(root.id, root.place, name=root.name)
    root.id, root.name = "(page)", "page"
    framed.add(root)
    return framed
