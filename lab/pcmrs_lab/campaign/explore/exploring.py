"""Runs many sessions with consecutive seeds, and reports their coverage and the violations."""

from __future__ import annotations

import math
from collections import Counter
from itertools import count, islice, takewhile

import msgspec

from pcmrs.clock import SystemClock
from pcmrs_lab.campaign.explore.faults import FAULTS
from pcmrs_lab.campaign.explore.generate import draw_script
from pcmrs_lab.campaign.explore.script import Act, Physics, SessionScript, shrink
from pcmrs_lab.campaign.explore.session import ExplorationResult, run_session
from pcmrs_lab.campaign.explore.settings import workflow_of
from pcmrs_lab.scale.tasks import HERE, ShowProgress, Workers, run_tasks

AT_A_TIME = 4
"""Number of sessions in one request: each takes some tenths of a second."""
MOST_SHRUNK = 3
"""Number of violations that are shrunk; the others are reported with their seeds."""


class SessionTask(msgspec.Struct, frozen=True):
    """Session to run.

    Attributes:
        workflow: Name of the workflow.
        physics: Physics of the simulated arm.
        seed: Seed of the session.
    """

    workflow: str
    physics: Physics
    seed: int


class Broken(msgspec.Struct, frozen=True):
    """Session in which an invariant did not hold.

    Attributes:
        seed: Seed of the session.
        invariant: Name of the invariant.
        text: Description of the violation.
        at: Time of the violation, s of the session.
        acts: Number of acts of the whole script.
        script: Script that shows it; shrunk, except the last of many.
    """

    seed: int
    invariant: str
    text: str
    at: float
    acts: int
    script: SessionScript


class Explored(msgspec.Struct, frozen=True):
    """Result of all sessions, simulated.

    Attributes:
        workflow: Workflow that was explored.
        physics: Physics of the simulated arm.
        seed: Seed of the first session; each has the next one.
        sessions: Number of sessions.
        simulated: Simulated time, s.
        cost: Processor time without shrinking, s.
        seconds: Duration, s of the machine.
        rate: Simulated seconds per second, over all processes.
        faults: Number of times that each fault was injected.
        decisions: Number of times that each decision on each operation was seen.
        broken: Sessions in which an invariant did not hold.
    """

    workflow: str
    physics: Physics
    seed: int
    sessions: int
    simulated: float
    cost: float
    seconds: float
    rate: float
    faults: dict[str, int]
    decisions: dict[str, int]
    broken: list[Broken]
    simulated_cell: bool = True

    @property
    def not_reached(self) -> list[str]:
        """Faults that no session injected."""
        return [name for name, times in self.faults.items() if not times]


def explore(
    workflow: str,
    seed: int,
    sessions: int | None,
    *,
    minutes: float | None = None,
    workers: Workers = HERE,
    physics: Physics = "kinematic",
    progress: ShowProgress = lambda *_: None,
) -> Explored:
    """Run sessions until their number is reached, or the time is over.

    Args:
        workflow: Name of the workflow.
        seed: Seed of the first session.
        sessions: Number of sessions; None for as many as fit.
        minutes: Time after which no more are started, min; None for no limit.
        workers: Where the sessions run.
        physics: Physics of the simulated arm.
        progress: Called after each session.

    Returns:
        Result.

    Raises:
        ConfigurationError: The workflow is unknown, or the workers cannot be used.
    """
    clock = SystemClock()
    workflow_of(workflow)  # an unknown workflow is refused before any session is started
    started, found = clock.monotonic(), list[ExplorationResult]()
    end = math.inf if minutes is None else started + 60.0 * minutes
    seeds = takewhile(lambda _: clock.monotonic() < end, islice(count(seed), sessions))
    tasks = (SessionTask(workflow, physics, each) for each in seeds)
    broken = 0
    for _, result in run_tasks(run_sessions, tasks, workers, AT_A_TIME):
        found.append(result)
        broken += bool(result.invariant)
        progress(f"{broken} broken", len(found), sessions or len(found))
    seconds = clock.monotonic() - started
    found.sort(key=lambda each: each.seed)
    return _report(workflow, physics, seed, found, seconds)


def run_sessions(tasks: list[SessionTask]) -> list[ExplorationResult]:
    """Run sessions one after the other, and return their results.

    Args:
        tasks: Sessions.
    """
    return [run_session(_script_of(task)) for task in tasks]


def _script_of(task: SessionTask) -> SessionScript:
    return draw_script(workflow_of(task.workflow).blueprint, task.workflow, task.seed, task.physics)


def _report(workflow: str, physics: Physics, seed: int, found: list[ExplorationResult], seconds: float) -> Explored:
    reached, seen = Counter[str](), Counter[str]()
    for each in found:
        reached.update(each.reached)
        seen.update(each.seen)
    simulated = sum(each.time for each in found)
    failed = [each for each in found if each.invariant]
    return Explored(
        workflow=workflow,
        physics=physics,
        seed=seed,
        sessions=len(found),
        simulated=simulated,
        cost=sum(each.cost for each in found),
        seconds=seconds,
        rate=simulated / seconds if seconds else 0.0,
        faults={name: reached[name] for name in FAULTS},
        decisions=dict(sorted(seen.items())),
        broken=[_broken(workflow, physics, each, number < MOST_SHRUNK) for number, each in enumerate(failed)],
    )


def _broken(workflow: str, physics: Physics, found: ExplorationResult, shrunk: bool) -> Broken:
    script = _script_of(SessionTask(workflow, physics, found.seed))
    shorter = shrink(script, lambda each: run_session(each).invariant == found.invariant) if shrunk else script
    return Broken(found.seed, found.invariant, found.text, found.at, len(script.acts), shorter)


def as_lines(script: SessionScript) -> list[str]:
    """Return the acts of a script as text, one line each."""
    return [_line(number, act) for number, act in enumerate(script.acts, 1)]


def _line(number: int, act: Act) -> str:
    given = " ".join(f"{name}={value}" for name, value in act.arguments.items())
    where = f"into {act.window}" + (f", held {act.held:.3f} s" if act.held else "") if act.window else ""
    who = f"{act.who}: " if act.who else ""
    return f"{number:3}. after {act.after:.3f} s {where and where + ', '}{who}{act.what} {given}".rstrip()
