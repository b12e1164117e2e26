"""`pcmrs fsm simulate`: a workflow in the terminal, command by command."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import click
from rich.box import SIMPLE_HEAD
from rich.table import Table

from pcmrs.cli.fsm.files import file_argument, sound
from pcmrs.cli.options import json_option
from pcmrs.cli.printing import say, say_json, say_lines
from pcmrs.cli.running import readable_errors
from pcmrs.cli.tables import Terminal
from pcmrs.errors import RefusalError
from pcmrs.fsm.behaviour import line_of

if TYPE_CHECKING:
    from pcmrs.authoring.trial.session import SimulationSession, TrialStep

HELP = """\
<number>                    ask for that line of the list
<branch.operation>          ask for an operation; it must have one outcome only
<branch.operation:ending>   ask for it, with its ending: an outcome, failed or unknown
wait <seconds>              let time pass: timers expire, and post their events
why <branch.operation>      why it is refused now
state                       the states, and all possible commands
undo, reset                 take the last command back, or all of them
help, quit"""


LONGEST_LINE = 1000
"""Limit of a line, bytes; longer lines are read in parts."""


@click.command()
@file_argument
@click.option("--random", "count", type=click.IntRange(min=1), help="Number of random commands.")
@click.option("--seed", default=1, show_default=True, help="Seed of the random commands.")
@json_option
@readable_errors
def simulate(file: str, count: int | None, seed: int, as_json: bool) -> None:
    """Step through the workflow FILE: see all possible commands, and the effects of those you give.

    Commands are read line by line, from the terminal or a pipe; `help` lists them. With --json every step is
    one JSON object.
    """
    from pcmrs.authoring.trial.session import SimulationSession

    walk = SimulationSession(sound(file))
    show: Callable[[TrialStep], None] = _show_json if as_json else _show
    if count is not None:
        for step in walk.random_walk(count, seed):
            show(step)
    else:
        _converse(walk, show, tables=not as_json)


def _converse(walk: SimulationSession, show: Callable[[TrialStep], None], *, tables: bool) -> None:
    """Answer line after line until there are no more; at a terminal every answer ends with the new state."""
    if tables:
        _show_state(walk)
    for line in _lines():
        word, _, rest = line.partition(" ")
        if word == "quit":
            return
        if word == "state":
            _show_state(walk)
        elif word == "wait":
            _wait(walk, rest.strip(), show)
        elif word in REPLIES:
            say_lines(REPLIES[word](walk, rest.strip()))
        elif line:
            _ask(walk, line, show)
            if tables and sys.stdin.isatty():
                _show_state(walk)


def _lines() -> Iterator[str]:
    prompt = "> " if sys.stdin.isatty() else ""
    while True:
        say(prompt, nl=False)
        line = sys.stdin.buffer.readline(LONGEST_LINE)
        if not line:
            return
        rest = line
        while len(rest) == LONGEST_LINE and not rest.endswith(b"\n"):  # the rest of the line is not another line
            rest = sys.stdin.buffer.readline(LONGEST_LINE)
        yield line.decode(errors="replace").strip()


def _ask(walk: SimulationSession, line: str, show: Callable[[TrialStep], None]) -> None:
    try:
        show(walk.ask(_chosen(walk.choices(), int(line)) if line.isdecimal() else line))
    except RefusalError as error:
        say(error.text, err=True)


def _wait(walk: SimulationSession, seconds: str, show: Callable[[TrialStep], None]) -> None:
    try:
        for step in walk.wait(_seconds(seconds)):
            show(step)
    except RefusalError as error:
        say(error.text, err=True)


def _seconds(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise RefusalError("bad_time", f"{text!r} cannot be a time: give seconds, for example wait 60.") from None


def _chosen(choices: list[str], number: int) -> str:
    if not 1 <= number <= len(choices):
        raise RefusalError("unknown_choice", f"{number} is not in the list; it has 1 to {len(choices)}.")
    return choices[number - 1]


def _why(walk: SimulationSession, name: str) -> list[str]:
    try:
        denial = walk.denial(name)
    except RefusalError as error:
        return [error.text]
    return [f"{name} is allowed." if denial is None else f"{denial.code}: {denial.text}"]


def _undo(walk: SimulationSession, _rest: str) -> list[str]:
    return [_where(walk) if walk.undo() else "There is nothing to undo."]


def _reset(walk: SimulationSession, _rest: str) -> list[str]:
    walk.reset()
    return [_where(walk)]


REPLIES: dict[str, Callable[[SimulationSession, str], list[str]]] = {
    "help": lambda _walk, _rest: HELP.splitlines(),
    "why": _why,
    "undo": _undo,
    "reset": _reset,
}


def _where(walk: SimulationSession) -> str:
    return line_of(walk.states())


def _show_json(step: TrialStep) -> None:
    say_json(step)


def _show(step: TrialStep) -> None:
    at = f"{step.at:g} s: " if step.by or step.decision == "waited" else ""
    by = f", by timer {step.by}" if step.by else ""
    say(f"{at}{step.command}: {step.decision}{by}")
    for line in step.lines():
        say(f"    {line}")


def _show_state(walk: SimulationSession) -> None:
    """Print the state of every branch with its meaning, then the numbered choices."""
    table = Table("branch", "state", "meaning", box=SIMPLE_HEAD)
    for branch, state in walk.states().items():
        table.add_row(branch, state, walk.blueprint.branches[branch].states[state])
    Terminal().print(table)
    for number, command in enumerate(walk.choices(), 1):
        say(f"{number:>4}  {command}")
