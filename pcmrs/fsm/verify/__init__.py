"""Proves that a workflow is sound: an explicit-state search of the joint states of all its branches."""

from __future__ import annotations

from dataclasses import dataclass, field

from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.finding import Finding
from pcmrs.fsm.verify import _hazards, _liveness, _structure
from pcmrs.fsm.verify._liveness import TimedOperations
from pcmrs.fsm.verify._properties import check_properties
from pcmrs.fsm.verify._search import Progress, SearchLimitError
from pcmrs.fsm.verify._space import StateSpace

__all__ = ["MAX_JOINT_STATES", "Verification", "verify"]

MAX_JOINT_STATES = 2_000_000
"""Default limit of joint states."""

ALWAYS_CHECKED = (_structure.denials, _structure.revocations)
CHECKED_IF_COMPLETE = (
    _structure.unused,
    _structure.activities,
    _structure.timers,
    _liveness.deadlocks,
    _liveness.goals,
    _liveness.stages,
    _liveness.releases,
    _hazards.ways_back,
    _hazards.repetitions,
)


@dataclass(frozen=True, slots=True)
class Verification:
    """Result of the search.

    Attributes:
        findings: All faults; none if the workflow is sound.
        joint_states: Number of reachable joint states; the limit if there are more.
        transitions: Commands accepted in them, with each of their endings.
    """

    findings: list[Finding] = field(default_factory=list)
    joint_states: int = 0
    transitions: int = 0


def verify(blueprint: Blueprint, *, limit: int = MAX_JOINT_STATES, progress: Progress | None = None) -> Verification:
    """Search all joint states of a workflow that obeys the static rules.

    Args:
        blueprint: The workflow.
        limit: Largest number of joint states.
        progress: Called regularly with the numbers of joint states that have been examined and that are known.
    """
    try:
        space = StateSpace(blueprint, limit, progress)
        findings = [finding for check in ALWAYS_CHECKED for finding in check(space)]
        whole = not any(finding.code in _structure.INCOMPLETE for finding in findings)
        findings += [finding for check in CHECKED_IF_COMPLETE if whole for finding in check(space)]
        broken = {
            finding.path for finding in findings
        }  # the order of the effects of a broken operation does not matter
        findings += [finding for finding in _structure.order(space) if finding.path not in broken]
        findings += check_properties(TimedOperations(space, progress)) if whole else ()
    except SearchLimitError as error:
        return Verification([Finding(code="too_many_states", text=str(error), path=("branches",))], limit)
    return Verification(findings, len(space.reached), space.taken)
