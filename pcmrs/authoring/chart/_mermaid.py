"""The state chart as Mermaid ``stateDiagram-v2`` text: branches are composite states side by side.

Mermaid draws no arrows between the inner states of different composite states, so Rules 2 and 3
are notes, and so are activities and timers. Capital letters in its names keep them apart from those of the workflow.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping

from pcmrs.authoring.chart._arrows import StateRef, edges
from pcmrs.authoring.chart._current import check_current
from pcmrs.authoring.chart._links import BranchLink, links
from pcmrs.authoring.chart._text import clean, inner_lines
from pcmrs.fsm.blueprint import Blueprint

_SPECIAL = re.compile(r"[^\w ,.()/=*+-]")


def mermaid(blueprint: Blueprint, current: Mapping[str, str] | None = None) -> str:
    """Return the state chart as Mermaid text.

    Args:
        blueprint: A workflow that obeys the static rules.
        current: States to highlight, branch to state.

    Raises:
        ConfigurationError: `current` names an unknown branch or state, or there are too many levels.
    """
    highlighted = check_current(blueprint, current)
    regions = _regions(list(_composite(blueprint, name)) for name in blueprint.roots)
    lines = [f'state "{_escaped(blueprint.title or blueprint.id)}" as WORKFLOW {{', *_indented(regions), "}"]
    lines += ["classDef current fill:#ffe08a,stroke:#1a1a1a,stroke-width:3px"]
    lines += [f"class {_id(StateRef(name, state))} current" for name, state in highlighted.items()]
    return "\n".join(["stateDiagram-v2", *_indented(lines), ""])


def _composite(blueprint: Blueprint, name: str) -> Iterator[str]:
    branch = blueprint.branches[name]
    yield f'state "{_escaped(branch.title or name)}" as {name} {{'
    children = (list(_composite(blueprint, child)) for child in blueprint.children[name])
    yield from _indented(_regions([list(_states(blueprint, name)), *children]))
    yield "}"


def _states(blueprint: Blueprint, name: str) -> Iterator[str]:
    branch = blueprint.branches[name]
    for state, meaning in branch.states.items():
        label = f"{state} ({meaning})" if meaning else state
        yield f'state "{_escaped(label)}" as {_id(StateRef(name, state))}'
        for line in inner_lines(branch, state):
            yield f"note right of {_id(StateRef(name, state))} : {_escaped(line)}"
    drawn = edges(name, branch)
    if not all(edge.sources for edge in drawn):
        yield f'state "any state" as {name}_ANY'
    yield f"[*] --> {_id(StateRef(name, branch.start))}"
    for edge in drawn:
        begin = _id(StateRef(name, edge.sources[0])) if edge.sources else f"{name}_ANY"
        yield f"{begin} --> {_id(StateRef(name, edge.target))} : {_escaped(' '.join(edge.words))}"
    for link in links(blueprint):
        yield from _notes(link, name)


def _notes(link: BranchLink, name: str) -> Iterator[str]:
    """Return the notes of a link at its beginnings in this branch; a revocation needs none, since it has an arrow."""
    heads = ", ".join(f"{place.branch} {place.state}" for place in link.heads)
    texts = {"signal": f"Rule 2, calls {link.label} ({heads})", "call": f"Rule 3, calls {link.label} ({heads})"}
    for place in link.tails:
        if place.branch == name and place.state:
            yield f"note right of {_id(place)} : {_escaped(texts[link.kind])}"


def _regions(parts: Iterable[list[str]]) -> Iterator[str]:
    for number, part in enumerate(parts):
        if number:
            yield "--"
        yield from part


def _indented(lines: Iterable[str]) -> Iterator[str]:
    return (f"  {line}" for line in lines)


def _id(place: StateRef) -> str:
    return f"{place.branch}_IS_{place.state}"


def _escaped(text: str) -> str:
    """Return the text with every character that has a meaning in Mermaid as an entity code."""
    return _SPECIAL.sub(lambda found: f"#{ord(found[0])};", clean(text))
