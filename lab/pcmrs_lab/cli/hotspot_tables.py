"""Table of the hot-spot experiment."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.table import Table

from pcmrs_lab.experiment.hotspots import HotspotReport, HotspotResult, SubjectQuantiles

NAMES = {"adaptive": "adaptive", "grid": "grid"}


def hotspot_table(report: HotspotReport) -> Table:
    """Return the pulses and errors of every method on the same subjects."""
    title = f"Hot-spots of {report.subjects} simulated subjects, seed {report.seed}"
    expected = report.expected_mm
    caption = (
        f"Pulses at {report.intensity:g} % of the subject's threshold. Every search starts at the usual place, "
        f"{_number(expected.median, 1)} mm from the hot-spot in the median (p95 {_number(expected.p95, 1)} mm). "
        "To 5 mm: pulses after which the estimate stays within 5 mm; a search that does not end there counts as "
        "infinite. Then: pulses of whole searches, their error, that of the handle, and the stated uncertainty of the "
        "place, mm."
    )
    table = Table(title=title, caption=caption, box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    columns = ("method", "ends near", "to 5 mm", "p95", "pulses", "p95", "mm", "p95", "handle °", "p95")
    for index, name in enumerate((*columns, "stated", "no MEP")):
        table.add_column(name, justify="right" if index else "left", no_wrap=True)
    for result in report.methods:
        table.add_row(*_row(result))
    return table


def _row(result: HotspotResult) -> tuple[str, ...]:
    return (
        NAMES[result.method],
        f"{100.0 * result.near:.1f} %",
        *_both(result.pulses_until_near, 0),
        *_both(result.pulses, 0),
        *_both(result.error_mm, 2),
        *_both(result.heading_error_deg, 1),
        _number(result.uncertainty_mm.median, 2),
        str(result.unanswered),
    )


def _both(spread: SubjectQuantiles, digits: int) -> tuple[str, str]:
    return _number(spread.median, digits), _number(spread.p95, digits)


def _number(value: float | None, digits: int) -> str:
    return "never" if value is None else f"{value:.{digits}f}"
