"""Makes the specification of a branch from its steps, and those of the branches that refine its steps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import msgspec

from pcmrs.authoring.design._commands import REINIT, StepOperation, check_operations, operations_of
from pcmrs.authoring.design._grouping import StepGroup, UndesignableError
from pcmrs.authoring.design._hazards import GuardedOrder
from pcmrs.authoring.design._operations import Operations, reinit_of
from pcmrs.authoring.design._order import Order
from pcmrs.authoring.design._refinement import Refinement, emits_of, parent_of, refinements_of, resting_on
from pcmrs.authoring.design._safety import lost
from pcmrs.fsm.blueprint import BranchSpec, Requirement, RevocationSpec
from pcmrs.fsm.finding import Path


@dataclass(frozen=True, slots=True)
class DesignedBranch:
    """One branch.

    Attributes:
        name: Name of the branch.
        spec: Its specification.
        path: Path of its step in the table.
        commands: The operations that its steps ask for.
    """

    name: str
    spec: BranchSpec
    path: Path
    commands: Sequence[StepOperation] = ()


def root_branches(group: StepGroup, paths: Mapping[str, Path]) -> Iterator[DesignedBranch]:
    """Return the branch of a group of steps, then those that refine them, each before its own refinements.

    Args:
        group: The steps.
        paths: Path of each step in the table.

    Raises:
        UndesignableError: Operations collide, or a refinement is too large.
    """
    return _branches(group, refinements_of(group, paths), paths, {}, 1)


def _branches(
    group: StepGroup, refinements: Sequence[Refinement], paths: Mapping[str, Path], above: Requirement, level: int
) -> Iterator[DesignedBranch]:
    order, commands = group.order, list(operations_of(group, paths))
    for finding in check_operations(group, commands):
        raise UndesignableError(finding)
    spec = BranchSpec(
        level=level,
        title=group.title,
        states={order.state(each): order.meaning(each) for each in order.combinations},
        flags=order.flags,
        operations=Operations(order, refinements, above, refines=level > 1).made(commands),
        revocations=_when_lost(order),
    )
    yield DesignedBranch(group.name, spec, paths[order.steps[0].name], commands)
    for refinement in refinements:
        calm = above | resting_on(refinement.step, refinements, order, signalled=True)
        yield from _refining(refinement, group, paths, calm, level + 1)


def _when_lost(order: Order) -> list[RevocationSpec]:
    """Return the revocations after a loss of the robot: what was at the patient is then unknown."""
    if not isinstance(order, GuardedOrder):
        return []
    moved = (each for each in order.combinations if each & order.moving)
    return lost({order.state(each): order.state(order.interrupted(each)) for each in moved})


def _refining(
    refinement: Refinement, owner: StepGroup, paths: Mapping[str, Path], above: Requirement, level: int
) -> Iterator[DesignedBranch]:
    step = owner.order.steps[refinement.step]
    if refinement.group is None:
        # Expanding the sequence makes the plain re-initiation.
        operations = {REINIT: reinit_of(refinement.start, above, {})} if above else {}
        spec = BranchSpec(level=level, title=refinement.title, sequence=refinement.sequence, operations=operations)
        branches = iter([DesignedBranch(refinement.name, spec, paths[step.name])])
    else:
        branches = _branches(refinement.group, refinement.below, paths, above, level)
    first = next(branches)
    spec = msgspec.structs.replace(
        first.spec,
        parent=parent_of(refinement, owner),
        emits=emits_of(refinement, step),
    )
    yield replace(first, spec=spec)
    yield from branches
