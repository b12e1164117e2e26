"""From the steps of a branch to its specification, and to those of the branches that refine its steps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import msgspec

from pcmrs.authoring.design.commands import REINIT, Command, check_commands, commands_of
from pcmrs.authoring.design.grouping import Group, UndesignableError
from pcmrs.authoring.design.hazards import GuardedOrder
from pcmrs.authoring.design.operations import Operations, reinit_of
from pcmrs.authoring.design.order import Order
from pcmrs.authoring.design.refinement import Refinement, emits_of, parent_of, refinements_of, resting_on
from pcmrs.authoring.design.safety import lost
from pcmrs.fsm.blueprint import BranchSpec, Requirement, RevocationSpec
from pcmrs.fsm.finding import Path


@dataclass(frozen=True, slots=True)
class Designed:
    """One branch.

    Attributes:
        name: Of the branch.
        spec: The branch.
        path: The step in the table that it comes from.
        commands: What its operations come from.
    """

    name: str
    spec: BranchSpec
    path: Path
    commands: Sequence[Command] = ()


def root_branches(group: Group, paths: Mapping[str, Path]) -> Iterator[Designed]:
    """The branch of a group of steps, then those that refine them, each before its own refinements.

    Args:
        group: The steps.
        paths: Where each step is in the table.

    Raises:
        UndesignableError: Operations collide, or a refinement is too large.
    """
    return _branches(group, refinements_of(group, paths), paths, {}, 1)


def _branches(
    group: Group, refinements: Sequence[Refinement], paths: Mapping[str, Path], above: Requirement, level: int
) -> Iterator[Designed]:
    order, commands = group.order, list(commands_of(group, paths))
    for finding in check_commands(group, commands):
        raise UndesignableError(finding)
    spec = BranchSpec(
        level=level,
        title=group.title,
        states={order.state(each): order.meaning(each) for each in order.combinations},
        flags=order.flags,
        operations=Operations(order, refinements, above, refines=level > 1).made(commands),
        revocations=_when_lost(order),
    )
    yield Designed(group.name, spec, paths[order.steps[0].name], commands)
    for refinement in refinements:
        calm = above | resting_on(refinement.step, refinements, order, signalled=True)
        yield from _refining(refinement, group, paths, calm, level + 1)


def _when_lost(order: Order) -> list[RevocationSpec]:
    """Where the robot was at the patient when it is lost, nobody knows that any more."""
    if not isinstance(order, GuardedOrder):
        return []
    moved = (each for each in order.combinations if each & order.moving)
    return lost({order.state(each): order.state(order.interrupted(each)) for each in moved})


def _refining(
    refinement: Refinement, owner: Group, paths: Mapping[str, Path], above: Requirement, level: int
) -> Iterator[Designed]:
    step = owner.order.steps[refinement.step]
    if refinement.group is None:
        # Expanding the sequence makes the plain re-initiation.
        operations = {REINIT: reinit_of(refinement.start, above, {})} if above else {}
        spec = BranchSpec(level=level, title=refinement.title, sequence=refinement.sequence, operations=operations)
        branches = iter([Designed(refinement.name, spec, paths[step.name])])
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
