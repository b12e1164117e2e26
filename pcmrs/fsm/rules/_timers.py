"""Timers: each posts an event, which neither moves nor affects the patient, because nobody has asked for it."""

from __future__ import annotations

from collections.abc import Iterator

from pcmrs.errors import ConfigurationError
from pcmrs.fsm.blueprint import Blueprint, BranchSpec, OperationSpec, TimerSpec, target_from
from pcmrs.fsm.finding import Finding
from pcmrs.fsm.timers import duration


def check_timers(blueprint: Blueprint) -> Iterator[Finding]:
    """Return faults of timers; every name must exist, and the shape of every operation be right."""
    for name, branch in blueprint.branches.items():
        for key, timer in branch.timers.items():
            path = ("branches", name, "timers", key)
            for text in _faults(blueprint, name, branch, timer):
                yield Finding(code="bad_timer", text=f"The timer {name}.{key} {text}", path=path)
            try:
                duration(blueprint, name, key, {})
            except ConfigurationError as error:
                yield Finding(code="bad_timer", text=error.text, path=(*path, "after_s"))


def _faults(blueprint: Blueprint, name: str, branch: BranchSpec, timer: TimerSpec) -> Iterator[str]:
    if not timer.states:
        yield "has no states: name those that it runs in."
    if branch.start in timer.states:
        yield f"would never begin in {branch.start}: only a command that enters a state begins its timers."
    yield from (f"posts {name}.{timer.posts}, which {fault}" for fault in _unfit(branch.operations[timer.posts]))
    for state in timer.states:
        if not branch.valid_in(timer.posts, state):
            yield f"posts {name}.{timer.posts}, which is not valid in {state}."
    if timer.repeat and not any(_keeps(branch.operations[timer.posts], state) for state in timer.states):
        yield f"cannot repeat: {name}.{timer.posts} leads out of every state that it runs in."
    for each in timer.restarted_by:
        other, _, operation = each.partition(".")
        if blueprint.branches[other].operations[operation].iio:
            yield f"is restarted by {each}, which only a child branch calls: name an operation that commands ask for."


def _keeps(operation: OperationSpec, state: str) -> bool:
    return any(target_from(ending.to, state) == state for ending in operation.endings.values())


def _unfit(operation: OperationSpec) -> Iterator[str]:
    """Return the reasons why an operation cannot be posted, or why it might not take effect."""
    if operation.moves or operation.affects_patient:
        yield "moves the robot or affects the patient: nothing does that unless a person requests it."
    elif not operation.event:
        yield "is not an event: mark it with event = true."
    if operation.blocked_when_latched:
        yield "is blocked by Stop's latch: a timer goes on while Stop is latched."
    if operation.unlatches:
        yield "releases Stop's latch: only a person may."
    if operation.checks or operation.requires:
        yield "has checks or requires: nothing may keep it from being performed."
    if operation.steps:
        yield "has steps: it is posted once, and a step may fail, so that it would never take effect."
    if operation.payload != "none":
        yield "has arguments: a timer has none to give."
    if operation.outcomes:
        yield "has several outcomes: give it `to`."
