"""The page itself: what is known goes into a template, as text, never as markup."""

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
    """The report as HTML.

    Args:
        record: The session.
        pictures: As `draw_figures` returns them.

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
    """A number with as many decimals as it needs, two at most."""
    return NONE if value is None else f"{value:.2f}".rstrip("0").rstrip(".").replace("-", "−")


def times(value: float | None, factor: float) -> float | None:
    """A number in another unit, where there is one."""
    return None if value is None else value * factor


def minutes(seconds: float) -> str:
    """Minutes and seconds."""
    whole = round(seconds)
    return f"{whole // 60}:{whole % 60:02d}"


def date(unix: float) -> str:
    """Day and time, UTC."""
    return utc(unix, "%Y-%m-%d %H:%M UTC")


def flags(pulse: PulseRecord) -> str:
    """What is to be said of a pulse in one cell of a table."""
    if pulse.problem:
        return f"does not count ({pulse.problem.replace('_', ' ')})"
    return "yes" if pulse.mep is not None and pulse.mep.present else "none"
