"""The page of a session with stimulation; all values enter its template as text, never as markup."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pcmrs.analysis.nibs_tables import ALGORITHMS
from pcmrs.analysis.session import PulseRecord, SessionRecord
from pcmrs.report.pages import NONE, PNG, SVG, embedded, fixed, render, utc
from pcmrs.report.stimulation.facts import facts_of

KINDS = {".svg": SVG, ".png": PNG}
TEMPLATE = "report.html.j2"
METHODS = {"adaptive": "adaptive, by a Gaussian process", "grid": "grid, every place in order"}


def render_report(record: SessionRecord, pictures: Mapping[str, Path]) -> str:
    """Return the report as HTML.

    Args:
        record: The session.
        pictures: Figures from `draw_figures`.

    Raises:
        OSError: A picture cannot be read.
    """
    return render(
        "pcmrs.report.stimulation",
        TEMPLATE,
        fixed,
        plain,
        minutes,
        date,
        times,
        record=record,
        facts=facts_of(record),
        pictures={name: embedded(path.read_bytes(), KINDS[path.suffix]) for name, path in pictures.items()},
        algorithms=ALGORITHMS,
        methods=METHODS,
        flags=flags,
    )


def plain(value: float | None) -> str:
    """Return a number with as many decimals as it needs, two at most."""
    return NONE if value is None else f"{value:.2f}".rstrip("0").rstrip(".").replace("-", "−")


def times(value: float | None, factor: float) -> float | None:
    """Return a number in another unit; None if it is missing.

    Args:
        value: Number, or None.
        factor: Factor into the other unit.
    """
    return None if value is None else value * factor


def minutes(seconds: float) -> str:
    """Return a duration in minutes and seconds."""
    whole = round(seconds)
    return f"{whole // 60}:{whole % 60:02d}"


def date(unix: float) -> str:
    """Return day and time, UTC."""
    return utc(unix, "%Y-%m-%d %H:%M UTC")


def flags(pulse: PulseRecord) -> str:
    """Return the note on a pulse in the table: its problem, or whether it evoked a response."""
    if pulse.problem:
        return f"does not count ({pulse.problem.replace('_', ' ')})"
    return "yes" if pulse.mep is not None and pulse.mep.present else "none"
