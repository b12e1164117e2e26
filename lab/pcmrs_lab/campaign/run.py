"""Runs a campaign: every fault with every seed, each with a deadline, several at a time."""

from __future__ import annotations

import asyncio
import tempfile
import traceback
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from pathlib import Path

import msgspec

import pcmrs
from pcmrs.clock import Clock, SystemClock
from pcmrs.errors import PcmrsError
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.catalogue import CatalogueRow
from pcmrs_lab.campaign.fault import Injection, NotRun
from pcmrs_lab.campaign.injections import injections
from pcmrs_lab.campaign.lab import Lab, Pool
from pcmrs_lab.campaign.report import CampaignReport, FaultResult, InjectionResult, Outcome, result_of, summarize
from pcmrs_lab.campaign.sham import sham
from pcmrs_lab.campaign.tools import require

NO_INJECTION = "nothing in this version injects it"

ShowProgress = Callable[[str, int, int], None]
"""Told what has just been found, and how many of how many faults are done."""


async def run_campaign(
    rows: Sequence[CatalogueRow],
    seeds: Sequence[int],
    jobs: int = 1,
    progress: ShowProgress = lambda *_: None,
    *,
    is_sham: bool = False,
) -> CampaignReport:
    """Injects every fault with every seed; one that hangs, fails or raises keeps none of the others from being run.

    Args:
        rows: Of the catalogue.
        seeds: Of everything that is random in them.
        jobs: So many at a time, each with daemons of its own.
        progress: Told after each.
        is_sham: No fault takes place, and every way must find that: it has passed then.
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
        seconds=clock.monotonic() - begun,
        faults=results,
        summary=summarize(results),
        sham=is_sham,
    )


async def run_fault(
    row: CatalogueRow, seed: int, folder: Path, pool: Pool, clock: Clock, *, is_sham: bool = False
) -> FaultResult:
    """Injects one fault in all ways in which it can be."""
    known = injections().get(row.id, [])
    if known:
        with sham() if is_sham else nullcontext():
            parts = [await run_injection(injection, seed, folder, pool, clock) for injection in known]
        if is_sham:
            parts = list(map(_found_out, parts))
    else:
        parts = [InjectionResult("", "", "not_run", NO_INJECTION, 0.0)]
    return result_of(row, seed, parts)


async def run_injection(injection: Injection, seed: int, folder: Path, pool: Pool, clock: Clock) -> InjectionResult:
    """Injects a fault in one way, in a folder that goes away."""
    begun = clock.monotonic()
    with tempfile.TemporaryDirectory(dir=folder, ignore_cleanup_errors=True) as own:
        lab = Lab(seed, Path(own), pool)
        try:
            require(injection.needs)
            async with clock.timeout(injection.deadline):
                evidence = await injection.run(lab)
        except NotRun as error:
            return InjectionResult(injection.name, injection.how, "not_run", error.text, clock.monotonic() - begun)
        except Exception as error:  # whatever an injection raises is a failure of this fault alone
            kind = error.code if isinstance(error, PcmrsError) else type(error).__name__
            details = {"daemon": lab.log_tail(), "where": _where(error), "error": kind}
            seconds = clock.monotonic() - begun
            late = isinstance(error, TimeoutError) and seconds >= injection.deadline
            text = f"not ended within {injection.deadline:g} s" if late else _text(error)
            return InjectionResult(injection.name, injection.how, "failed", text, seconds, details)
    seconds, missing = clock.monotonic() - begun, evidence.missing
    outcome: Outcome = "not_proved" if missing else "passed"
    return InjectionResult(
        injection.name, injection.how, outcome, missing or evidence.response, seconds, evidence.measured
    )


def _found_out(part: InjectionResult) -> InjectionResult:
    """What a sham way has come to: it has passed when the row said by itself that its fault did not take place."""
    if part.outcome == "not_run":
        return part
    found = part.outcome == "not_proved" or part.details.get("error") == Unmet.code
    said = part.response if found else f"Without its fault it {part.outcome}: {part.response}"
    return msgspec.structs.replace(part, outcome="passed" if found else "failed", response=said)


def _text(error: Exception) -> str:
    if isinstance(error, Unmet):
        return error.text
    return f"{type(error).__name__}: {error.text if isinstance(error, PcmrsError) else error}"


def _where(error: Exception) -> str:
    """File and line in which the error came up."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{Path(last.filename).name}:{last.lineno}"
