"""Writes a workflow as SCXML, the W3C's notation of state charts, for other tools to execute or draw.

One parallel region per branch, a branch that refines one state of its parent inside that state. States are
``branch.state``. Events are ``branch.operation``, or ``branch.operation.outcome`` where it can end in several ways;
``done`` is the outcome of an operation that declares none. In an imported workflow events keep their names. A
transition without target is an operation that is accepted and keeps the state. A timer is a delayed event that is sent
when its state is entered and cancelled when that is left. Checks, steps and roles are not part
of the chart, activities a comment in it: processors refuse an ``<invoke>`` that they do not know. The provenance of a
drafted workflow is an element of `PROVENANCE_NAMESPACE`, which `pcmrs fsm import` reads again.
"""

from __future__ import annotations

from collections import defaultdict
from xml.etree.ElementTree import Comment, Element, SubElement, indent, tostring

import msgspec

from pcmrs.authoring.exchange import PROVENANCE_NAMESPACE, SCXML_NAMESPACE
from pcmrs.authoring.exchange._cubes import Cube
from pcmrs.authoring.exchange.exporting._nesting import Nesting, nesting_of
from pcmrs.authoring.exchange.exporting._reactions import Reaction, reactions
from pcmrs.authoring.exchange.exporting._scxml_timers import ScxmlTimers
from pcmrs.fsm.blueprint import Blueprint

__all__ = ["scxml"]

PARALLEL = "joint-state"
"""Id of the state of all regions; the hyphen keeps it apart from every name in a blueprint."""


def scxml(blueprint: Blueprint) -> str:
    """Return the workflow as an SCXML document.

    Args:
        blueprint: A sound workflow, see `pcmrs.fsm.verify`.

    Raises:
        BlueprintError: So many branches depend on each other that the conditions cannot be written out.
    """
    writer = _Writer(blueprint, nesting_of(blueprint))
    root = Element("scxml", xmlns=SCXML_NAMESPACE)
    roots = [name for name in blueprint.branches if name not in writer.nesting.nested]
    root.attrib.update({"version": "1.0", "name": blueprint.id, "datamodel": "ecmascript"})
    root.set("initial", PARALLEL if len(roots) > 1 else roots[0])
    if blueprint.provenance is not msgspec.UNSET:
        origin = msgspec.structs.asdict(blueprint.provenance)
        SubElement(root, "pcmrs:provenance", {"xmlns:pcmrs": PROVENANCE_NAMESPACE, **origin})
    above = SubElement(root, "parallel", id=PARALLEL) if len(roots) > 1 else root
    for name in roots:
        writer.write_branch(above, name)
    indent(root)
    return tostring(root, encoding="unicode") + "\n"


class _Writer:
    def __init__(self, blueprint: Blueprint, nesting: Nesting) -> None:
        self.nesting = nesting
        self._branches = blueprint.branches
        self._timers = ScxmlTimers(blueprint)
        self._reactions: dict[tuple[str, str], list[Reaction]] = defaultdict(list)
        for reaction in reactions(blueprint, nesting):
            self._reactions[reaction.branch, reaction.source].append(reaction)

    def write_branch(self, above: Element, branch: str) -> None:
        """Add a region; within it its states, and within these the branches that refine them."""
        spec = self._branches[branch]
        region = SubElement(above, "state", id=branch, initial=_id(branch, spec.start))
        for state in spec.states:
            inside = self.nesting.inside(branch, state)
            kind = "parallel" if len(inside) > 1 else "state"
            element = SubElement(region, kind, id=_id(branch, state))
            if activity := spec.activities.get(state):
                element.append(Comment(f" do / {activity.run}; at its end {branch}.{activity.ended} "))
            self._timers.write_state(element, branch, state)
            for reaction in self._reactions[branch, state]:
                self._write_transition(element, reaction)
            for child in inside:
                self.write_branch(element, child)

    def _write_transition(self, above: Element, reaction: Reaction) -> None:
        transition = SubElement(above, "transition", event=reaction.event)
        if reaction.guard:
            transition.set("cond", self._condition(reaction.guard))
        if reaction.entered:
            transition.set("target", " ".join(_id(branch, state) for branch, state in reaction.entered))
        self._timers.write_transition(transition, reaction)

    def _condition(self, guard: Cube) -> str:
        parts = [self._in_one_of(branch, guard[branch]) for branch in self._branches if branch in guard]
        alternatives = [" || ".join(part) for part in parts]
        if len(parts) == 1:
            return alternatives[0]
        return " && ".join(f"({text})" if "||" in text else text for text in alternatives)

    def _in_one_of(self, branch: str, allowed: frozenset[str]) -> list[str]:
        """Return predicates of which one must hold. A nested branch is at its start also outside its parent's state."""
        predicates = [f"In('{_id(branch, state)}')" for state in self._branches[branch].states if state in allowed]
        if self._branches[branch].start in allowed:
            for outer in self.nesting.around(branch):
                inner = self._branches[branch].parent
                home = inner.start if inner is not None else ""
                states = self._branches[outer].states
                predicates += [f"In('{_id(outer, state)}')" for state in states if state != home]
                branch = outer
        return predicates


def _id(branch: str, state: str) -> str:
    return f"{branch}.{state}"
