"""The Monte Carlo of the failure injections as tables."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.console import Group
from rich.table import Table

from pcmrs_lab.cli.tables import spread
from pcmrs_lab.experiment.monte_carlo import FIXED_LIMIT, OFFSET, MonteCarloReport, RowRates


def monte_carlo_tables(report: MonteCarloReport) -> Group:
    """What happened in every row, and how often each gate decides wrongly."""
    return Group(_rows(report), _rates(report), *_noise(report))


def _rows(report: MonteCarloReport) -> Table:
    title = f"Failure injections, {report.runs} runs of each row, seed {report.seed}: simulated, without a daemon"
    table = Table(title=title, box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for name in ("run", "workflow", "injection", "refused", "outlier", "residual", "named", "mm", "paper "):
        table.add_column(name, justify="left" if name in ("workflow", "injection") else "right", no_wrap=True)
    for row in report.rows:
        table.add_row(
            str(row.run),
            row.workflow,
            row.injection.removeprefix("large_").replace("_", " ") + (f" #{row.landmark}" if row.landmark else ""),
            *_refusals(row),
            "" if row.residual_mm is None else spread(row.residual_mm, 2),
            "" if row.published_residual_mm is None else f"{row.published_residual_mm:.2f}",
        )
    return table


def _refusals(row: RowRates) -> tuple[str, str, str, str]:
    if row.by_construction:
        return "all by construction", "", "", ""
    named = "" if row.named is None else _percent(row.named / row.runs)
    outlier, residual = row.refused_by["landmark_outlier"], row.refused_by[FIXED_LIMIT]
    return _percent(row.refused / row.runs), _percent(outlier / row.runs), _percent(residual / row.runs), named


def _rates(report: MonteCarloReport) -> Table:
    caption = (
        f"Controls wrongly refused; {OFFSET.replace('_', ' ')}s that this gate alone would accept. Rows with a missing "
        "landmark are refused by the workflow itself, whatever the noise, and are not counted."
    )
    table = Table(title="Wrong decisions", box=SIMPLE_HEAD, caption=caption)
    for name in ("workflow", "gate", "false rejects", "false accepts"):
        table.add_column(name, justify="right" if name.startswith("false") else "left", no_wrap=True)
    for rates in report.rates:
        table.add_row(rates.workflow, rates.gate, _percent(rates.false_rejects), _percent(rates.false_accepts))
    return table


def _noise(report: MonteCarloReport) -> list[str]:
    return [
        f"{workflow}: planning bias {noise.planning_bias_mm:g} mm and touch noise {noise.noise_mm:g} mm per axis "
        f"(expected: {noise.sigma_mm:.2f} mm in all); limits: residual {noise.residual_limit_mm:g} mm, predicted TRE "
        f"{noise.tre_limit_mm:g} mm, {100 * noise.false_alarm:g} % false alarms."
        for workflow, noise in report.noise.items()
    ]


def _percent(share: float) -> str:
    return f"{100.0 * share:.1f} %"
