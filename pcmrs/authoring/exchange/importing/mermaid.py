"""Reads Mermaid state diagrams: states, composite states, regions divided by ``--``, and labelled arrows.

The label of an arrow is the event, or several with commas between; a remark in brackets at its end is ignored.
An arrow to ``[*]`` without a label says that the procedure may end there. A state that is described as ``any state``
stands for every state next to it. A state belongs to the innermost composite state that it is named in.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from pcmrs.authoring.exchange.importing._chart import Edge, Node
from pcmrs.authoring.exchange.importing._reading import MAX_DEPTH, NO_EVENTS, Findings, events_of, read_text
from pcmrs.authoring.exchange.importing.imported import import_chart
from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.finding import Finding, Place, refuse

NAME = r"(?:\[\*\]|[\w.-]+?)(?: ?:::\w+)?"
HEADER = re.compile(r"stateDiagram(-v2)?")
ARROW = re.compile(rf"(?P<source>{NAME}) ?--> ?(?P<target>{NAME}) ?(?::(?P<label>.*))?")
PSEUDO = re.compile(r"state (?P<name>\S+) ?(?:<<|\[\[)(?P<kind>\w+).*")
STATE = re.compile(rf'state (?:"(?P<text>[^"]*)" as )?(?P<name>{NAME}) ?(?P<open>\{{)?')
DESCRIPTION = re.compile(rf"(?P<name>{NAME}) ?: ?(?P<text>.*)")
NOTE = re.compile(r"note (?:left|right) of \S+ ?(?P<inline>:.*)?")
IGNORED = re.compile(r"(?:direction|classDef|class|style|click|accTitle|accDescr|scale|hide|title|linkStyle)\b.*")
ENTITY = re.compile(r"#(\d{1,6});")


@dataclass(frozen=True, slots=True)
class TransitionLine:
    """``source --> target : label``."""

    source: str
    target: str
    label: str
    place: Place


@dataclass(slots=True, eq=False)
class RegionLines:
    """Statements in one region of a composite state, or of the diagram.

    Attributes:
        place: Its place in the file.
        named: States named in it, with their first places.
        described: Descriptions of some of them.
        composites: Regions inside some of them.
        arrows: Arrows in the order of the file.
    """

    place: Place
    named: dict[str, Place] = field(default_factory=dict)
    described: dict[str, str] = field(default_factory=dict)
    composites: dict[str, list[RegionLines]] = field(default_factory=dict)
    arrows: list[TransitionLine] = field(default_factory=list)


def read_lines(text: str, findings: Findings) -> list[RegionLines]:
    """Return the regions of a diagram.

    Args:
        text: The file.
        findings: Collects unsupported elements.

    Raises:
        BlueprintError: It is not a state diagram, its braces do not match, or it is too deep.
    """
    reader = _Lines(findings)
    lines = _statements(text)
    header, place = next(lines, ("", (1, 1)))
    if not HEADER.fullmatch(header):
        refuse(findings.origin, "not_mermaid", "A Mermaid state diagram begins with stateDiagram-v2.", place)
    for line, place in lines:
        reader.take(line, place)
    if len(reader.open) > 1:
        text = "This composite state is not closed: a } is missing."
        refuse(findings.origin, "not_mermaid", text, reader.open[-1][0].place)
    return reader.open[0]


def _statements(text: str) -> Iterator[tuple[str, Place]]:
    """Return the lines without comments, front matter and notes, in single spaces."""
    skipped_until = ""
    for number, line in enumerate(text.splitlines(), 1):
        words = " ".join(line.partition("%%")[0].split()).removesuffix(";").rstrip()
        if skipped_until:
            skipped_until = "" if words == skipped_until else skipped_until
        elif number == 1 and words == "---":
            skipped_until = "---"
        elif (note := NOTE.fullmatch(words)) or words == "accDescr {":
            skipped_until = ("" if note["inline"] else "end note") if note else "}"
        elif words:
            yield words, (number, len(line) - len(line.lstrip()) + 1)


class _Lines:
    """Reader of statements; `open` has the regions of every composite state that is open, from the outermost."""

    def __init__(self, findings: Findings) -> None:
        self._findings = findings
        self.open: list[list[RegionLines]] = [[RegionLines((1, 1))]]

    def take(self, line: str, place: Place) -> None:
        region = self.open[-1][-1]
        if line == "}" and len(self.open) > 1:
            self.open.pop()
        elif line == "--":
            self.open[-1].append(RegionLines(place))
        elif arrow := ARROW.fullmatch(line):
            self._arrow(region, arrow, place)
        elif pseudo := PSEUDO.fullmatch(line):
            self._findings.add("not_supported", f"{pseudo['name']}: a {pseudo['kind']} is not supported.", place)
        elif state := STATE.fullmatch(line):
            self._state(region, state, place)
        elif IGNORED.fullmatch(line):
            return
        elif described := DESCRIPTION.fullmatch(line):
            name = self._name(region, described["name"], place)
            region.described[name] = _plain(described["text"])
        elif re.fullmatch(NAME, line):
            self._name(region, line, place)
        else:
            refuse(self._findings.origin, "not_mermaid", f"Not a line of a state diagram: {line[:60]!r}.", place)

    def _arrow(self, region: RegionLines, found: re.Match[str], place: Place) -> None:
        source, target = (self._name(region, found[end], place) for end in ("source", "target"))
        region.arrows.append(TransitionLine(source, target, _plain(found["label"] or ""), place))

    def _state(self, region: RegionLines, found: re.Match[str], place: Place) -> None:
        name = self._name(region, found["name"], place)
        if found["text"] is not None:
            region.described[name] = _plain(found["text"])
        if found["open"]:
            if len(self.open) > MAX_DEPTH:
                text = f"Composite states are nested over {MAX_DEPTH} deep."
                refuse(self._findings.origin, "too_deep", text, place)
            self.open.append(region.composites.setdefault(name, [RegionLines(place)]))

    def _name(self, region: RegionLines, word: str, place: Place) -> str:
        name = word.partition(":::")[0].strip()
        if name != "[*]":
            region.named.setdefault(name, place)
        return name


def _plain(text: str) -> str:
    """Return text with its entity codes resolved."""
    return ENTITY.sub(lambda found: chr(min(int(found[1]), 0xFFFD)), text).strip()


ANY_STATE = "any state"
"""Description of a state that stands for all states beside it."""


def from_mermaid(raw: bytes, origin: str = "mermaid") -> tuple[Blueprint | None, list[Finding]]:
    """Return a blueprint with the behaviour of a Mermaid ``stateDiagram-v2``.

    Args:
        raw: The file.
        origin: Name of the file in findings.

    Returns:
        The blueprint, or None and the unsupported elements, each with its line and column.
    """
    return import_chart(raw, origin, _read)


def _read(raw: bytes, findings: Findings) -> Node:
    return _Maker(findings).chart(read_lines(read_text(raw, findings.origin), findings))


class Home(NamedTuple):
    """A region that names a state, whether the state's inside is said there, and how deep it is."""

    opened: bool
    depth: int
    region: RegionLines


