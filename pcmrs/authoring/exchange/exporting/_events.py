"""Commands of a workflow, their effects, and the names of their events in an exported chart.

Events are ``branch.operation``. In an imported workflow, they have the names of the chart that it comes from, which are
the titles of its operations.
"""

from __future__ import annotations

import itertools
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from pcmrs.authoring.exchange import descriptors, plain
from pcmrs.authoring.exchange.exporting._coupling import Joint
from pcmrs.fsm.behaviour import endings
from pcmrs.fsm.blueprint import START_OUTCOME, Blueprint, OperationSpec
from pcmrs.fsm.closure import Change, Closure, close


@dataclass(frozen=True, slots=True)
class OperationEnding:
    """An operation and one of the ways it can end."""

    branch: str
    operation: str
    ending: str
    event: str


def commands(blueprint: Blueprint) -> Iterator[OperationEnding]:
    """Return all commands that a user or device may give; operations that signal for a child are left out."""
    events = _event_names(blueprint)
    for branch, spec in blueprint.branches.items():
        for name, operation in spec.operations.items():
            possible = [] if operation.iio else [*operation.endings, *operation.unconfirmed]
            for ending in possible:
                event = events[branch, name]
                yield OperationEnding(
                    branch, name, ending, event if possible == [START_OUTCOME] else f"{event}.{ending}"
                )


def commands_by_operation(blueprint: Blueprint) -> Iterator[tuple[str, str, list[OperationEnding]]]:
    """Return each operation of `commands` with its commands: one for each of its endings."""
    for (branch, operation), group in itertools.groupby(commands(blueprint), _operation_of):
        yield branch, operation, list(group)


def _operation_of(command: OperationEnding) -> tuple[str, str]:
    return command.branch, command.operation


def changes_of(blueprint: Blueprint, states: Joint, branch: str, operation: str) -> dict[str, Change | None]:
    """Return the change of each ending of an operation in a joint state; empty if it is rejected.

    Args:
        blueprint: The workflow.
        states: The joint state.
        branch: Branch of the operation.
        operation: Name of the operation.
    """
    closure = close(blueprint, states, branch, operation)
    return endings(blueprint.branches[branch].operations[operation], closure) if isinstance(closure, Closure) else {}


Key = tuple[str, str]
"""A branch and its operation."""

EVENT = re.compile(r"(?!(?:done|error)\.)[\w-]+(?:\.[\w-]+)*")


def _event_names(blueprint: Blueprint) -> dict[Key, str]:
    """Return the event of each operation that a user or device may ask for, without its outcome.

    Titles are the events if an import would have made the names of all operations from them, and if no event
    can be mistaken for another; only a re-initiation needs no title.
    """
    operations = {
        (branch, name): operation
        for branch, spec in blueprint.branches.items()
        for name, operation in spec.operations.items()
        if not operation.iio
    }
    own = {key: ".".join(key) for key in operations}
    titled = {key: each for key, each in operations.items() if each.title or not each.rio}
    names = own | {key: each.title for key, each in titled.items()}
    imported = all(_is_imported(name, each) for (_, name), each in titled.items())
    return names if imported and _are_apart(names.values()) and _exclude_each_other(operations, names) else own


def _is_imported(name: str, operation: OperationSpec) -> bool:
    simple = not (operation.outcomes or operation.on_failure or operation.on_unknown)
    called, bare = f"_{plain(operation.title)}", re.sub(r"_\d+$", "", name)
    return simple and bool(EVENT.fullmatch(operation.title)) and called.endswith((f"_{name}", f"_{bare}"))


def _are_apart(names: Iterable[str]) -> bool:
    """Return true if no event is the beginning of another, whose transitions it would trigger."""
    events = set(names)
    return not any(beginning in events for event in events for beginning in descriptors(event)[1:])


def _exclude_each_other(operations: dict[Key, OperationSpec], names: dict[Key, str]) -> bool:
    """Return true if, of operations with the same event, at most one is accepted in any joint state."""
    where: dict[str, list[dict[str, set[str]]]] = defaultdict(list)
    for (branch, name), operation in operations.items():
        required = {each: set(states) for each, states in operation.requires.items()}
        own = {} if operation.from_ == ["*"] else {branch: set(operation.from_)}
        where[names[branch, name]].append(required | own)
    pairs = (pair for cubes in where.values() for pair in itertools.combinations(cubes, 2))
    return all(any(one[b].isdisjoint(other[b]) for b in one.keys() & other.keys()) for one, other in pairs)
