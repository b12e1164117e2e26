"""Runs a campaign: every fault with every seed, each with a deadline, on one or more workers."""

from __future__ import annotations

import logging
import tempfile
import traceback
from collections.abc import Sequence
from pathlib import Path

import msgspec
import structlog

import pcmrs
from pcmrs.cli.running import run
from pcmrs.clock import Clock, SystemClock
from pcmrs.errors import PcmrsError
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.catalogue import CatalogueRow, catalogue
from pcmrs_lab.campaign.fault import Injection, NotRun
from pcmrs_lab.campaign.injections import injections
from pcmrs_lab.campaign.lab import Lab, Pool
from pcmrs_lab.campaign.report import CampaignReport, FaultResult, InjectionResult, Outcome, result_of, summarize
from pcmrs_lab.campaign.sham import is_sham as in_sham
from pcmrs_lab.campaign.sham import sham
from pcmrs_lab.campaign.tools import require
from pcmrs_lab.campaign.tries import difference, listed, recorded_tries
from pcmrs_lab.scale.tasks import HERE, ShowProgress, Workers, run_tasks

NO_INJECTION = "this version has no injection for it"
FAULTS_AT_ONCE = 4
"""Number of faults in one request: they share a daemon while they need the same settings."""


class FaultTask(msgspec.Struct, frozen=True):
    """Fault to inject.

    Attributes:
        id: Row of the catalogue.
        seed: Seed of everything that is random.
        is_sham: True if no fault is injected.
    """

    id: str
    seed: int
    is_sham: bool


def run_campaign(
    rows: Sequence[CatalogueRow],
    seeds: Sequence[int],
    workers: Workers = HERE,
    progress: ShowProgress = lambda *_: None,
    *,
    is_sham: bool = False,
) -> CampaignReport:
    """Inject every fault with every seed; a fault that hangs, fails or raises does not prevent the others.

    Args:
        rows: Rows of the catalogue.
        seeds: Seeds of everything that is random.
        workers: Where the faults are injected, each worker into separate daemons.
        progress: Called after each fault.
        is_sham: True if no fault is injected; an injection has passed if it detects that.

    Returns:
        Report of all results.

    Raises:
        ConfigurationError: The workers cannot be used.
    """
    clock = SystemClock()
    started = clock.monotonic()
    tasks = [FaultTask(row.id, seed, is_sham) for seed in seeds for row in rows]
    results: dict[tuple[str, int], FaultResult] = {}
    for task, result in run_tasks(inject_faults, tasks, workers, FAULTS_AT_ONCE):
        results[task.id, task.seed] = result
        progress(f"{result.id} {result.title}"[:40], len(results), len(tasks))
    in_order = [results[row.id, seed] for row in rows for seed in seeds]
    return CampaignReport(
        simulated=True,
        version=pcmrs.__version__,
        seeds=list(seeds),
        seconds=clock.monotonic() - started,
        faults=in_order,
        summary=summarize(in_order),
        sham=is_sham,
    )


def inject_faults(tasks: list[FaultTask]) -> list[FaultResult]:
    """Inject faults one after the other, and return their results.

    Args:
        tasks: Faults.
    """
    before = structlog.get_config()
    # Errors of steps are expected here, since faults cause them.
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    try:
        return run(_inject_all(tasks))
    finally:
        structlog.configure(**before)


async def _inject_all(tasks: list[FaultTask]) -> list[FaultResult]:
    clock = SystemClock()
    with tempfile.TemporaryDirectory(prefix="pcmrs-faults-", ignore_cleanup_errors=True) as name:
        folder, pool = Path(name), Pool(Path(name))
        try:
            return [
                await run_fault(catalogue()[each.id], each.seed, folder, pool, clock, is_sham=each.is_sham)
                for each in tasks
            ]
        finally:
            await pool.close()


async def run_fault(
    row: CatalogueRow, seed: int, folder: Path, pool: Pool, clock: Clock, *, is_sham: bool = False
) -> FaultResult:
    """Inject one fault in all its ways.

    Args:
        row: Row of the catalogue.
        seed: Seed of everything that is random.
        folder: Parent of the temporary folders.
        pool: Pool of daemons.
        clock: Clock of the machine.
        is_sham: True if no fault is injected.
    """
    known = injections().get(row.id, [])
    inject = _run_sham if is_sham else run_injection
    parts = [await inject(injection, seed, folder, pool, clock) for injection in known]
    return result_of(row, seed, parts or [InjectionResult("", "", "not_run", NO_INJECTION, 0.0)])


async def run_injection(injection: Injection, seed: int, folder: Path, pool: Pool, clock: Clock) -> InjectionResult:
    """Run one injection in a temporary folder.

    Args:
        injection: Injection to run.
        seed: Seed of everything that is random.
        folder: Parent of the temporary folder.
        pool: Pool of daemons.
        clock: Clock of the machine.
    """
    started, limit = clock.monotonic(), None
    with tempfile.TemporaryDirectory(dir=folder, ignore_cleanup_errors=True) as own:
        lab = Lab(seed, Path(own), pool)
        try:
            require(injection.needs)
            with recorded_tries() as tried:
                async with clock.timeout(injection.deadline) as limit:
                    evidence = await injection.run(lab)
        except NotRun as error:
            return InjectionResult(injection.name, injection.how, "not_run", error.text, clock.monotonic() - started)
        except Exception as error:  # any error of an injection fails only this fault
            kind = error.code if isinstance(error, PcmrsError) else type(error).__name__
            details = {"daemon": lab.log_tail(), "where": _where(error), "error": kind}
            seconds = clock.monotonic() - started
            # Not by the time: the loop's timers may expire some hundred microseconds early.
            late = isinstance(error, TimeoutError) and limit is not None and limit.expired()
            text = f"not ended within {injection.deadline:g} s" if late else _text(error)
            return InjectionResult(injection.name, injection.how, "failed", text, seconds, details)
    seconds = clock.monotonic() - started
    missing = evidence.missing(catalogue()[injection.fault].fault_class)
    measured = evidence.measured
    if injection.tries and not in_sham():
        missing = missing or difference(injection.tries, tried)
        measured["tried"] = listed(tried)
    outcome: Outcome = "not_proved" if missing else "passed"
    return InjectionResult(injection.name, injection.how, outcome, missing or evidence.response, seconds, measured)


async def _run_sham(injection: Injection, seed: int, folder: Path, pool: Pool, clock: Clock) -> InjectionResult:
    """Run a row without its fault; it has passed if it detected that its fault was not injected."""
    with sham() as injecting:
        part = await run_injection(injection, seed, folder, pool, clock)
    if part.outcome == "not_run":
        return part
    found = part.outcome == "not_proved" or part.details.get("error") == Unmet.code
    if found and injecting.reached:
        return msgspec.structs.replace(part, outcome="passed")
    before = "Before its fault" if found else "Without its fault"
    outcome = "failed" if found else part.outcome
    return msgspec.structs.replace(part, outcome="failed", response=f"{before} it {outcome}: {part.response}")


def _text(error: Exception) -> str:
    if isinstance(error, Unmet):
        return error.text
    return f"{type(error).__name__}: {error.text if isinstance(error, PcmrsError) else error}"


def _where(error: Exception) -> str:
    """Return file and line at which the error was raised."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{Path(last.filename).name}:{last.lineno}"