class _Maker:
    """Builder of the states of a diagram, then of its arrows."""

    def __init__(self, findings: Findings) -> None:
        self._findings = findings
        self._nodes: dict[str, Node] = {}
        self._anys: dict[str, Node] = {}
        self._made: dict[RegionLines, Node] = {}

    def chart(self, regions: list[RegionLines]) -> Node:
        root = Node("", (1, 1))
        homes: dict[str, Home] = {}
        _find_homes(regions, 0, homes)
        self._add_states(regions, root, homes)
        if not self._findings:
            self._add_arrows(regions)
        return root

    def _add_states(self, regions: list[RegionLines], node: Node, homes: dict[str, Home]) -> None:
        if len(regions) > 1 and node.above is None:
            node = node.add(Node("regions", node.place))
        node.parallel = len(regions) > 1
        for number, region in enumerate(regions, 1):
            inside = node.add(Node(f"{node.id}.{number}", region.place)) if node.parallel else node
            self._made[region] = inside
            for name, place in region.named.items():
                if homes[name].region is region:
                    self._add_state(region, inside, Node(name, place, title=region.described.get(name, "")))
            for name, inner in region.composites.items():
                if name not in homes:
                    text = f"{name} is the start or the end, which has no inside: give the state a name."
                    self._findings.add("not_supported", text, inner[0].place)
                elif homes[name].region is region:
                    self._add_states(inner, self._nodes[name], homes)
                else:
                    text = f"The state {name!r} is opened twice, in different regions."
                    self._findings.add("name_collision", text, inner[0].place)

    def _add_state(self, region: RegionLines, above: Node, node: Node) -> None:
        if node.title == ANY_STATE and node.id not in region.composites:
            self._anys[node.id] = above
        else:
            self._nodes[node.id] = above.add(node)

    def _add_arrows(self, regions: list[RegionLines]) -> None:
        for region in regions:
            for arrow in region.arrows:
                self._add_arrow(arrow, self._made[region])
            for inner in region.composites.values():
                self._add_arrows(inner)

    def _add_arrow(self, arrow: TransitionLine, node: Node) -> None:
        events = events_of(arrow.label)
        if arrow.source == "[*]":
            node.initial = node.initial or arrow.target
            if node.initial != arrow.target or events:
                self._refuse("A start has one arrow, without a label", arrow)
        elif arrow.target == "[*]" and not events and arrow.source in self._nodes:
            self._nodes[arrow.source].final = True
        elif arrow.target == "[*]":
            self._refuse("An event that ends everything is not supported: draw a state for it", arrow)
        elif not events:
            self._refuse(NO_EVENTS, arrow)
        elif arrow.target in self._anys:
            self._refuse("Any state cannot be a target", arrow)
        else:
            anywhere = self._anys.get(arrow.source)
            source = self._nodes[arrow.source] if anywhere is None else anywhere
            source.edges.append(Edge(source, events, [arrow.target], arrow.place, internal=anywhere is not None))

    def _refuse(self, text: str, arrow: TransitionLine) -> None:
        self._findings.add("not_supported", f"{arrow.source} --> {arrow.target}: {text}.", arrow.place)


def _find_homes(regions: list[RegionLines], depth: int, homes: dict[str, Home]) -> None:
    """Find the region of each state: the one that says its inside, or else the innermost that names it."""
    for region in regions:
        for name in region.named:
            home = Home(name in region.composites, depth, region)
            if name not in homes or (home.opened, home.depth) > (homes[name].opened, homes[name].depth):
                homes[name] = home
        for inner in region.composites.values():
            _find_homes(inner, depth + 1, homes)
