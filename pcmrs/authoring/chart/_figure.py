"""Drawing of the branches that have been laid out, and of the lines between them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from xml.etree.ElementTree import Element

from pcmrs.authoring.chart._arrows import Arrow, StateRef
from pcmrs.authoring.chart._canvas import (
    HEAD,
    INK,
    box,
    bus,
    diamond,
    dot,
    group,
    head,
    line,
    loop,
    point,
    sans,
    start,
    text,
)
from pcmrs.authoring.chart._column import Lane
from pcmrs.authoring.chart._layout import Layout
from pcmrs.authoring.chart._links import BranchLink
from pcmrs.authoring.chart._panel import PAD, PITCH, START, STRAIGHT_X, TITLE, TITLE_LINE, Panel
from pcmrs.authoring.chart._row import LABEL, LINE, MEANING, NAME, Port, StateRow
from pcmrs.fsm.blueprint import Blueprint

_SHADES = ("#ffffff", "#f3f3f3")
_PLAIN = {"fill": "#ffffff", "stroke": INK, "stroke_width": "1.2"}
_CURRENT = {"fill": "#ffe08a", "stroke": INK, "stroke_width": "3.2"}


def draw_panel(parent: Element, blueprint: Blueprint, panel: Panel, current: Mapping[str, str]) -> None:
    """Draw frame, heading, states and arrows of a branch, then the branches inside it.

    Args:
        parent: Element to append them to.
        blueprint: The workflow.
        panel: Layout of the branch.
        current: States to highlight, branch to state.
    """
    branch = blueprint.branches[panel.name]
    into = group(parent, "branch", branch=panel.name, level=str(branch.level))
    shade = _SHADES[branch.level % 2]
    box(into, panel.x, panel.y, panel.width, panel.height, 8, fill=shade, stroke="#8a8a8a", stroke_width="1")
    _heading(into, panel)
    _start(into, panel)
    for lane in panel.column.lanes:
        _beside(into, panel, lane)
    for arrow, lines in panel.column.straight.values():
        _straight(into, panel, arrow, lines)
    for arrow, port in panel.column.entries:
        _entry(into, panel, arrow, port)
    for state, row in panel.column.rows.items():
        meaning = branch.states[state]
        _state(into, panel, state, row, meaning, highlighted=current.get(panel.name) == state)
    for child in panel.children:
        draw_panel(into, blueprint, child, current)


def caption(parent: Element, port: Port, x: float, anchor: str) -> None:
    """Draw the caption of a line that ends at a port, above the line.

    Args:
        parent: Element to append it to.
        port: The port.
        x: Position of the text, in px.
        anchor: Value of ``text-anchor``.
    """
    for number, words in enumerate(reversed(port.caption)):
        text(parent, x, port.y - 4 - LINE * number, words, LABEL, text_anchor=anchor)


def _start(into: Element, panel: Panel) -> None:
    first = next(iter(panel.column.rows.values()))
    start(into, panel.columns.boxes + panel.columns.box_width / 2, first.y - START, START)


def _heading(into: Element, panel: Panel) -> None:
    x, y = panel.columns.labels, panel.y + PAD
    for number, words in enumerate(panel.title):
        sans(into, x, y + TITLE_LINE * (number + 0.7), words, TITLE, font_weight="bold")
    text(into, x, y + TITLE_LINE * len(panel.title) + LABEL, panel.subtitle, LABEL, fill="#444444")


def _state(into: Element, panel: Panel, state: str, row: StateRow, meaning: str, *, highlighted: bool) -> None:
    kind = "state current" if highlighted else "state"
    drawn = group(into, kind, meaning, branch=panel.name, state=state)
    drawn.set("id", f"state-{panel.name}-{state}")
    looks = _CURRENT if highlighted else _PLAIN
    box(drawn, panel.columns.boxes, row.y, panel.columns.box_width, row.height, 9, **looks)
    middle = panel.columns.boxes + panel.columns.box_width / 2
    y = row.y + (row.height - row.text_height) / 2 + NAME - 2
    text(drawn, middle, y, row.state, NAME, text_anchor="middle", font_weight="bold")
    for words in row.meaning:
        y += LINE
        sans(drawn, middle, y + 2, words, MEANING, text_anchor="middle")
    for words in row.inner:
        y += LINE
        text(drawn, middle, y + 2, words, LABEL, text_anchor="middle")
    _loops(drawn, panel, row, y + 5)


def _loops(drawn: Element, panel: Panel, row: StateRow, y: float) -> None:
    if not row.loops:
        return
    x = panel.columns.boxes + PAD
    loop(drawn, x + 4, y + LINE - 4)
    for number, words in enumerate(row.loops):
        text(drawn, x + 14, y + LINE * (number + 1), words, LABEL)


def _beside(into: Element, panel: Panel, lane: Lane) -> None:
    drawn = _group(into, panel, lane.arrow)
    x = panel.columns.lanes + PITCH * lane.number
    edge = panel.columns.boxes + panel.columns.box_width
    ends = sorted([*((edge, tail.y) for tail in lane.tails), (edge + HEAD, lane.head.y)], key=lambda end: end[1])
    line(drawn, lane.arrow.kind, bus(x, ends))
    for inner_x, y in ends[1:-1]:
        line(drawn, lane.arrow.kind, f"M{point(inner_x, y)}L{point(x, y)}")
        dot(drawn, lane.arrow.kind, x, y)
    head(drawn, lane.arrow.kind, edge, lane.head.y, (-1, 0))
    caption(drawn, lane.head, edge + HEAD + 5, "start")


def _straight(into: Element, panel: Panel, arrow: Arrow, lines: Sequence[str]) -> None:
    drawn = _group(into, panel, arrow)
    rows = panel.column.rows
    x, top, bottom = panel.columns.boxes + STRAIGHT_X, rows[arrow.sources[0]].bottom, rows[arrow.target].y
    line(drawn, arrow.kind, f"M{point(x, top)}L{point(x, bottom - HEAD)}")
    head(drawn, arrow.kind, x, bottom, (0, 1))
    for number, words in enumerate(lines):
        y = (top + bottom) / 2 + LINE * (number - len(lines) / 2) + LABEL - 1
        text(drawn, x + 8, y, words, LABEL)


def _entry(into: Element, panel: Panel, arrow: Arrow, port: Port) -> None:
    drawn = _group(into, panel, arrow)
    begin = panel.columns.boxes - HEAD - 5 - port.width - 8
    line(drawn, arrow.kind, f"M{point(begin, port.y)}L{point(panel.columns.boxes - HEAD, port.y)}")
    diamond(drawn, arrow.kind, begin, port.y)
    head(drawn, arrow.kind, panel.columns.boxes, port.y, (1, 0))
    caption(drawn, port, panel.columns.boxes - HEAD - 5, "end")


def _group(into: Element, panel: Panel, arrow: Arrow) -> Element:
    data = {"branch": panel.name, "sources": " ".join(arrow.sources) or "*", "target": arrow.target}
    return group(into, f"arrow {arrow.kind}", " ".join(arrow.words), **data)


def draw_link(parent: Element, layout: Layout, link: BranchLink) -> None:
    """Draw a link with all its ends.

    Args:
        parent: Element to append it to.
        layout: Layout of the chart.
        link: The link.
    """
    names = {"tails": _names(link.tails), "heads": _names(link.heads)}
    drawn = group(
        parent, f"link {link.kind}", f"{names['tails']} → {link.label or 'revokes'} {names['heads']}", **names
    )
    lanes = [(owner, owner.gutter[link]) for owner in layout.panels.values() if link in owner.gutter]
    for owner, lane in lanes:
        inside = {inner.name for inner in owner.walk()}
        ends = [_end(layout, link, place) for place in link.places if place.branch in inside]
        _trunk(drawn, link, lane, ends, layout.buses.get(link))
    if link in layout.buses:
        xs = sorted(lane for _, lane in lanes)
        y = layout.buses[link]
        line(drawn, link.kind, f"M{point(xs[0], y)}L{point(xs[-1], y)}")
        for x in xs[1:-1]:
            dot(drawn, link.kind, x, y)
    for place in link.heads:
        _head(drawn, layout, link, place)


def _trunk(drawn: Element, link: BranchLink, lane: float, ends: list[tuple[float, float]], bus_y: float | None) -> None:
    """Draw the vertical part in one gutter, with the lines to its ends."""
    ends = sorted(ends, key=lambda end: end[1])
    inner = ends[1:-1]
    if bus_y is None:
        line(drawn, link.kind, bus(lane, ends))
    else:
        inner = ends[1:]
        x, y = ends[0]
        line(drawn, link.kind, f"M{point(x, y)}L{point(lane, y)}L{point(lane, bus_y)}")
    for x, y in inner:
        line(drawn, link.kind, f"M{point(x, y)}L{point(lane, y)}")
        dot(drawn, link.kind, lane, y)


def _end(layout: Layout, link: BranchLink, place: StateRef) -> tuple[float, float]:
    """Return the point where the line meets a state or a heading, short of the arrowhead if there is one."""
    x, y = _edge(layout.panels[place.branch], link, place)
    return (x - HEAD if place in link.heads else x), y


def _edge(panel: Panel, link: BranchLink, place: StateRef) -> tuple[float, float]:
    if place.state:
        return panel.columns.boxes, panel.column.links[link, place].y
    return panel.columns.labels - 4, panel.bars[link]


def _head(drawn: Element, layout: Layout, link: BranchLink, place: StateRef) -> None:
    panel = layout.panels[place.branch]
    x, y = _edge(panel, link, place)
    head(drawn, link.kind, x, y, (1, 0))
    if place.state:
        caption(drawn, panel.column.links[link, place], x - HEAD - 5, "end")


def _names(places: Iterable[StateRef]) -> str:
    return ", ".join(f"{place.branch} {place.state}".rstrip() for place in places)
