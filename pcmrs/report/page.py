"""The page of a report; all values enter its template as text, never as markup."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import msgspec

from pcmrs.analysis.placements import Summary, summarize
from pcmrs.report._contents import ReportedPlacement, ReportedRefusal, ReportedRegistration, SessionReport
from pcmrs.report.pages import SVG, embedded, fixed, render, utc

__all__ = ["render_page"]

TEMPLATE: Final = "report.html.j2"
MOST_PLACEMENTS: Final = 4
"""Largest number of placements on the first page."""
MOST_LINES: Final = 3
"""Largest number of lines of each kind on the first page; the details have all."""
MOST_CHARACTERS: Final = 105
"""Largest number of characters of a text on the first page."""
MOST_ROWS: Final = 1000
"""Largest number of lines of a table; the journal has all."""
UNITS: Final = {"residual_too_large": ("mm", 1e3), "tre_too_large": ("mm", 1e3)}
"""Unit of a gate, and the factor into it; gates without a unit are missing."""


class FirstPage(msgspec.Struct, frozen=True, kw_only=True):
    """Summary on the first page.

    Attributes:
        shown: Placements in its table: all, or those with the largest errors.
        registration: Last registration.
        tre_mm: Error predicted for the last plan, or by the last registration that predicts one, rms.
        tre_at: Point for which it was predicted.
        important: Refused and failed operations, the most severe first; unknown ones are listed elsewhere.
    """

    placement_mm: Summary | None
    placement_deg: Summary | None
    shown: tuple[ReportedPlacement, ...]
    registration: ReportedRegistration | None
    tre_mm: float | None
    tre_at: str
    important: tuple[ReportedRefusal, ...]


def render_page(report: SessionReport, figures: Mapping[str, bytes]) -> str:
    """Return the report as HTML without scripts and external resources.

    Args:
        report: Contents of the report.
        figures: Figures from `draw_figures`.
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
        first=MOST_LINES,
        most=MOST_ROWS,
    )


def summarized(report: SessionReport) -> FirstPage:
    """Return the summary of the first page."""
    placements = report.placements
    largest = sorted(placements, key=lambda each: -each.error_mm)[:MOST_PLACEMENTS]
    shown = tuple(each for each in placements if each in largest)
    registration = report.registrations[-1] if report.registrations else None
    predicted = [(plan.sequence, plan.tre_mm, "the planned pose") for plan in report.plans] or [
        (each.sequence, each.tre_mm, "the planned pose" if each.target == "plan" else "the middle of the landmarks")
        for each in report.registrations
    ]
    known = [(tre, at) for _, tre, at in predicted if tre is not None]
    return FirstPage(
        placement_mm=summarize([each.error_mm for each in placements]) if placements else None,
        placement_deg=summarize([each.error_deg for each in placements]) if placements else None,
        shown=shown,
        registration=registration,
        tre_mm=known[-1][0] if known else None,
        tre_at=known[-1][1] if known else "",
        important=tuple(sorted((each for each in report.refusals if each.decision != "unknown"), key=_gravity)),
    )


def _gravity(refusal: ReportedRefusal) -> tuple[int, int]:
    """Return a sort key: failed, then refused by a check, then sent at a wrong time; each in order."""
    rank = 0 if refusal.decision == "failed" else 1 if refusal.checked else 2
    return rank, refusal.sequence


def date(wall: float) -> str:
    """Return day and time, UTC."""
    return utc(wall, "%Y-%m-%d %H:%M")


def clock(wall: float) -> str:
    """Return the time of the day, UTC."""
    return utc(wall, "%H:%M:%S")


def minutes(seconds: float) -> str:
    """Return a duration in hours, minutes and seconds."""
    whole = round(seconds)
    hours, rest = divmod(whole, 3600)
    return f"{hours} h {rest // 60} min" if hours else f"{rest // 60} min {rest % 60} s"


def words(operation: str) -> str:
    """Return an operation in words: ``placement.back_off`` is "back off (placement)"."""
    branch, _, name = operation.partition(".")
    return f"{name.replace('_', ' ')} ({branch})" if name else operation.replace("_", " ")


def clipped(text: str) -> str:
    """Return a text, shortened for the first page."""
    return text if len(text) <= MOST_CHARACTERS else f"{text[: MOST_CHARACTERS - 1].rstrip(' .')}…"


def share(value: float | None, limit: float | None) -> int | None:
    """Return a value as a share of its limit, percent, 100 at most; None if one is missing.

    Args:
        value: Value.
        limit: Limit, in the same unit.
    """
    return None if value is None or not limit else round(min(100.0, 100.0 * value / limit))


def gate_value(value: float, name: str) -> str:
    """Return a value or limit of a gate with its unit.

    Args:
        value: Value, lengths in m.
        name: Name of the gate.
    """
    unit, factor = UNITS.get(name, ("", 1.0))
    return f"{value * factor:.4g} {unit}".rstrip()
