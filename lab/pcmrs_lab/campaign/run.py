"""Runs a campaign: every fault with every seed, each with a deadline, several at a time."""

from __future__ import annotations

import asyncio
import tempfile
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec

import pcmrs
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

NO_INJECTION = "this version has no injection for it"

ShowProgress = Callable[[str, int, int], None]
"""Called with the current fault, and with how many of how many faults are done."""


async def run_campaign(
    rows: Sequence[CatalogueRow],
    seeds: Sequence[int],
    jobs: int = 1,
    progress: ShowProgress = lambda *_: None,
    *,
    is_sham: bool = False,
) -> CampaignReport:
    """Inject every fault with every seed; a fault that hangs, fails or raises does not prevent the others.

    Args:
        rows: Rows of the catalogue.
        seeds: Seeds of everything that is random.
        jobs: Number of faults at a time, each with separate daemons.
        progress: Called before each fault.
        is_sham: True if no fault is injected; an injection has passed if it detects that.

    Returns:
        Report of all results.
    """
    clock = SystemClock()
    started = clock.monotonic()
    waiting = [(row, seed) for seed in seeds for row in rows]
    total, results = len(waiting), list[FaultResult]()
    waiting.reverse()

    async def work() -> None:
        with tempfile.TemporaryDirectory(prefix="pcmrs-faults-", ignore_cleanup_errors=True) as name:
            pool = Pool(Path(name))
            try:
                while waiting:
                    row, seed = waiting.pop()
                    progress(f"{row.id} {row.title}"[:40], len(results), total)
                    results.append(await run_fault(row, seed, Path(name), pool, clock, is_sham=is_sham))
            finally:
                await pool.close()

    await asyncio.gather(*(work() for _ in range(min(jobs, total))))
    progress("done", total, total)
    order = {(row.id, seed): number for number, (row, seed) in enumerate((r, s) for r in rows for s in seeds)}
    results.sort(key=lambda result: order[result.id, result.seed])
    return CampaignReport(
        simulated=True,
        version=pcmrs.__version__,
        seeds=list(seeds),
        seconds=clock.monotonic() - started,
        faults=results,
        summary=summarize(results),
        sham=is_sham,
    )


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
    run = _run_sham if is_sham else run_injection
    parts = [await run(injection, seed, folder, pool, clock) for injection in known]
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
    started = clock.monotonic()
    with tempfile.TemporaryDirectory(dir=folder, ignore_cleanup_errors=True) as own:
        lab = Lab(seed, Path(own), pool)
        try:
            require(injection.needs)
            with recorded_tries() as tried:
                async with clock.timeout(injection.deadline):
                    evidence = await injection.run(lab)
        except NotRun as error:
            return InjectionResult(injection.name, injection.how, "not_run", error.text, clock.monotonic() - started)
        except Exception as error:  # any error of an injection fails only this fault
            kind = error.code if isinstance(error, PcmrsError) else type(error).__name__
            details = {"daemon": lab.log_tail(), "where": _where(error), "error": kind}
            seconds = clock.monotonic() - started
            late = isinstance(error, TimeoutError) and seconds >= injection.deadline
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
    with sham() as run:
        part = await run_injection(injection, seed, folder, pool, clock)
    if part.outcome == "not_run":
        return part
    found = part.outcome == "not_proved" or part.details.get("error") == Unmet.code
    if found and run.reached:
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
