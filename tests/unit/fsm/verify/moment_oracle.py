"""Moments of a workflow, searched one at a time: joint states with the operations that run in them."""

from __future__ import annotations

from collections.abc import Iterator

from hypothesis import strategies as st

from pcmrs.fsm.behaviour import branch_states, endings, joint_of
from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.closure import Closure, close

Locks = tuple[frozenset[str], frozenset[str]]
Moment = tuple[tuple[str, ...], frozenset[tuple[str, Locks]]]


def after(blueprint: Blueprint, observed: frozenset[str], moment: Moment) -> Iterator[tuple[Moment, bool]]:
    """Every moment that can follow, said anew: locks of what runs bar what would begin or be committed.

    And whether it follows on what a user asks for or has asked for, and ends as declared.
    """
    joint, running = moment
    states, held = branch_states(blueprint, joint), dict(running)
    for branch, spec in blueprint.branches.items():
        for operation, declared in spec.operations.items():
            name, closure = f"{branch}.{operation}", close(blueprint, states, branch, operation)
            if declared.iio or not isinstance(closure, Closure):
                continue
            others = [locks for other, locks in held.items() if other != name]
            needed = (closure.writes, frozenset[str]()) if name in held else (closure.writes, closure.reads)
            if any(needed[0] & (writes | reads) or needed[1] & writes for writes, reads in others):
                continue
            if name in observed and name not in held:
                yield (joint, running | {(name, (closure.writes, closure.reads))}), not declared.event
            for ending, change in endings(declared, closure).items():
                target = joint if change is None else joint_of(blueprint, change.states)
                intended = ending in closure.outcomes and (name in held or not declared.event)
                yield (target, frozenset((other, locks) for other, locks in running if other != name)), intended


def lengths(blueprint: Blueprint, observed: frozenset[str]) -> dict[Moment, int]:
    start: Moment = (joint_of(blueprint, blueprint.initial()), frozenset())
    found, waiting = {start: 0}, [start]
    for moment in waiting:
        for following, _ in after(blueprint, observed, moment):
            if following not in found:
                found[following] = found[moment] + 1
                waiting.append(following)
    return found


def some_operations(blueprint: Blueprint, data: st.DataObject) -> frozenset[str]:
    names = [
        f"{branch}.{operation}"
        for branch, spec in blueprint.branches.items()
        for operation, declared in spec.operations.items()
        if not declared.iio
    ]
    return data.draw(st.frozensets(st.sampled_from(names), min_size=1, max_size=2))


def stranded(blueprint: Blueprint, moment: Moment) -> bool:
    joint, running = moment
    asked = (name.split(".") for name, _ in running)
    states = branch_states(blueprint, joint)
    return any(not isinstance(close(blueprint, states, name[0], name[1]), Closure) for name in asked)
