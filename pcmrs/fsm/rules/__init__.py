"""Static rules of a blueprint: names, references, shapes, activities, timers, and Rules 1 to 3."""

from __future__ import annotations

from collections.abc import Iterator

from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.finding import Finding
from pcmrs.fsm.rules._activities import check_activities
from pcmrs.fsm.rules._levels import check_levels
from pcmrs.fsm.rules._references import check_references
from pcmrs.fsm.rules._shapes import check_shapes
from pcmrs.fsm.rules._timers import check_timers
from pcmrs.fsm.rules.names import check_names

__all__ = ["check_rules"]


def check_rules(blueprint: Blueprint) -> Iterator[Finding]:
    """Return all findings; each kind is checked only if the kinds before it have none.

    Args:
        blueprint: Expanded workflow, see `pcmrs.fsm.files.sequence`.
    """
    for check in (check_names, check_references, check_shapes, check_activities, check_timers, check_levels):
        findings = list(check(blueprint))
        yield from findings
        if findings:
            return
