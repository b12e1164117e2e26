"""What may be asked of a workflow, with each way it can end, and what that changes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from pcmrs.authoring.exchange.exporting.coupling import Joint
from pcmrs.authoring.exchange.exporting.events import event_names
from pcmrs.fsm.behaviour import endings
from pcmrs.fsm.blueprint import START_OUTCOME, Blueprint
from pcmrs.fsm.closure import Change, Closure, close


@dataclass(frozen=True, slots=True)
class Command:
    """An operation and one of the ways it can end."""

    branch: str
    operation: str
    ending: str
    event: str


def commands(blueprint: Blueprint) -> Iterator[Command]:
    """All commands that somebody may give: an operation that signals for a child is none."""
    events = event_names(blueprint)
    for branch, spec in blueprint.branches.items():
        for name, operation in spec.operations.items():
            possible = [] if operation.iio else [*operation.endings, *operation.doubtful]
            for ending in possible:
                event = events[branch, name]
                yield Command(branch, name, ending, event if possible == [START_OUTCOME] else f"{event}.{ending}")


def change_of(blueprint: Blueprint, states: Joint, command: Command) -> Change | None:
    """What a command changes in a joint state; None where it is rejected."""
    said = close(blueprint, states, command.branch, command.operation)
    if not isinstance(said, Closure):
        return None
    operation = blueprint.branches[command.branch].operations[command.operation]
    return endings(operation, said).get(command.ending)
