"""Reads Mermaid state diagrams: states, composite states, regions divided by ``--``, and labelled arrows.

The label of an arrow is the event, or several with commas between; a remark in brackets at its end is ignored.
An arrow to ``[*]`` without a label says that the procedure may end there. A state that is described as ``any state``
stands for every state next to it. A state belongs to the innermost composite state that it is named in.
"""

from __future__ import annotations

from typing import NamedTuple

from pcmrs.authoring.exchange.importing.chart import Edge, Node
from pcmrs.authoring.exchange.importing.imported import imported
from pcmrs.authoring.exchange.importing.labels import NO_EVENTS, events_of
from pcmrs.authoring.exchange.importing.mermaid_lines import Arrow, RegionLines, read_lines
from pcmrs.authoring.exchange.importing.reading import Findings, read_text
from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.finding import Finding

ANY_STATE = "any state"
"""Description of a state that stands for all states beside it."""


def from_mermaid(raw: bytes, origin: str = "mermaid") -> tuple[Blueprint | None, list[Finding]]:
    """A blueprint with the behaviour of a Mermaid ``stateDiagram-v2``.

    Args:
        raw: The file.
        origin: How findings call it.

    Returns:
        The blueprint, or None and what is not supported, each with its line and column.
    """
    return imported(raw, origin, _read)


def _read(raw: bytes, findings: Findings) -> Node:
    return _Maker(findings).chart(read_lines(read_text(raw, findings.origin), findings))


class Home(NamedTuple):
    """A region that names a state, whether the state's inside is said there, and how deep it is."""

    opened: bool
    depth: int
    region: RegionLines


class _Maker:
    """Makes the states of a diagram, then its arrows."""

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
                if homes[name].region is region:
                    self._add_states(inner, self._nodes[name], homes)
                else:
                    text = f"The state {name!r} is opened twice, in different places."
                    self._findings.say("name_collision", text, inner[0].place)

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

    def _add_arrow(self, arrow: Arrow, node: Node) -> None:
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
            self._refuse("Any state is no target", arrow)
        else:
            anywhere = self._anys.get(arrow.source)
            source = self._nodes[arrow.source] if anywhere is None else anywhere
            source.edges.append(Edge(source, events, [arrow.target], arrow.place, internal=anywhere is not None))

    def _refuse(self, text: str, arrow: Arrow) -> None:
        self._findings.say("not_supported", f"{arrow.source} --> {arrow.target}: {text}.", arrow.place)


def _find_homes(regions: list[RegionLines], depth: int, homes: dict[str, Home]) -> None:
    """Finds the region that each state is in: where its inside is said, or else the innermost that names it."""
    for region in regions:
        for name in region.named:
            home = Home(name in region.composites, depth, region)
            if name not in homes or (home.opened, home.depth) > (homes[name].opened, homes[name].depth):
                homes[name] = home
        for inner in region.composites.values():
            _find_homes(inner, depth + 1, homes)
