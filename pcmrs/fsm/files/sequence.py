"""Expands the abbreviations of a blueprint: ordered lists of items, and ``"*"`` for all states not named."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, TypeVar

import msgspec

from pcmrs.errors import BlueprintError
from pcmrs.fsm.blueprint import Blueprint, BranchSpec, OperationSpec, SequenceSpec

ITEM = re.compile(r"[a-z0-9][a-z0-9_]{0,23}")
"""A state's name is 32 characters at most, and ``_stopped`` takes 8 of them."""

MAX_ITEMS = 1000
MAX_ITEMS_IN_ALL = 10_000
STOPPED = "_stopped"
DONE, ABANDONED = "done", "abandoned"
MADE_KEYS = ("from", "to", "outcomes", "on_failure", "on_unknown")

T = TypeVar("T")


class SequenceError(BlueprintError):
    """An ordered list that cannot be expanded.

    Args:
        path: Keys from the root of the file to the fault.
        text: What is wrong, the value, the limit, and what to do.
    """

    def __init__(self, path: tuple[str, ...], text: str) -> None:
        super().__init__(text, path=path)
        self.path = path


def expand(blueprint: Blueprint) -> Blueprint:
    """Return the workflow without `sequence` and without ``"*"`` in `emits` and `compatible`.

    Raises:
        SequenceError: A sequence has no items, too many, or some that cannot be states.
    """
    sequences = [branch.sequence for branch in blueprint.branches.values() if branch.sequence is not None]
    # Checked before anything is expanded: a short file could ask for millions of states.
    total = sum(sequence.count or len(sequence.items) for sequence in sequences)
    if total > MAX_ITEMS_IN_ALL:
        raise SequenceError(("branches",), f"All sequences have {total} items; the limit is {MAX_ITEMS_IN_ALL}.")
    branches = {name: _expand_branch(("branches", name), branch) for name, branch in blueprint.branches.items()}
    return msgspec.structs.replace(blueprint, branches=branches)


def _expand_branch(path: tuple[str, ...], branch: BranchSpec) -> BranchSpec:
    if branch.sequence is not None:
        branch = _without_sequence(path, branch, branch.sequence)
    parent = branch.parent
    if parent is not None:
        compatible = _without_star(parent.compatible, branch.states)
        parent = msgspec.structs.replace(parent, compatible=compatible)
    return msgspec.structs.replace(branch, parent=parent, emits=_without_star(branch.emits, branch.states))


def _without_star(named: Mapping[str, T], states: Mapping[str, str]) -> dict[str, T]:
    others = {state: named["*"] for state in states if state not in named} if "*" in named else {}
    return {state: value for state, value in named.items() if state != "*"} | others


def _without_sequence(path: tuple[str, ...], branch: BranchSpec, sequence: SequenceSpec) -> BranchSpec:
    if branch.states:
        raise SequenceError((*path, "states"), "A sequence makes the states of its branch: leave `states` out.")
    items = _items((*path, "sequence"), sequence)
    states = _before((*path, "sequence", "before"), sequence.before, items) | _states(items)
    made = _operations((*path, "sequence"), sequence, items, branch.operations)
    operations = made | branch.operations
    if branch.rio is None and "reinit" not in operations:
        first = next(iter(states))
        operations["reinit"] = OperationSpec(title="Begin again", from_=["*"], to=first, rio=True)
    return msgspec.structs.replace(branch, sequence=None, states=states, operations=operations)


def _items(path: tuple[str, ...], sequence: SequenceSpec) -> dict[str, str]:
    """Return the name of each item and its title, in order."""
    if (sequence.count is None) == (not sequence.items):
        raise SequenceError(path, "A sequence needs either `count` or `items`.")
    if sequence.count is None:
        _check_names((*path, "items"), sequence.items)
        return {name: name for name in sequence.items}
    if not 1 <= sequence.count <= MAX_ITEMS:
        text = f"`count` is {sequence.count}; it must be 1 to {MAX_ITEMS}."
        raise SequenceError((*path, "count"), text)
    _check_names((*path, "item"), [f"{sequence.item}_{sequence.count}"])
    return {f"{sequence.item}_{i}": f"{sequence.item} {i}" for i in range(1, sequence.count + 1)}


def _before(path: tuple[str, ...], name: str, items: Mapping[str, str]) -> dict[str, str]:
    """The state ahead of the first item, where the sequence has one."""
    if not name:
        return {}
    if fault := _fault_of(name, set(items)):
        raise SequenceError(path, fault)
    return {name: "none can be performed yet"}


def _check_names(path: tuple[str, ...], names: list[str]) -> None:
    if len(names) > MAX_ITEMS:
        raise SequenceError(path, f"The sequence has {len(names)} items; the limit is {MAX_ITEMS}.")
    seen: set[str] = set()
    for index, name in enumerate(names):
        fault = _fault_of(name, seen)
        if fault:
            raise SequenceError((*path, str(index)) if path[-1] == "items" else path, fault)
        seen.add(name)


def _fault_of(name: str, seen: set[str]) -> str:
    if not ITEM.fullmatch(name):
        return f"{name!r} cannot be a state of a sequence: use 1 to 24 of a-z, 0-9 and _."
    if name in (DONE, ABANDONED) or name.endswith(STOPPED):
        return f"{name!r} cannot be used: {DONE}, {ABANDONED} and names in {STOPPED} are states of every sequence."
    return f"{name!r} is named twice." if name in seen else ""


def _states(items: Mapping[str, str]) -> dict[str, str]:
    states: dict[str, str] = {}
    for name, text in items.items():
        states |= {name: f"{text} is next", name + STOPPED: f"{text} was stopped"}
    return states | {DONE: "all performed or left out", ABANDONED: "given up"}


def _operations(
    path: tuple[str, ...], sequence: SequenceSpec, items: Mapping[str, str], written: Mapping[str, OperationSpec]
) -> dict[str, OperationSpec]:
    """A failed item bars the next one: it must be repeated or left out, or the sequence be given up."""
    names = list(items)
    following = dict(zip(names, [*names[1:], DONE], strict=True))
    stopped = {name: name + STOPPED for name in names}
    after_stop = {stopped[name]: later for name, later in following.items()}
    open_again = {state: name for name, state in stopped.items()}
    made = {
        "perform": _move("Perform the next", following) | {"on_failure": stopped, "on_unknown": stopped},
        "repeat": _move("Open the stopped one again", open_again),
        "skip": _move("Leave one out", following | after_stop),
        "abandon": _move("Give up", following | after_stop) | {"to": ABANDONED},
    }
    given = {
        "perform": sequence.perform,
        "repeat": sequence.repeat,
        "skip": sequence.skip,
        "abandon": sequence.abandon,
    }
    for name, keys in given.items():
        _check_given((*path, name), keys, overridden=name in written)
    return {name: _operation((*path, name), made[name] | given[name]) for name in made if name not in written}


def _move(title: str, to: dict[str, str]) -> dict[str, Any]:
    return {"title": title, "from": list(to), "to": to}


def _check_given(path: tuple[str, ...], given: Mapping[str, Any], *, overridden: bool) -> None:
    for key in MADE_KEYS:
        if key in given:
            raise SequenceError((*path, key), f"`{key}` is made from the items: leave it out.")
    if given and overridden:
        text = f"The branch writes its own operation {path[-1]}, so these keys have no effect: move them there."
        raise SequenceError(path, text)


def _operation(path: tuple[str, ...], keys: Mapping[str, Any]) -> OperationSpec:
    try:
        return msgspec.convert(keys, OperationSpec)
    except msgspec.ValidationError as error:
        raise SequenceError(path, f"{error}.") from error
