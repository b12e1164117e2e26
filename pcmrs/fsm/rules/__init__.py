"""What can be said of a blueprint by reading it: names, references, shapes, activities, and rules 1 to 3."""

from __future__ import annotations

from collections.abc import Iterator

from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.finding import Finding
from pcmrs.fsm.rules.activities import check_activities
from pcmrs.fsm.rules.levels import check_levels
from pcmrs.fsm.rules.names import check_names
from pcmrs.fsm.rules.references import check_references
from pcmrs.fsm.rules.shapes import check_shapes


def check_rules(blueprint: Blueprint) -> Iterator[Finding]:
    """All that is wrong; each kind is looked at only where the kinds before it are right.

    Args:
        blueprint: Expanded, see `pcmrs.fsm.files.sequence`.
    """
    for check in (check_names, check_references, check_shapes, check_activities, check_levels):
        findings = list(check(blueprint))
        yield from findings
        if findings:
            return
