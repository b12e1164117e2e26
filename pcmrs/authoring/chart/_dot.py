"""The state chart as Graphviz text, with a cluster per branch, nested by level."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping

from pcmrs.authoring.chart._arrows import Kind, StateRef, edges
from pcmrs.authoring.chart._canvas import STROKES
from pcmrs.authoring.chart._current import check_current
from pcmrs.authoring.chart._links import BranchLink, links
from pcmrs.authoring.chart._text import clean, inner_lines
from pcmrs.fsm.blueprint import Blueprint

_HEADER = """digraph {id} {{
  compound=true; rankdir=TB; fontname="Helvetica"; label={title}; labelloc=t;
  node [shape=box, style="rounded,filled", fillcolor=white, fontname="Helvetica", fontsize=11];
  edge [fontname="Courier", fontsize=9];"""


def dot(blueprint: Blueprint, current: Mapping[str, str] | None = None) -> str:
    """Return the state chart as Graphviz text.

    Args:
        blueprint: A workflow that obeys the static rules.
        current: States to highlight, branch to state.

    Raises:
        ConfigurationError: `current` names an unknown branch or state, or there are too many levels.
    """
    highlighted = check_current(blueprint, current)
    lines = [_HEADER.format(id=_quoted(blueprint.id), title=_quoted(blueprint.title or blueprint.id))]
    for name in blueprint.roots:
        lines += (f"  {line}" for line in _cluster(blueprint, name, highlighted))
    for link in links(blueprint):
        lines += (f"  {line}" for line in _link(blueprint, link))
    return "\n".join([*lines, "}", ""])


def _cluster(blueprint: Blueprint, name: str, current: Mapping[str, str]) -> Iterator[str]:
    branch = blueprint.branches[name]
    yield f"subgraph {_quoted(f'cluster_{name}')} {{"
    yield f"  label={_quoted(branch.title or name)};"
    yield f"  {_mark(name, 'start')} [shape=point, fillcolor=black, width=0.12];"
    for state, meaning in branch.states.items():
        looks = ', fillcolor="#ffe08a", penwidth=3' if current.get(name) == state else ""
        label = _quoted(state, meaning, *inner_lines(branch, state))
        yield f"  {_node(StateRef(name, state))} [label={label}{looks}];"
    yield f"  {_mark(name, 'start')} -> {_node(StateRef(name, branch.start))};"
    drawn = edges(name, branch)
    if not all(edge.sources for edge in drawn):
        yield f"  {_mark(name, 'any')} [shape=diamond, label=any, fontsize=9];"
    for edge in drawn:
        begin = _node(StateRef(name, edge.sources[0])) if edge.sources else _mark(name, "any")
        looks = f"label={_quoted(' '.join(edge.words))}, {_style(edge.kind)}"
        yield f"  {begin} -> {_node(StateRef(name, edge.target))} [{looks}];"
    for child in blueprint.children[name]:
        yield from (f"  {line}" for line in _cluster(blueprint, child, current))
    yield "}"


def _link(blueprint: Blueprint, link: BranchLink) -> Iterator[str]:
    looks = f"label={_quoted(link.label or 'revokes')}, {_style(link.kind)}"
    for tail, head in itertools.product(link.tails, link.heads):
        begin, end = (_node(StateRef(p.branch, p.state or blueprint.branches[p.branch].start)) for p in (tail, head))
        apart = not {tail.branch, head.branch} & {*_above(blueprint, tail), *_above(blueprint, head)}
        ends = (("ltail", tail), ("lhead", head)) if apart else ()  # no edge from a frame into the same frame
        whole = (f", {key}={_quoted(f'cluster_{place.branch}')}" for key, place in ends if not place.state)
        yield f"{begin} -> {end} [{looks}{''.join(whole)}];"


def _above(blueprint: Blueprint, place: StateRef) -> Iterator[str]:
    parent = blueprint.branches[place.branch].parent
    while parent is not None:
        yield parent.branch
        parent = blueprint.branches[parent.branch].parent


def _style(kind: Kind) -> str:
    stroke = STROKES[kind]
    style = {"transition": "solid", "failure": "dashed", "signal": "dotted"}.get(kind, "bold")
    tip = "normal" if stroke.filled else "empty"
    return f'class={kind}, color="{stroke.colour}", style={style}, arrowhead={tip}'


def _node(place: StateRef) -> str:
    return _quoted(f"{place.branch}.{place.state}")


def _mark(name: str, what: str) -> str:
    return _quoted(f"{name} {what}")


def _quoted(*lines: str) -> str:
    """Return a quoted string of lines, centred."""
    escaped = (clean(line).replace("\\", "\\\\").replace('"', '\\"') for line in lines if line)
    return '"' + "\\n".join(escaped) + '"'
