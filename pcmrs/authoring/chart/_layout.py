"""Layout of the whole chart: root branches side by side, the lines of revocations below them."""

from __future__ import annotations

from dataclasses import dataclass

from pcmrs.authoring.chart._links import BranchLink, links
from pcmrs.authoring.chart._panel import PITCH, Panel, panel
from pcmrs.fsm.blueprint import Blueprint

MARGIN = 16.0
"""Free room around the chart and between root branches, in px."""

HEADING = 34.0
"""Height of the chart's title in px."""


@dataclass(frozen=True, slots=True)
class Layout:
    """A chart that has been laid out; lengths in px.

    Attributes:
        panels: Every branch by name, outer ones first.
        roots: The branches of level 1.
        links: Lines between branches.
        buses: Height of each revocation's line below the branches.
        width: Width of all branches.
        bottom: Lower edge of the drawing.
    """

    panels: dict[str, Panel]
    roots: list[Panel]
    links: list[BranchLink]
    buses: dict[BranchLink, float]
    width: float
    bottom: float


def layout(blueprint: Blueprint) -> Layout:
    """Lay out all branches and the lines between them."""
    joined = links(blueprint)
    x = MARGIN
    roots = []
    for name in blueprint.roots:
        roots.append(panel(blueprint, joined, name, x, HEADING + MARGIN))
        x += roots[-1].width + MARGIN
    panels = {inner.name: inner for root in roots for inner in root.walk()}
    crossing = [link for link in joined if sum(link in root.gutter for root in roots) > 1]
    lowest = max(root.y + root.height for root in roots)
    buses = {link: lowest + PITCH * (number + 1) for number, link in enumerate(crossing)}
    return Layout(panels, roots, joined, buses, x, lowest + PITCH * (len(buses) + 1))
