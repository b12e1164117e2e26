"""The page: what is known goes into a template as text, never as markup."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import msgspec

from pcmrs.analysis.placements import Summary, summarize
from pcmrs.report.contents import ReportedPlacement, ReportedRefusal, ReportedRegistration, SessionReport
from pcmrs.report.pages import SVG, embedded, fixed, render, utc

TEMPLATE: Final = "report.html.j2"
PLACED: Final = 4
"""So many placements are on the first page."""
FIRST: Final = 3
"""So many lines of each kind are on the first page; all are in the details."""
CLIPPED: Final = 105
"""So many characters of a text are on the first page."""
MOST: Final = 1000
"""So many lines of a table are shown; the journal has all."""
UNITS: Final = {"residual_too_large": ("mm", 1e3), "tre_too_large": ("mm", 1e3)}
"""Unit of a gate that has one, and by what its value is to be multiplied."""


class FirstPage(msgspec.Struct, frozen=True, kw_only=True):
    """What the first page has in large letters.

    Attributes:
        shown: The placements in its table: all, or those with the largest errors.
        registration: The last one.
        tre_mm: Predicted for the last plan, or by the last registration that predicts one.
        tre_at: Where that is.
        important: What was refused or failed, the gravest first; what is unknown is told apart.
    """

    placement_mm: Summary | None
    placement_deg: Summary | None
    shown: tuple[ReportedPlacement, ...]
    registration: ReportedRegistration | None
    tre_mm: float | None
    tre_at: str
    important: tuple[ReportedRefusal, ...]


def render_page(report: SessionReport, figures: Mapping[str, bytes]) -> str:
    """The report as HTML that needs no script and nothing from outside.

    Args:
        report: The session.
        figures: As `draw_figures` returns them.
    """
    return render(
        "pcmrs.report",
        TEMPLATE,
        fixed,
        clock,
        date,
        minutes,
        words,
        clipped,
        share,
        gate_value,
        report=report,
        sums=summarized(report),
        figures={name: embedded(drawing, SVG) for name, drawing in figures.items()},
        meanings={branch.name: branch.states for branch in report.branches},
        first=FIRST,
        most=MOST,
    )


def summarized(report: SessionReport) -> FirstPage:
    """The few numbers of the first page."""
    placements = report.placements
    largest = sorted(placements, key=lambda each: -each.error_mm)[:PLACED]
    shown = tuple(each for each in placements if each in largest)
    registration = report.registrations[-1] if report.registrations else None
    predicted = [(plan.sequence, plan.tre_mm, "the planned pose") for plan in report.plans] or [
        (each.sequence, each.tre_mm, "the planned pose" if each.target == "plan" else "the middle of the landmarks")
        for each in report.registrations
    ]
    told = [(tre, at) for _, tre, at in predicted if tre is not None]
    return FirstPage(
        placement_mm=summarize([each.error_mm for each in placements]) if placements else None,
        placement_deg=summarize([each.error_deg for each in placements]) if placements else None,
        shown=shown,
        registration=registration,
        tre_mm=told[-1][0] if told else None,
        tre_at=told[-1][1] if told else "",
        important=tuple(sorted((each for each in report.refusals if each.decision != "unknown"), key=_gravity)),
    )


def _gravity(refusal: ReportedRefusal) -> tuple[int, int]:
    """Failed before refused by a check before asked for at a wrong time; then in order."""
    rank = 0 if refusal.decision == "failed" else 1 if refusal.checked else 2
    return rank, refusal.sequence


def date(wall: float) -> str:
    """Day and time, UTC."""
    return utc(wall, "%Y-%m-%d %H:%M")


def clock(wall: float) -> str:
    """Time of the day, UTC."""
    return utc(wall, "%H:%M:%S")


def minutes(seconds: float) -> str:
    """Hours, minutes and seconds."""
    whole = round(seconds)
    hours, rest = divmod(whole, 3600)
    return f"{hours} h {rest // 60} min" if hours else f"{rest // 60} min {rest % 60} s"


def words(operation: str) -> str:
    """An operation as people say it: ``placement.back_off`` is "back off (placement)"."""
    branch, _, name = operation.partition(".")
    return f"{name.replace('_', ' ')} ({branch})" if name else operation.replace("_", " ")


def clipped(text: str) -> str:
    """As much of a text as the first page has room for."""
    return text if len(text) <= CLIPPED else f"{text[: CLIPPED - 1].rstrip(' .')}…"


def share(value: float | None, limit: float | None) -> int | None:
    """A value against its limit, percent, 100 at most; None where there is none."""
    return None if value is None or not limit else round(min(100.0, 100.0 * value / limit))


def gate_value(value: float, name: str) -> str:
    """A value or limit of a gate, with its unit where it has one."""
    unit, factor = UNITS.get(name, ("", 1.0))
    return f"{value * factor:.4g} {unit}".rstrip()
