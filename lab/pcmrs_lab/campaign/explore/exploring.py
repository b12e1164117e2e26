"""Runs many sessions with consecutive seeds, and reports their coverage and the violations."""

from __future__ import annotations

import multiprocessing
import signal
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from itertools import count, islice

import msgspec

from pcmrs.clock import Clock, SystemClock
from pcmrs_lab.campaign.explore.faults import FAULTS
from pcmrs_lab.campaign.explore.generate import draw_script
from pcmrs_lab.campaign.explore.script import Act, Physics, SessionScript, shrink
from pcmrs_lab.campaign.explore.session import ExplorationResult, forget_sessions, run_session
from pcmrs_lab.campaign.explore.settings import workflow_of

AT_A_TIME = 4
"""Number of sessions that a process is given at once."""
MOST_SHRUNK = 3
"""Number of violations that are shrunk; the others are reported with their seeds."""

ShowProgress = Callable[[str, int, int], None]


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
    jobs: int = 1,
    physics: Physics = "kinematic",
    progress: ShowProgress = lambda *_: None,
) -> Explored:
    """Run sessions until their number is reached, or the time is over.

    Args:
        workflow: Name of the workflow.
        seed: Seed of the first session.
        sessions: Number of sessions; None for as many as fit.
        minutes: Time after which no more are started, min; None for no limit.
        jobs: Number of processes.
        physics: Physics of the simulated arm.
        progress: Called after each batch of sessions.

    Returns:
        Result.

    Raises:
        ConfigurationError: The workflow is unknown.
    """
    clock = SystemClock()
    workflow_of(workflow)  # an unknown workflow is refused before any session is started
    started, found = clock.monotonic(), list[ExplorationResult]()
    seeds = islice(count(seed), sessions)
    for batch in _run_all(workflow, physics, seeds, jobs, clock, None if minutes is None else started + 60.0 * minutes):
        found += batch
        progress(f"{sum(bool(each.invariant) for each in found)} broken", len(found), sessions or len(found))
    seconds = clock.monotonic() - started
    found.sort(key=lambda each: each.seed)
    return _report(workflow, physics, seed, found, seconds)


def run_seeds(workflow: str, physics: Physics, seeds: list[int]) -> list[ExplorationResult]:
    """Run the sessions of some seeds one after the other, and return their results.

    Args:
        workflow: Name of the workflow.
        physics: Physics of the simulated arm.
        seeds: Seeds of the sessions.
    """
    blueprint = workflow_of(workflow).blueprint
    return [run_session(draw_script(blueprint, workflow, seed, physics)) for seed in seeds]


def _run_all(
    workflow: str, physics: Physics, seeds: Iterator[int], jobs: int, clock: Clock, end: float | None
) -> Iterator[list[ExplorationResult]]:
    def more() -> list[int]:
        return [] if end is not None and clock.monotonic() >= end else list(islice(seeds, AT_A_TIME))

    if jobs == 1:
        while batch := more():
            yield run_seeds(workflow, physics, batch)
        return
    with _processes(jobs) as pool:
        running: set[Future[list[ExplorationResult]]] = set()
        while True:
            with _ctrl_c_blocked():  # new processes inherit the mask
                while len(running) < 2 * jobs and (batch := more()):
                    running.add(pool.submit(run_seeds, workflow, physics, batch))
            if not running:
                return
            done, running = wait(running, return_when=FIRST_COMPLETED)
            for each in done:
                yield each.result()


@contextmanager
def _processes(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Start a pool of processes that end at once, and leave nothing behind, when this one is interrupted."""
    others = multiprocessing.active_children()
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in multiprocessing.active_children():
                if process not in others:
                    process.kill()
                    process.join()
                    forget_sessions(process.pid)
            raise


@contextmanager
def _ctrl_c_blocked() -> Iterator[None]:
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


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
    script = draw_script(workflow_of(workflow).blueprint, workflow, found.seed, physics)
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
