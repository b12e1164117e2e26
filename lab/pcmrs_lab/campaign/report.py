"""What a campaign has found: for every fault and seed whether the required response was seen.

The report of a campaign as files: JSON for programs, one page of HTML for people.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import msgspec

from pcmrs.report.pages import render
from pcmrs_lab.campaign.catalogue import CLASSES, RESPONSES, CatalogueRow

Outcome = Literal["passed", "failed", "not_proved", "not_run"]
OUTCOMES: tuple[Outcome, ...] = ("passed", "failed", "not_proved", "not_run")
"""``not_proved``: the response came, but it was not measured that the fault took place, or what happens without the
protection."""
_WORST_FIRST: tuple[Outcome, ...] = ("failed", "not_proved", "not_run", "passed")


class InjectionResult(msgspec.Struct, frozen=True):
    """One way in which a fault was injected.

    Attributes:
        name: Of the injection.
        how: By what means.
        response: What was seen; where it was not run, why.
        seconds: How long it took, s of the machine.
        details: Measured values; of a failure, the last words of the daemon.
    """

    name: str
    how: str
    outcome: Outcome
    response: str
    seconds: float
    details: dict[str, Any] = {}


class FaultResult(msgspec.Struct, frozen=True, rename={"fault_class": "class"}):
    """One fault with one seed, in all ways in which it was injected.

    Attributes:
        outcome: ``passed`` when all of them passed, ``failed`` when one failed; ``not_proved`` and ``not_run`` when
            one was so, and none worse.
        how: By what means, all of them.
        response: What was seen.
        required: What must be seen.
        reference: What the reference implementation does; empty where nothing wrong is known of it.
        seconds: How long it took, s of the machine.
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
    """All results, in the catalogue's order.

    Attributes:
        seeds: Every fault was injected with each of these.
        seconds: How long all of it took, s of the machine.
        sham: No fault took place; a way has passed when it has found that.
        summary: Class to how many results had each outcome.
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
        """Faults of which the required response was not seen, or not proved."""
        return [result for result in self.faults if result.outcome in ("failed", "not_proved")]


def result_of(row: CatalogueRow, seed: int, parts: list[InjectionResult]) -> FaultResult:
    """Puts the parts of one fault together: one failure fails it, and what was not proved or not run is not passed."""
    found = {part.outcome for part in parts}
    outcome = next(each for each in _WORST_FIRST if each in found)
    telling = [part for part in parts if part.outcome == outcome]
    return FaultResult(
        id=row.id,
        fault_class=row.fault_class,
        title=row.title,
        outcome=outcome,
        how="; ".join(dict.fromkeys(part.how for part in parts if part.how)),
        response="; ".join(dict.fromkeys(part.response for part in telling)),
        required=row.required,
        reference=row.reference,
        seed=seed,
        seconds=sum(part.seconds for part in parts),
        parts=parts,
    )


def summarize(results: list[FaultResult]) -> dict[str, dict[Outcome, int]]:
    """Class to how many results had each outcome, for the classes that there are results of."""
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
    """Writes both files into a folder that exists. Raises `OSError` when that cannot be done."""
    (folder / JSON_NAME).write_bytes(msgspec.json.format(msgspec.json.encode(report), indent=1) + b"\n")
    (folder / PAGE_NAME).write_text(render_page(report), encoding="utf-8")


def render_page(report: CampaignReport) -> str:
    """The report as a page that needs no script and nothing from outside."""
    totals = {outcome: sum(found[outcome] for found in report.summary.values()) for outcome in OUTCOMES}
    ids = len({result.id for result in report.faults})
    return render(
        "pcmrs_lab.campaign", TEMPLATE, values,
        report=report, totals=totals, ids=ids, outcomes=OUTCOMES, marks=MARKS, responses=RESPONSES,
    )  # fmt: skip


def values(details: dict[str, object]) -> str:
    """Measured values in one line."""
    return ", ".join(f"{name.replace('_', ' ')} {_value(value)}" for name, value in details.items())


def _value(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
