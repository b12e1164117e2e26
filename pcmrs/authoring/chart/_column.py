"""The states of one branch with all ports of its arrows and links, before they are placed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from pcmrs.authoring.chart._arrows import Arrow, StateRef, arrows
from pcmrs.authoring.chart._links import BranchLink
from pcmrs.authoring.chart._row import CAPTION_COLUMNS, Port, StateRow, row
from pcmrs.authoring.chart._text import flow, inner_lines
from pcmrs.fsm.blueprint import BranchSpec


@dataclass(frozen=True, slots=True)
class Lane:
    """An arrow that runs beside the boxes: the number of its lane, from the inside, and its ports."""

    arrow: Arrow
    number: int
    tails: tuple[Port, ...]
    head: Port


@dataclass(frozen=True, slots=True)
class StateColumn:
    """A branch's states from top to bottom.

    Attributes:
        rows: State to its row.
        straight: For a state, the arrow down to the next one and the lines of its caption.
        entries: Arrows from any state, with their ports at the left.
        lanes: Arrows that run beside the boxes, at the right.
        links: Ports at the left, of the links that end at a state.
    """

    rows: dict[str, StateRow]
    straight: dict[str, tuple[Arrow, list[str]]]
    entries: list[tuple[Arrow, Port]]
    lanes: list[Lane]
    links: dict[tuple[BranchLink, StateRef], Port]


def column(name: str, branch: BranchSpec, links: Iterable[BranchLink]) -> StateColumn:
    """Arrange the states of a branch.

    Args:
        name: Name of the branch.
        branch: The branch.
        links: Links of the chart; those that end at a state of this branch get ports.
    """
    drawn = arrows(name, branch)
    order = {state: number for number, state in enumerate(branch.states)}
    loops = {arrow.target: arrow.words for arrow in drawn if arrow.loops}
    rows = {
        state: row(state, meaning, inner_lines(branch, state), loops.get(state, []))
        for state, meaning in branch.states.items()
    }
    straight = {arrow.sources[0]: (arrow, caption(arrow)) for arrow in drawn if _steps_down(arrow, order)}
    entries = [(arrow, Port(arrow, caption(arrow))) for arrow in drawn if not arrow.sources]
    beside = [arrow for arrow in drawn if arrow.sources and not arrow.loops and not _steps_down(arrow, order)]
    lanes = _lanes(beside, order)
    ports = {(link, place): _link_port(link, place) for link in links for place in link.places if place.branch == name}
    _fill_left(name, rows, entries, ports)
    _fill_right(rows, lanes, order)
    return StateColumn(rows, straight, entries, lanes, ports)


def caption(arrow: Arrow) -> list[str]:
    """Return the lines of an arrow's caption."""
    return flow(arrow.words, CAPTION_COLUMNS)


def _steps_down(arrow: Arrow, order: Mapping[str, int]) -> bool:
    """Return true for an operation that leads from one state to the next in order."""
    if arrow.kind != "transition" or len(arrow.sources) != 1:
        return False
    return order[arrow.target] == order[arrow.sources[0]] + 1


def _lanes(drawn: Sequence[Arrow], order: Mapping[str, int]) -> list[Lane]:
    """Give each arrow the innermost lane that is free over its whole length, short arrows first."""
    taken: list[int] = []
    lanes = []
    for arrow in sorted(drawn, key=lambda arrow: _rows_passed(arrow, order).bit_count()):
        passed = _rows_passed(arrow, order)
        number = next((n for n, rows in enumerate(taken) if not rows & passed), len(taken))
        taken[number : number + 1] = [passed | (taken[number] if number < len(taken) else 0)]
        tails = tuple(Port(arrow, []) for _ in arrow.sources)
        lanes.append(Lane(arrow, number, tails, Port(arrow, caption(arrow))))
    return lanes


def _rows_passed(arrow: Arrow, order: Mapping[str, int]) -> int:
    """Return the rows that an arrow begins at, ends at or passes, a bit each."""
    ends = [order[state] for state in (*arrow.sources, arrow.target)]
    return (2 << max(ends)) - (1 << min(ends))


def _link_port(link: BranchLink, place: StateRef) -> Port:
    return Port(link, flow([link.label], CAPTION_COLUMNS) if place in link.heads else [])


def _fill_left(
    name: str,
    rows: dict[str, StateRow],
    entries: Iterable[tuple[Arrow, Port]],
    ports: dict[tuple[BranchLink, StateRef], Port],
) -> None:
    """Order the left ports of each state: lines from above, arrows from any state, then lines to below."""
    for from_above in (True, False):
        for (link, place), port in ports.items():
            parent = (link.heads if link.kind == "signal" else link.tails)[0].branch
            if (parent != name) is from_above:
                rows[place.state].left.append(port)
        for arrow, port in entries if from_above else []:
            rows[arrow.target].left.append(port)


def _fill_right(rows: dict[str, StateRow], lanes: Iterable[Lane], order: Mapping[str, int]) -> None:
    """Order the right ports of each state for the fewest crossings.

    Upward arrows come first, inner lanes first; then downward arrows, outer lanes first.
    """
    found: dict[str, list[tuple[int, int, Port]]] = {state: [] for state in order}
    for lane in lanes:
        ends = [*zip(lane.arrow.sources, lane.tails, strict=True), (lane.arrow.target, lane.head)]
        places = [order[state] for state, _ in ends]
        for (state, port), at in zip(ends, places, strict=True):
            up, down = at > min(places), at < max(places)
            found[state].append((down - up, lane.number if up else -lane.number, port))
    for state, ports in found.items():
        rows[state].right.extend(port for *_, port in sorted(ports, key=lambda found: found[:2]))
