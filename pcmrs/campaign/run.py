"""Runs a campaign: every fault with every seed, each with a deadline, several at a time."""

from __future__ import annotations

import asyncio
import tempfile
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path

import pcmrs
from pcmrs.campaign.catalogue import Row
from pcmrs.campaign.fault import Injection, NotRun, Unmet, injections
from pcmrs.campaign.lab import Lab, Pool
from pcmrs.campaign.report import CampaignReport, FaultResult, Part, result_of, summarize
from pcmrs.campaign.tools import require
from pcmrs.clock import Clock, SystemClock
from pcmrs.errors import PcmrsError

NO_INJECTION = "nothing in this version injects it"

ShowProgress = Callable[[str, int, int], None]
"""Told what has just been found, and how many of how many faults are done."""


async def run_campaign(
    rows: Sequence[Row], seeds: Sequence[int], jobs: int = 1, progress: ShowProgress = lambda *_: None
) -> CampaignReport:
    """Injects every fault with every seed; one that hangs, fails or raises keeps none of the others from being run.

    Args:
        rows: Of the catalogue.
        seeds: Of everything that is random in them.
        jobs: So many at a time, each with daemons of its own.
        progress: Told after each.
    """
    clock = SystemClock()
    begun = clock.monotonic()
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
                    results.append(await run_fault(row, seed, Path(name), pool, clock))
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
        seconds=clock.monotonic() - begun,
        faults=results,
        summary=summarize(results),
    )


async def run_fault(row: Row, seed: int, folder: Path, pool: Pool, clock: Clock) -> FaultResult:
    """Injects one fault in all ways in which it can be."""
    known = injections().get(row.id, [])
    if known:
        parts = [await run_injection(injection, seed, folder, pool, clock) for injection in known]
    else:
        parts = [Part("", "", "not_run", NO_INJECTION, 0.0)]
    return result_of(row, seed, parts)


async def run_injection(injection: Injection, seed: int, folder: Path, pool: Pool, clock: Clock) -> Part:
    """Injects a fault in one way, in a folder that goes away."""
    begun = clock.monotonic()
    with tempfile.TemporaryDirectory(dir=folder, ignore_cleanup_errors=True) as own:
        lab = Lab(seed, Path(own), pool)
        try:
            require(injection.needs)
            async with clock.timeout(injection.deadline):
                evidence = await injection.run(lab)
        except NotRun as error:
            return Part(injection.name, injection.how, "not_run", error.text, clock.monotonic() - begun)
        except Exception as error:  # whatever an injection raises is a failure of this fault alone
            details = {"daemon": lab.last_words(), "where": _where(error)}
            seconds = clock.monotonic() - begun
            late = isinstance(error, TimeoutError) and seconds >= injection.deadline
            text = f"not ended within {injection.deadline:g} s" if late else _text(error)
            return Part(injection.name, injection.how, "failed", text, seconds, details)
    seconds = clock.monotonic() - begun
    return Part(injection.name, injection.how, "passed", evidence.response, seconds, evidence.details)


def _text(error: Exception) -> str:
    if isinstance(error, Unmet):
        return error.text
    return f"{type(error).__name__}: {error.text if isinstance(error, PcmrsError) else error}"


def _where(error: Exception) -> str:
    """File and line in which the error came up."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{Path(last.filename).name}:{last.lineno}"
