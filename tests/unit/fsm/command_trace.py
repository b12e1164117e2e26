"""Follows the commands of a finding one by one, with nothing but the closure of each: do they lead there?"""

from __future__ import annotations

from dataclasses import dataclass, field

from pcmrs.fsm.behaviour import Ruling, endings
from pcmrs.fsm.blueprint import START_OUTCOME, Blueprint
from pcmrs.fsm.closure import Closure, close


@dataclass
class CommandTrace:
    """A joint state, and what runs in it with the closure that it began with."""

    blueprint: Blueprint
    states: dict[str, str] = field(default_factory=dict)
    running: dict[str, Closure] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.states = self.blueprint.initial()

    def ask(self, name: str) -> Ruling:
        branch, _, operation = name.partition(".")
        return close(self.blueprint, self.states, branch, operation)

    def follow(self, command: str) -> None:
        name, _, outcome = command.partition(":")
        closure = self.ask(name)
        assert isinstance(closure, Closure), f"{command} is denied: {closure}"
        if outcome == "started":
            self._take_locks(closure)
            self.running[name] = closure
            return
        if self.running.pop(name, None) is None:
            self._take_locks(closure)
        branch, _, operation = name.partition(".")
        change = endings(self.blueprint.branches[branch].operations[operation], closure)[outcome or START_OUTCOME]
        self.states = dict(change.states) if change is not None else self.states

    def _take_locks(self, closure: Closure) -> None:
        for name, other in self.running.items():
            assert not closure.writes & (other.writes | other.reads), name
            assert not closure.reads & other.writes, name


def follow_commands(blueprint: Blueprint, commands: tuple[str, ...]) -> CommandTrace:
    trace = CommandTrace(blueprint)
    for command in commands:
        trace.follow(command)
    return trace
