"""Table of the threshold experiment."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.table import Table

from pcmrs_lab.experiment.thresholds import METHODS, MethodResult, ThresholdReport


def threshold_table(report: ThresholdReport) -> Table:
    """Return the pulses and errors of every method on the same subjects."""
    title = f"Motor thresholds of {report.subjects} simulated subjects, seed {report.seed}"
    caption = (
        f"Errors in % of the threshold (median {report.threshold.median:.1f} % of the maximum stimulator output, MSO) "
        f"and in % MSO; interval: share of the stated 95 % intervals that contain the true threshold. Maximum "
        f"likelihood ends when the interval is narrower than {100.0 * report.interval:g} % of the threshold."
    )
    table = Table(title=title, caption=caption, box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    columns = ("method", "pulses", "p95", "error", "p95", "% MSO", "p95", "bias % MSO", "interval", "refused")
    for index, name in enumerate(columns):
        table.add_column(name, justify="right" if index else "left", no_wrap=True)
    for result in report.methods:
        table.add_row(*_row(result))
    return table


def _row(result: MethodResult) -> tuple[str, ...]:
    return (
        METHODS[result.method],
        f"{result.pulses.median:g}",
        f"{result.pulses.p95:.0f}",
        f"{result.error_percent.median:.2f} %",
        f"{result.error_percent.p95:.2f} %",
        f"{result.error_mso.median:.2f}",
        f"{result.error_mso.p95:.2f}",
        f"{result.bias_mso:+.2f}",
        "" if result.held is None else f"{100.0 * result.held:.1f} %",
        str(result.refused),
    )
