"""A walk through a workflow, one command at a time, as `pcmrs fsm simulate` shows it."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator

import msgspec

from pcmrs.errors import RefusalError
from pcmrs.fsm.behaviour import endings, operations
from pcmrs.fsm.blueprint import START_OUTCOME, Blueprint
from pcmrs.fsm.closure import Change, Closure, Denial, Effect
from pcmrs.fsm.engine import Engine
from pcmrs.fsm.finding import hint
from pcmrs.fsm.timers import RunningTimer, TimerSchedule

WORDS = {
    "operation": "{branch}: {source} → {target}",
    "signal": "signals {branch}.{operation}: {source} → {target}",
    "reinit": "re-initiates {branch}: {source} → {target}",
    "set": "sets {branch}: {source} → {target}",
    "revoke": "revokes {branch}: {source} → {target}",
}
"""Texts of each kind of effect."""

WAITED = "waited"
"""Decision of a step in which only time has passed."""

MOST_EXPIRIES = 1000
"""Limit of the events of timers in one wait."""


class TrialStep(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One command and its result.

    Attributes:
        command: ``branch.operation`` or ``branch.operation:ending``; ``wait <seconds>`` if only time has passed.
        decision: ``accepted``, ``failed``, ``unknown``, ``rejected`` or ``waited``.
        code: Code of a rejection.
        text: Reason of the rejection.
        effects: Its effects, in order.
        states: The joint state after it.
        at: Its time, s from the start; 0 in a workflow without timers.
        by: The timer that has posted it, ``branch.timer``; empty for a person or device.
        timers: Timers that run after it, with the time until their events, s.
    """

    command: str
    decision: str
    code: str = ""
    text: str = ""
    effects: tuple[Effect, ...] = ()
    states: dict[str, str]
    at: float = 0.0
    by: str = ""
    timers: dict[str, float] = {}

    def lines(self) -> list[str]:
        """Return its result in words: the reason for a rejection, or every effect."""
        if self.decision == "rejected":
            return [f"{self.code}: {self.text}"]
        effects = [_describe_effect(effect) for effect in self.effects] or ["nothing changes"]
        timers = [f"timer {name}: {left:g} s left" for name, left in self.timers.items()]
        return [*([] if self.decision == WAITED else effects), *timers]


