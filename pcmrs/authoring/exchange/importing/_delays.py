"""Reads delayed events of SCXML: ``<send>`` with a delay, and ``<cancel>``. All other executable content is refused."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence

from pcmrs.authoring.exchange.importing._chart import DelayedEvent, Restart
from pcmrs.authoring.exchange.importing._conditions import read_condition
from pcmrs.authoring.exchange.importing._markup import Element
from pcmrs.fsm.finding import Place

Refuse = Callable[[str, Place], None]
"""Reports an element that is not supported: (text, place)."""

_TIME = re.compile(r"(\d+(?:\.\d+)?|\.\d+)(ms|s)")
_UNITS = {"s": 1.0, "ms": 0.001}
_KEYS = frozenset({"id", "event", "delay", "delayexpr"})


def delayed_events(element: Element, refuse: Refuse) -> list[DelayedEvent]:
    """Return the delayed events that an ``<onentry>`` sends.

    Args:
        element: The element.
        refuse: Reports everything else in it.
    """
    return [found for child in element.children if (found := _delayed(child, refuse)) is not None]


def cancelled(element: Element, refuse: Refuse) -> list[str]:
    """Return the ids of the delayed events that an ``<onexit>`` cancels.

    Args:
        element: The element.
        refuse: Reports everything else in it.
    """
    return [found for child in element.children if (found := _cancelled(child, refuse))]


def restarts(element: Element, refuse: Refuse) -> list[Restart]:
    """Return the delayed events that a transition sends again: each ``<send>`` follows the ``<cancel>`` of its id.

    Args:
        element: The transition. An ``<if>`` in it may name active states only.
        refuse: Reports everything else in it.
    """
    plain = [child for child in element.children if child.name != "if"]
    found = list(_pairs(plain, (), element.place, refuse))
    for child in element.every("if"):
        condition = read_condition(child.attributes.get("cond", ""))
        if condition is None or len(condition) != 1:
            refuse("This <if> is not supported: only In('state'), with || between", child.place)
        else:
            found += _pairs(child.children, condition[0], child.place, refuse)
    return found


def _pairs(children: Sequence[Element], states: tuple[str, ...], place: Place, refuse: Refuse) -> Iterator[Restart]:
    for index in range(0, len(children), 2):
        ended, begun = children[index], children[index + 1] if index + 1 < len(children) else None
        known = _cancelled(ended, refuse)
        delayed = None if begun is None else _delayed(begun, refuse)
        if known and delayed is not None and delayed.id == known:
            yield Restart(delayed, states)
        elif known:
            refuse("A <cancel> must be followed by the <send> of the same id", place)


def _cancelled(element: Element, refuse: Refuse) -> str:
    name = element.attributes.get("sendid", "")
    if element.name != "cancel" or not name:
        refuse(f"<{element.name}> is not supported", element.place)
        return ""
    return name


def _delayed(element: Element, refuse: Refuse) -> DelayedEvent | None:
    given = element.attributes
    if element.name != "send" or element.children or not given.keys() <= _KEYS:
        refuse(f"<{element.name}> is not supported, but as <send> with id, event and delay", element.place)
        return None
    time = _TIME.fullmatch(given.get("delay", given.get("delayexpr", "").strip("'\"")))
    if time is None or not given.get("id") or not given.get("event"):
        refuse("A <send> needs id, event, and a constant delay such as '600s' or '500ms'", element.place)
        return None
    return DelayedEvent(given["id"], given["event"], float(time[1]) * _UNITS[time[2]], element.place)
