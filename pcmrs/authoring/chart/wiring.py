"""Draws the lines between branches."""

from __future__ import annotations

from collections.abc import Iterable
from xml.etree.ElementTree import Element

from pcmrs.authoring.chart.arrows import Place
from pcmrs.authoring.chart.canvas import HEAD, bus, dot, group, head, line, point
from pcmrs.authoring.chart.figure import caption
from pcmrs.authoring.chart.layout import Layout
from pcmrs.authoring.chart.links import Link
from pcmrs.authoring.chart.panel import Panel


def draw_link(parent: Element, layout: Layout, link: Link) -> None:
    """Draw a link with all its ends."""
    names = {"tails": _names(link.tails), "heads": _names(link.heads)}
    drawn = group(
        parent, f"link {link.kind}", f"{names['tails']} → {link.label or 'revokes'} {names['heads']}", **names
    )
    lanes = [(owner, owner.gutter[link]) for owner in layout.panels.values() if link in owner.gutter]
    for owner, lane in lanes:
        inside = {inner.name for inner in owner.everything()}
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


def _trunk(drawn: Element, link: Link, lane: float, ends: list[tuple[float, float]], bus_y: float | None) -> None:
    """The vertical part in one gutter, with the lines to its ends."""
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


def _end(layout: Layout, link: Link, place: Place) -> tuple[float, float]:
    """Where the line meets a state or a heading; short of the arrowhead, if there is one."""
    x, y = _edge(layout.panels[place.branch], link, place)
    return (x - HEAD if place in link.heads else x), y


def _edge(panel: Panel, link: Link, place: Place) -> tuple[float, float]:
    if place.state:
        return panel.across.boxes, panel.column.links[link, place].y
    return panel.across.labels - 4, panel.bars[link]


def _head(drawn: Element, layout: Layout, link: Link, place: Place) -> None:
    panel = layout.panels[place.branch]
    x, y = _edge(panel, link, place)
    head(drawn, link.kind, x, y, (1, 0))
    if place.state:
        caption(drawn, panel.column.links[link, place], x - HEAD - 5, "end")


def _names(places: Iterable[Place]) -> str:
    return ", ".join(f"{place.branch} {place.state}".rstrip() for place in places)
