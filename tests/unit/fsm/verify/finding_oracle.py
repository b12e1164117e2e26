"""Where a finding is due: joint states that are wanted, and the shortest way to one of them."""

from __future__ import annotations

from collections.abc import Callable

from pcmrs.fsm.behaviour import Ruling, branch_states
from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.closure import Closure, close
from pcmrs.fsm.finding import Finding
from pcmrs.fsm.verify import verify
from tests.unit.fsm.command_trace import follow_commands
from tests.unit.fsm.verify.joint_state_oracle import levels

States = dict[str, str]


def found(blueprint: Blueprint, code: str) -> list[Finding]:
    return [finding for finding in verify(blueprint).findings if finding.code == code]


def joint_states(blueprint: Blueprint) -> dict[int, list[States]]:
    """The reachable joint states by the length of the shortest way there, the nearest first."""
    by_length: dict[int, list[States]] = {}
    for joint, length in levels(blueprint).items():
        by_length.setdefault(length, []).append(branch_states(blueprint, joint))
    return by_length


def cut_short(blueprint: Blueprint) -> bool:
    """Something goes on without an end, or cannot end: what cannot be reached then says nothing."""
    return any(
        not isinstance(each, Closure) and each.code in ("cascade_too_long", "no_outcome")
        for states in (branch_states(blueprint, joint) for joint in levels(blueprint))
        for each in answers(blueprint, states)
    )


def answers(blueprint: Blueprint, states: States, *, events: bool = True) -> list[Ruling]:
    """What is answered to everything that may be asked for from outside."""
    return [
        close(blueprint, states, name, operation)
        for name, branch in blueprint.branches.items()
        for operation, spec in branch.operations.items()
        if not spec.iio and (events or not spec.event)
    ]


def shortest(blueprint: Blueprint, wanted: Callable[[States], bool]) -> int | None:
    return next((length for length, found in joint_states(blueprint).items() if any(map(wanted, found))), None)


def check(blueprint: Blueprint, findings: list[Finding], wanted: Callable[[States], bool], extra: int = 0) -> None:
    """The finding is there exactly when it should be, and its commands are a shortest way into it."""
    length = shortest(blueprint, wanted)
    assert bool(findings) == (length is not None)
    lengths = [len(finding.commands or ()) - extra for finding in findings]
    assert min(lengths, default=None) == length
    for finding in findings:
        commands = finding.commands or ()
        assert wanted(follow_commands(blueprint, commands[: len(commands) - extra]).states)
