"""Report of a campaign: for every fault and seed whether the required response was seen.

It is written as JSON for programs and as one page of HTML for people.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import msgspec

from pcmrs.report.pages import render
from pcmrs_lab.campaign.catalogue import CLASSES, RESPONSES, CatalogueRow

Outcome = Literal["passed", "failed", "not_proved", "not_run"]
OUTCOMES: tuple[Outcome, ...] = ("passed", "failed", "not_proved", "not_run")
"""``not_proved``: the response came, but the fault itself, or its effect without the protection, was not measured."""
_WORST_FIRST: tuple[Outcome, ...] = ("failed", "not_proved", "not_run", "passed")


class InjectionResult(msgspec.Struct, frozen=True):
    """Result of one injection of a fault.

    Attributes:
        name: Name of the injection.
        how: Means of injection.
        response: Response that was seen; the reason if it was not run.
        seconds: Duration, s of the machine.
        details: Measured values; of a failure, the end of the daemon's log.
        outcome: Outcome.
    """

    name: str
    how: str
    outcome: Outcome
    response: str
    seconds: float
    details: dict[str, Any] = {}


class FaultResult(msgspec.Struct, frozen=True, rename={"fault_class": "class"}):
    """Result of one fault with one seed, over all its injections.

    Attributes:
        outcome: ``passed`` if all passed, ``failed`` if one failed; ``not_proved`` or ``not_run`` if one was, and none
            worse.
        how: Means of all injections.
        response: Response that was seen.
        required: Required response.
        reference: Known wrong behaviour of the reference implementation; empty if none is known.
        seconds: Duration, s of the machine.
    """

    id: str
    fault_class: str
    title: str
    outcome: Outcome
    how: str
    response: str
    required: str
    reference: str
    seed: int
    seconds: float
    parts: list[InjectionResult]


class CampaignReport(msgspec.Struct, frozen=True):
    """All results, in the order of the catalogue.

    Attributes:
        seeds: Seeds with which every fault was injected.
        seconds: Duration, s of the machine.
        sham: True if no fault was injected; an injection has passed if it has detected that.
        summary: Number of results with each outcome, by class.
    """

    simulated: bool
    version: str
    seeds: list[int]
    seconds: float
    faults: list[FaultResult]
    summary: dict[str, dict[Outcome, int]]
    sham: bool = False

    @property
    def failed(self) -> list[FaultResult]:
        """Faults whose required response was not seen, or not proved."""
        return [result for result in self.faults if result.outcome in ("failed", "not_proved")]


def result_of(row: CatalogueRow, seed: int, parts: list[InjectionResult]) -> FaultResult:
    """Combine the parts of one fault: one failure fails it, and a part that was not proved or not run is not passed.

    Args:
        row: CatalogueRow of the catalogue.
        seed: Seed of the injections.
        parts: Results of the injections; at least one.
    """
    found = {part.outcome for part in parts}
    outcome = next(each for each in _WORST_FIRST if each in found)
    decisive = [part for part in parts if part.outcome == outcome]
    return FaultResult(
        id=row.id,
        fault_class=row.fault_class,
        title=row.title,
        outcome=outcome,
        how="; ".join(dict.fromkeys(part.how for part in parts if part.how)),
        response="; ".join(dict.fromkeys(part.response for part in decisive)),
        required=row.required,
        reference=row.reference,
        seed=seed,
        seconds=sum(part.seconds for part in parts),
        parts=parts,
    )


def summarize(results: list[FaultResult]) -> dict[str, dict[Outcome, int]]:
    """Return the number of results with each outcome, for each class with results."""
    counts: dict[str, dict[Outcome, int]] = {}
    for fault_class in CLASSES:
        of_class = [result.outcome for result in results if result.fault_class == fault_class]
        if of_class:
            counts[fault_class] = {outcome: of_class.count(outcome) for outcome in OUTCOMES}
    return counts


JSON_NAME = "faults.json"
PAGE_NAME = "faults.html"
TEMPLATE = "faults.html.j2"
MARKS = {"passed": "✓", "failed": "✗", "not_proved": "?", "not_run": "–"}


def write_report(report: CampaignReport, folder: Path) -> None:
    """Write both files into an existing folder; raise `OSError` if that fails.

    Args:
        report: Report to write.
        folder: Existing folder.
    """
    (folder / JSON_NAME).write_bytes(msgspec.json.format(msgspec.json.encode(report), indent=1) + b"\n")
    (folder / PAGE_NAME).write_text(render_page(report), encoding="utf-8")


def render_page(report: CampaignReport) -> str:
    """Return the report as an HTML page without scripts and external resources."""
    totals = {outcome: sum(found[outcome] for found in report.summary.values()) for outcome in OUTCOMES}
    ids = len({result.id for result in report.faults})
    return render(
        "pcmrs_lab.campaign", TEMPLATE, values,
        report=report, totals=totals, ids=ids, outcomes=OUTCOMES, marks=MARKS, responses=RESPONSES,
    )  # fmt: skip


def values(details: dict[str, object]) -> str:
    """Return measured values in one line."""
    return ", ".join(f"{name.replace('_', ' ')} {_value(value)}" for name, value in details.items())


def _value(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