class SimulationSession:
    """The commands so far, and the joint state they have led to.

    Args:
        blueprint: The workflow; the session begins at its start.

    Attributes:
        steps: The commands and their results, in order.
    """

    def __init__(self, blueprint: Blueprint) -> None:
        self.blueprint = blueprint
        self.steps: list[TrialStep] = []
        self._engine = Engine(blueprint)
        self._schedule = TimerSchedule(blueprint, {})
        self._now = 0.0
        self._before: list[tuple[float, dict[str, RunningTimer]]] = []

    def states(self) -> dict[str, str]:
        """Return the present joint state."""
        return self._engine.joint()

    def choices(self) -> list[str]:
        """Return every command that can be given now, with every way in which it can end."""
        return [command for branch, operation in self._available() for command in self._commands(branch, operation)]

    def ask(self, command: str) -> TrialStep:
        """Give the command ``branch.operation`` or ``branch.operation:ending``, and move on if it is allowed.

        Raises:
            RefusalError: There is no such command, or it does not name the ending of the operation.
        """
        return self._take(self._step(command))

    def wait(self, seconds: float) -> list[TrialStep]:
        """Let time pass; return the steps of the timers that expire, the earliest first, and then the rest of the wait.

        Args:
            seconds: The time, s.

        Raises:
            RefusalError: It is not a time, or timers would expire more than `MOST_EXPIRIES` times. Nothing changes.
        """
        if not 0.0 < seconds < math.inf:
            raise RefusalError("bad_time", f"{seconds:g} s is no time to wait: give seconds above 0, such as wait 60.")
        until, taken = self._now + seconds, len(self.steps)
        while (due := self._schedule.next_due) is not None and due <= until:
            if len(self.steps) - taken >= MOST_EXPIRIES:
                while len(self.steps) > taken:
                    self.undo()
                text = f"Timers would expire more than {MOST_EXPIRIES} times in {seconds:g} s: wait for less."
                raise RefusalError("too_many_expiries", text, limit=MOST_EXPIRIES)
            self._expire(due)
        if until > self._now or taken == len(self.steps):
            waited = TrialStep(command=f"wait {until - self._now:g}", decision=WAITED, states=self.states())
            self._remember()
            self._now = until
            self._add(waited)
        return self.steps[taken:]

    def denial(self, name: str) -> Denial | None:
        """Return why ``branch.operation`` is denied now, or None if it is allowed.

        Raises:
            RefusalError: There is no such operation.
        """
        answer = self._engine.ask(*self._found(name))
        return answer if isinstance(answer, Denial) else None

    def undo(self) -> bool:
        """Take the last command back; return false if there is none."""
        if self.steps:
            self.steps.pop()
            self._now, self._schedule.running = self._before.pop()
            self._engine.place(self.steps[-1].states if self.steps else self.blueprint.initial())
            return True
        return False

    def reset(self) -> None:
        """Go back to the start."""
        self.steps.clear()
        self._before.clear()
        self._now, self._schedule.running = 0.0, {}
        self._engine.place(self.blueprint.initial())

    def random_walk(self, count: int, seed: int) -> Iterator[TrialStep]:
        """Give random commands, allowed or not.

        Args:
            count: Number of commands.
            seed: Seed; the same seed gives the same commands.
        """
        dice = random.Random(seed)
        available = self._available()
        for _ in range(count if available else 0):
            branch, operation = dice.choice(available)
            yield self.ask(dice.choice(self._commands(branch, operation) or [f"{branch}.{operation}"]))

    def _expire(self, due: float) -> None:
        """Post the event of the timer that is due first."""
        timer = min((each for each in self._schedule.running.values() if not each.expired), key=lambda each: each.due)
        step = self._step(f"{timer.branch}.{timer.posts}")
        self._remember()
        self._now = due
        self._schedule.running[timer.key] = msgspec.structs.replace(timer, expired=True)
        self._follow(step, by=timer.key)

    def _take(self, step: TrialStep) -> TrialStep:
        self._remember()
        return self._follow(step)

    def _remember(self) -> None:
        self._before.append((self._now, dict(self._schedule.running)))

    def _follow(self, step: TrialStep, by: str = "") -> TrialStep:
        """Move on to the joint state after a step, end and begin timers, and add it."""
        self._engine.place(step.states)
        name = step.command.partition(":")[0]
        self._schedule.follow(step.states, self._now, name if step.decision == "accepted" else "")
        return self._add(msgspec.structs.replace(step, by=by))

    def _add(self, step: TrialStep) -> TrialStep:
        running = (each for each in self._schedule.running.values() if not each.expired)
        timers = {each.key: round(each.due - self._now, 6) for each in running}
        timed = any(branch.timers for branch in self.blueprint.branches.values())
        self.steps.append(msgspec.structs.replace(step, at=self._now if timed else 0.0, timers=timers))
        return self.steps[-1]

    def _available(self) -> list[tuple[str, str]]:
        """Return the operations that a person or a device may ask for."""
        return [(branch, operation) for branch, operation, spec in operations(self.blueprint) if not spec.iio]

    def _commands(self, branch: str, operation: str) -> list[str]:
        return [_command(f"{branch}.{operation}", ending) for ending in self._endings(branch, operation)]

    def _endings(self, branch: str, operation: str) -> dict[str, Change | None]:
        answer = self._engine.ask(branch, operation)
        spec = self.blueprint.branches[branch].operations[operation]
        return endings(spec, answer) if isinstance(answer, Closure) else {}

    def _found(self, name: str) -> tuple[str, str]:
        branch, _, operation = name.partition(".")
        spec = self.blueprint.branches.get(branch)
        if spec is None:
            text = f"There is no branch {branch!r}; {hint(branch, self.blueprint.branches)}"
            raise RefusalError("unknown_branch", text)
        if operation not in spec.operations:
            text = f"{branch} has no operation {operation!r}; {hint(operation, spec.operations)}"
            raise RefusalError("unknown_operation", text)
        return branch, operation

    def _step(self, command: str) -> TrialStep:
        name, _, ending = command.partition(":")
        branch, operation = self._found(name)
        if self.blueprint.branches[branch].operations[operation].iio:
            denial: Denial | None = Denial("internal_operation", f"{name} is called by a child branch only.")
        else:
            denial = self.denial(name)
        if denial is not None:
            states = self.states()
            return TrialStep(command=command, decision="rejected", code=denial.code, text=denial.text, states=states)
        possible = self._endings(branch, operation)
        ending = ending or _only_outcome(possible)
        if ending not in possible:
            ways = ", ".join(_command(name, way) for way in possible)
            raise RefusalError("unknown_outcome", f"{command} does not name an ending; choose from {ways}.")
        change = possible[ending]
        return TrialStep(
            command=_command(name, ending),
            decision=ending if ending in ("failed", "unknown") else "accepted",
            effects=change.effects if change is not None else (),
            states=dict(change.states) if change is not None else self.states(),
        )


def _describe_effect(effect: Effect) -> str:
    """Return an effect in words."""
    return WORDS[effect.kind].format(
        branch=effect.branch, operation=effect.operation, source=effect.source, target=effect.target
    )


def _command(name: str, ending: str) -> str:
    return name if ending == START_OUTCOME else f"{name}:{ending}"


def _only_outcome(possible: dict[str, Change | None]) -> str:
    outcomes = [ending for ending in possible if ending not in ("failed", "unknown")]
    return outcomes[0] if len(outcomes) == 1 else ""
