"""Reads SCXML: flat, nested and parallel states, finals, initials and transitions on events.

Conditions may name active states. An event that is sent with a delay when a state is entered, and cancelled when that
state is left, is a timer. Everything else in SCXML, above all executable content, gives a finding: a
blueprint holds no code.
"""

from __future__ import annotations

import msgspec

from pcmrs.authoring.exchange import PROVENANCE_NAMESPACE, SCXML_NAMESPACE
from pcmrs.authoring.exchange.importing._chart import Edge, Node
from pcmrs.authoring.exchange.importing._conditions import read_condition
from pcmrs.authoring.exchange.importing._delays import cancelled, delayed_events, restarts
from pcmrs.authoring.exchange.importing._markup import Element, read_xml
from pcmrs.authoring.exchange.importing._reading import Findings
from pcmrs.authoring.exchange.importing.imported import import_chart
from pcmrs.fsm.blueprint import Blueprint, ProvenanceSpec
from pcmrs.fsm.finding import Finding, Place, refuse

STATES = frozenset({"state", "parallel", "final"})


def from_scxml(raw: bytes, origin: str = "scxml") -> tuple[Blueprint | None, list[Finding]]:
    """Return a blueprint with the behaviour of an SCXML document.

    Args:
        raw: The file.
        origin: Name of the file in findings.

    Returns:
        The blueprint, or None and the unsupported elements, each with its line and column.
    """
    return import_chart(raw, origin, _read)


def _read(raw: bytes, findings: Findings) -> Node:
    document = read_xml(raw, findings.origin)
    if document.name != "scxml":
        text = f"The root element is {document.name}; an SCXML document begins with scxml."
        refuse(findings.origin, "not_scxml", text, document.place)
    return _Reader(findings).read(document)


class _Reader:
    def __init__(self, findings: Findings) -> None:
        self._findings = findings

    def read(self, document: Element) -> Node:
        root = Node(document.attributes.get("name", ""), document.place)
        self._read_provenance(document, root)
        self._read_inside(document, root)
        if any(node.final for node in root.walk()):
            for edge in (edge for node in root.walk() for edge in node.edges if "done" in edge.events):
                self._refuse("The event done would also be raised by final states: rename it", edge.place)
        return root

    def _read_provenance(self, document: Element, root: Node) -> None:
        """Read how the workflow was drafted, wherever an editor has put it.

        A draft must not lose its provenance: what cannot be read is a finding.
        """
        for element in document.walk():
            if element.namespace == PROVENANCE_NAMESPACE:
                try:
                    root.provenance = msgspec.convert(element.attributes, ProvenanceSpec)
                except msgspec.ValidationError as error:
                    self._refuse(f"The provenance of this draft cannot be read ({error}): restore it", element.place)

    def _read_inside(self, element: Element, node: Node) -> None:
        node.initial = element.attributes.get("initial", "")
        ended: list[str] = []
        for child in element.children:
            if child.namespace not in ("", SCXML_NAMESPACE):
                continue
            if child.name in STATES:
                self._read_state(child, node)
            elif child.name == "transition":
                self._read_transition(child, node)
            elif child.name == "onentry" and node.above is not None:
                node.delayed += delayed_events(child, self._refuse)
            elif child.name == "onexit" and node.above is not None:
                ended += cancelled(child, self._refuse)
            elif child.name == "initial":
                inner = child.every("transition")
                node.initial = inner[0].attributes.get("target", "") if inner else ""
                self._refuse_contents(inner[0] if inner else child)
            else:
                self._refuse(f"<{child.name}> is not supported", child.place)
        if sorted(ended) != sorted(each.id for each in node.delayed):
            text = "A delayed event must be cancelled, by its id, in the onexit of the state that sends it"
            self._refuse(text, element.place)

    def _read_state(self, element: Element, above: Node) -> None:
        name = element.attributes.get("id", "")
        if not name:
            self._findings.add("bad_name", f"This {element.name} has no id: give it one.", element.place)
        node = above.add(Node(name, element.place, parallel=element.name == "parallel", final=element.name == "final"))
        self._read_inside(element, node)
        if node.final and (node.edges or node.children or node.delayed):
            self._refuse("A final state with contents or transitions is not supported", element.place)
        node.parallel = node.parallel and bool(node.children)

    def _read_transition(self, element: Element, node: Node) -> None:
        given = element.attributes
        condition = read_condition(given["cond"]) if "cond" in given else ()
        if condition is None:
            self._refuse("This cond is not supported: only In('state'), with && and ||, says `requires`", element.place)
        events = [event.removesuffix("*").rstrip(".") for event in given.get("event", "").split()]
        if not events:
            self._refuse("A transition without event is not supported", element.place)
        for event in events:
            if not event or event.startswith(("done.", "error.")):
                self._refuse(
                    f"The event {event or '*'} is not supported: name an action of a user or device", element.place
                )
        targets = given.get("target", "").split()
        internal = given.get("type") == "internal"
        again = restarts(element, self._refuse)
        node.edges.append(Edge(node, events, targets, element.place, internal, condition or (), again))

    def _refuse_contents(self, element: Element) -> None:
        for child in element.children:
            self._refuse(f"<{child.name}> is not supported", child.place)

    def _refuse(self, text: str, place: Place) -> None:
        self._findings.add("not_supported", f"{text}.", place)
