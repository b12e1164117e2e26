"""One branch in a chart, laid out in a frame.

From left to right: the gutter with the lanes of links, captions of lines from there or from any
state, the boxes, captions of arrows at their heads, the lanes of arrows. Branches that refine one of
its states are below, inside its frame and right of the gutter.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from pcmrs.authoring.chart._arrows import StateRef
from pcmrs.authoring.chart._column import StateColumn, column
from pcmrs.authoring.chart._links import BranchLink
from pcmrs.authoring.chart._row import LABEL, LINE, Port
from pcmrs.authoring.chart._text import BOLD, clean, mono_width, sans_width, widest, wrap
from pcmrs.fsm.blueprint import Blueprint, BranchSpec

PITCH = 10.0
"""Distance of neighbouring lanes in px."""

PAD = 12.0
"""Free room inside a frame in px."""

TITLE = 13
"""Font size of a branch's title in px; its subtitle has that of captions."""

STRAIGHT_X = 24.0
"""Distance of a straight arrow from the left edge of the boxes, in px."""

START = 22.0
"""Length of the arrow that marks the start, in px."""

TITLE_LINE = 16.0
"""Height of a line of a title in px."""

_GAP, _BESIDE, _INDENT = 16.0, 14.0, 8.0


class _PanelColumns(NamedTuple):
    """Positions of the parts of a panel, from left to right, in px.

    Attributes:
        labels: Captions of links and of arrows from any state; headings; frames of the branches inside.
        boxes: The states.
        box_width: Their width.
        lanes: The innermost lane of arrows.
        end: Right of all lanes.
    """

    labels: float
    boxes: float
    box_width: float
    lanes: float
    end: float


@dataclass(frozen=True, slots=True)
class Panel:
    """A branch that has been laid out; all lengths in px, in the chart's coordinates.

    Attributes:
        name: The branch.
        title: Lines of its heading.
        subtitle: Its level, and what it refines.
        column: Its states, arrows and ports, placed.
        x: Left edge of its frame.
        y: Upper edge.
        width: Width of the frame.
        height: Height of the frame.
        columns: Positions of its parts.
        gutter: Lane of each link that runs in it.
        bars: Height at which each revocation meets the heading.
        children: Branches that refine one of its states.
    """

    name: str
    title: list[str]
    subtitle: str
    column: StateColumn
    x: float
    y: float
    width: float
    height: float
    columns: _PanelColumns
    gutter: dict[BranchLink, float]
    bars: dict[BranchLink, float]
    children: list[Panel]

    def walk(self) -> list[Panel]:
        """Return this panel and all panels inside it."""
        return [self, *(inner for child in self.children for inner in child.walk())]


def panel(blueprint: Blueprint, links: Sequence[BranchLink], name: str, x: float, y: float) -> Panel:
    """Lay out a branch and those that refine it.

    Args:
        blueprint: The workflow.
        links: Links of the chart.
        name: Name of the branch.
        x: Left edge of its frame, in px.
        y: Upper edge of its frame, in px.
    """
    branch = blueprint.branches[name]
    title, subtitle = _heading(name, branch)
    here = column(name, branch, (link for link in links if link.kind != "revocation"))
    gutter = _tracks((link for link in links if _runs_in(blueprint, link, name)), x + PAD)
    bars = _tracks((link for link in links if StateRef(name, "") in link.places), y + PAD)
    columns = _columns(here, x + 2 * PAD + PITCH * len(gutter))
    bottom = _stack(here, y + PAD + max(TITLE_LINE * len(title) + LINE, PITCH * (len(bars) + 1)) + START + 4)
    children = []
    for child in blueprint.children[name]:
        children.append(panel(blueprint, links, child, columns.labels, bottom + PAD))
        bottom = children[-1].y + children[-1].height
    heading = max(mono_width(subtitle, LABEL), *(BOLD * sans_width(line, TITLE) for line in title))
    ends = (columns.end, columns.labels + heading, *(child.x + child.width for child in children))
    size = (max(ends) + PAD - x, bottom + PAD - y)
    return Panel(name, title, subtitle, here, x, y, *size, columns, gutter, bars, children)


def _tracks(links: Iterable[BranchLink], begin: float) -> dict[BranchLink, float]:
    return {link: begin + PITCH * (number + 0.5) for number, link in enumerate(links)}


def _columns(here: StateColumn, labels: float) -> _PanelColumns:
    boxes = labels + widest(port.width + _BESIDE + PAD for port in _captions(here, "left"))
    captions = (line for _, lines in here.straight.values() for line in lines)
    straight = widest(STRAIGHT_X + _INDENT + mono_width(line, LABEL) for line in captions)
    width = max(straight, widest(row.width for row in here.rows.values()))
    lanes = boxes + width + _BESIDE + PITCH + widest(port.width for port in _captions(here, "right"))
    count = max((lane.number + 1 for lane in here.lanes), default=0)
    return _PanelColumns(labels, boxes, width, lanes, lanes + PITCH * count if count else boxes + width)


def _heading(name: str, branch: BranchSpec) -> tuple[list[str], str]:
    refined = f", refines {branch.parent.branch} {branch.parent.start}" if branch.parent else ""
    return wrap(clean(branch.title) or clean(name), 40, 2), clean(f"{name}: level {branch.level}{refined}")


def _runs_in(blueprint: Blueprint, link: BranchLink, name: str) -> bool:
    """Return true if a link runs in the gutter of a branch.

    Links of Rules 2 and 3 run in the parent's gutter, revocations in those of the root branches.
    """
    if link.kind == "revocation":
        return any(name == _root(blueprint, place.branch) for place in link.places)
    return name == (link.heads if link.kind == "signal" else link.tails)[0].branch


def _root(blueprint: Blueprint, name: str) -> str:
    parent = blueprint.branches[name].parent
    return name if parent is None else _root(blueprint, parent.branch)


def _captions(here: StateColumn, side: str) -> Iterable[Port]:
    return (port for row in here.rows.values() for port in (row.left if side == "left" else row.right))


def _stack(here: StateColumn, y: float) -> float:
    """Place the rows from `y` down, with room between them for straight arrows, and return the lower edge."""
    bottom = y
    for state, row in here.rows.items():
        row.place(y)
        bottom = row.bottom
        lines = here.straight[state][1] if state in here.straight else []
        y = bottom + _GAP + LINE * len(lines)
    return bottom
