"""The state chart as one SVG picture."""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from pcmrs.authoring.chart._canvas import box, sans
from pcmrs.authoring.chart._current import check_current
from pcmrs.authoring.chart._figure import draw_link, draw_panel
from pcmrs.authoring.chart._layout import MARGIN, layout
from pcmrs.authoring.chart._legend import draw_legend, least_width
from pcmrs.authoring.chart._text import BOLD, clean, cut, sans_width
from pcmrs.fsm.blueprint import Blueprint

_TITLE = 17


def svg(blueprint: Blueprint, current: Mapping[str, str] | None = None) -> str:
    """Return the state chart of a workflow as SVG.

    Every state is a group of class ``state`` (``state current`` if highlighted) with the id
    ``state-<branch>-<state>`` and the attributes ``data-branch`` and ``data-state``.

    Args:
        blueprint: A workflow that obeys the static rules.
        current: States to highlight, branch to state.

    Returns:
        An SVG document, the same for the same arguments, which refers to nothing outside itself.

    Raises:
        ConfigurationError: `current` names an unknown branch or state, or there are too many levels.
    """
    highlighted = check_current(blueprint, current)
    arranged = layout(blueprint)
    title = cut(clean(f"{blueprint.title or blueprint.id} ({blueprint.id} {blueprint.version})"), 90)
    width = max(arranged.width, least_width() + 2 * MARGIN, BOLD * sans_width(title, _TITLE) + 2 * MARGIN)
    root = Element("svg", {"xmlns": "http://www.w3.org/2000/svg", "role": "img"})
    SubElement(root, "title").text = title
    SubElement(root, "desc").text = _description(blueprint, highlighted)
    paper = SubElement(root, "g")
    sans(root, MARGIN, MARGIN + _TITLE, title, _TITLE, font_weight="bold")
    for panel in arranged.roots:
        draw_panel(root, blueprint, panel, highlighted)
    for link in arranged.links:
        draw_link(root, arranged, link)
    height = draw_legend(root, MARGIN, arranged.bottom + 6, width - 2 * MARGIN) + MARGIN
    box(paper, 0, 0, width, height, 0, fill="#ffffff")
    size = {"width": f"{width:.0f}", "height": f"{height:.0f}", "viewBox": f"0 0 {width:.0f} {height:.0f}"}
    root.attrib.update(size)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _description(blueprint: Blueprint, current: Mapping[str, str]) -> str:
    branches = (
        f"{name} (level {branch.level}{f', refines {branch.parent.branch}' if branch.parent else ''}): "
        + ", ".join(branch.states)
        for name, branch in blueprint.branches.items()
    )
    highlighted = "; ".join(f"{name} {state}" for name, state in current.items())
    ending = f" Highlighted: {highlighted}." if highlighted else ""
    return clean(f"State chart. Branches and their states: {'; '.join(branches)}.{ending}")
