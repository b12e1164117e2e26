"""Reads XML as a tree that knows its lines and columns, and refuses input that could occupy a parser without end."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any
from xml.parsers import expat

from pcmrs.authoring.exchange.importing._reading import MAX_DEPTH
from pcmrs.fsm.files.toml import check_size
from pcmrs.fsm.finding import Place, refuse


@dataclass(slots=True)
class Element:
    """One element: its namespace and name, its attributes without theirs, and where it begins, counted from 1."""

    namespace: str
    name: str
    attributes: dict[str, str]
    place: Place
    text: str = ""
    children: list[Element] = field(default_factory=list)

    def walk(self) -> Iterator[Element]:
        """Yield the element and all below it, each before its children."""
        yield self
        for child in self.children:
            yield from child.walk()

    def every(self, name: str) -> list[Element]:
        """Return its children of that name."""
        return [child for child in self.children if child.name == name]


def read_xml(raw: bytes, origin: str) -> Element:
    """Return the root element of an XML file.

    Args:
        raw: The file.
        origin: Name of the file in findings.

    Raises:
        BlueprintError: It is not XML, too large or too deep, or declares a document type: entities are not read.
    """
    check_size(raw, origin)
    return _Builder(origin).read(raw)


class _Builder:
    """Target of the parser's events that keeps the elements that are open."""

    def __init__(self, origin: str) -> None:
        self._origin = origin
        self._open = [Element("", "", {}, (1, 1))]
        self._parser = expat.ParserCreate(namespace_separator=" ")
        self._parser.buffer_text = True
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.CharacterDataHandler = self._characters
        self._parser.StartDoctypeDeclHandler = self._doctype

    def read(self, raw: bytes) -> Element:
        try:
            self._parser.Parse(raw, True)
        except expat.ExpatError as error:
            text = f"Not XML: {expat.ErrorString(error.code)}."
            refuse(self._origin, "not_xml", text, (error.lineno, error.offset + 1))
        except (ValueError, LookupError):  # raised by the parser for an unknown encoding
            refuse(self._origin, "not_xml", "The encoding of this XML cannot be read: use UTF-8.", (1, 1))
        return self._open[0].children[0]

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        place = self._place()
        if len(self._open) > MAX_DEPTH:
            refuse(self._origin, "too_deep", f"Elements are nested deeper than {MAX_DEPTH}.", place)
        plain = {key.rpartition(" ")[2]: value for key, value in attributes.items()}
        namespace, _, local = name.rpartition(" ")
        element = Element(namespace, local, plain, place)
        self._open[-1].children.append(element)
        self._open.append(element)

    def _end(self, _name: str) -> None:
        self._open.pop()

    def _characters(self, text: str) -> None:
        self._open[-1].text += text

    def _doctype(self, *_declaration: Any) -> None:
        refuse(self._origin, "not_supported", "A document type (DTD) is not read: remove it.", self._place())

    def _place(self) -> Place:
        return self._parser.CurrentLineNumber, self._parser.CurrentColumnNumber + 1
