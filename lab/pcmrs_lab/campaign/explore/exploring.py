"""Runs many sessions, each of a seed of its own, and tells what they reached and what did not hold."""

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
"""Sessions that a process is given at once."""
MOST_SHRUNK = 3
"""Violations that are shrunk; the others are told with their seeds."""

ShowProgress = Callable[[str, int, int], None]


class Broken(msgspec.Struct, frozen=True):
    """A session in which an invariant did not hold.

    Attributes:
        seed: Of the session.
        invariant: Its name.
        text: What was seen.
        at: When, s of the session.
        acts: Of the whole script.
        script: That shows it; shrunk, but for the last of many.
    """

    seed: int
    invariant: str
    text: str
    at: float
    acts: int
    script: SessionScript


class Explored(msgspec.Struct, frozen=True):
    """What came of all sessions, simulated.

    Attributes:
        workflow: That was explored.
        physics: Of the simulated arm.
        seed: Of the first session; each has the next one.
        sessions: Run.
        simulated: Their time, s.
        cost: Of the processor, without shrinking, s.
        seconds: It took, s of the machine.
        rate: Simulated seconds per second, over all processes.
        faults: How often each fault was brought about.
        decisions: How often each decision on each operation was seen.
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
        """Faults that no session brought about."""
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
    """Runs sessions until so many are done, or the time is up.

    Args:
        workflow: By its name.
        seed: Of the first session.
        sessions: How many; None for as many as fit.
        minutes: After which no more are begun; None for no limit.
        jobs: Processes.
        physics: Of the simulated arm.
        progress: Told what is done.

    Raises:
        ConfigurationError: There is no such workflow.
    """
    clock = SystemClock()
    workflow_of(workflow)  # before anything is begun
    begun, found = clock.monotonic(), list[ExplorationResult]()
    seeds = islice(count(seed), sessions)
    for some in _run_all(workflow, physics, seeds, jobs, clock, None if minutes is None else begun + 60.0 * minutes):
        found += some
        progress(f"{sum(bool(each.invariant) for each in found)} broken", len(found), sessions or len(found))
    seconds = clock.monotonic() - begun
    found.sort(key=lambda each: each.seed)
    return _report(workflow, physics, seed, found, seconds)


def run_seeds(workflow: str, physics: Physics, seeds: list[int]) -> list[ExplorationResult]:
    """The sessions of these seeds, one after the other."""
    blueprint = workflow_of(workflow).blueprint
    return [run_session(draw_script(blueprint, workflow, seed, physics)) for seed in seeds]


def _run_all(
    workflow: str, physics: Physics, seeds: Iterator[int], jobs: int, clock: Clock, end: float | None
) -> Iterator[list[ExplorationResult]]:
    def more() -> list[int]:
        return [] if end is not None and clock.monotonic() >= end else list(islice(seeds, AT_A_TIME))

    if jobs == 1:
        while some := more():
            yield run_seeds(workflow, physics, some)
        return
    with _processes(jobs) as pool:
        running: set[Future[list[ExplorationResult]]] = set()
        while True:
            with _ctrl_c_blocked():  # by those that are begun now, too
                while len(running) < 2 * jobs and (some := more()):
                    running.add(pool.submit(run_seeds, workflow, physics, some))
            if not running:
                return
            done, running = wait(running, return_when=FIRST_COMPLETED)
            for each in done:
                yield each.result()


@contextmanager
def _processes(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Processes that end at once, and leave nothing behind, when this one is interrupted."""
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
    """The acts of a script for people, one line each."""
    return [_line(number, act) for number, act in enumerate(script.acts, 1)]


def _line(number: int, act: Act) -> str:
    given = " ".join(f"{name}={value}" for name, value in act.arguments.items())
    where = f"into {act.window}" + (f", held {act.held:.3f} s" if act.held else "") if act.window else ""
    who = f"{act.who}: " if act.who else ""
    return f"{number:3}. after {act.after:.3f} s {where and where + ', '}{who}{act.what} {given}".rstrip()
