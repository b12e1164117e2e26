"""Proves that a workflow is sound: an explicit-state search of the joint states of all its branches."""

from __future__ import annotations

from dataclasses import dataclass, field

from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.finding import Finding
from pcmrs.fsm.verify import hazards, liveness, structure
from pcmrs.fsm.verify.liveness import Runs
from pcmrs.fsm.verify.properties import promises
from pcmrs.fsm.verify.search import Progress, TooManyError
from pcmrs.fsm.verify.space import Space

__all__ = ["MAX_JOINT_STATES", "Verification", "verify"]

MAX_JOINT_STATES = 2_000_000
"""So many joint states are looked at unless more are asked for."""

BY_ITSELF = (structure.denials, structure.revocations)
IN_A_WHOLE_SEARCH = (
    structure.unused,
    structure.activities,
    liveness.deadlocks,
    liveness.goals,
    liveness.releases,
    hazards.ways_back,
    hazards.repetitions,
)


@dataclass(frozen=True, slots=True)
class Verification:
    """What the search has shown.

    Attributes:
        findings: Everything that is wrong; none when the workflow is sound.
        joint_states: How many can be reached; where there are too many, how many were looked for.
        transitions: Commands accepted in them, with each of their endings.
    """

    findings: list[Finding] = field(default_factory=list)
    joint_states: int = 0
    transitions: int = 0


def verify(blueprint: Blueprint, *, limit: int = MAX_JOINT_STATES, progress: Progress | None = None) -> Verification:
    """Search all joint states of a workflow that obeys the static rules.

    Args:
        blueprint: The workflow.
        limit: How many joint states it may have.
        progress: Called now and then with how many have been looked at and how many are known.
    """
    try:
        space = Space(blueprint, limit, progress)
        findings = [finding for check in BY_ITSELF for finding in check(space)]
        whole = not any(finding.code in structure.CUT_SHORT for finding in findings)
        findings += [finding for check in IN_A_WHOLE_SEARCH if whole for finding in check(space)]
        broken = {finding.path for finding in findings}  # in which order these would go wrong matters to nobody
        findings += [finding for finding in structure.order(space) if finding.path not in broken]
        findings += promises(Runs(space, progress)) if whole else ()
    except TooManyError as error:
        return Verification([Finding(code="too_many_states", text=str(error), path=("branches",))], limit)
    return Verification(findings, len(space.reached), space.taken)
