"""Tables of the placement experiment over several seeds, of following, and of the failure injections."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.console import Group
from rich.table import Table

from pcmrs_lab.cli.tables import spread, summary_table
from pcmrs_lab.experiment.following import ErrorSummary, FollowingReport, Occluded
from pcmrs_lab.experiment.monte_carlo import FIXED_LIMIT, OFFSET, MonteCarloReport, RowRates
from pcmrs_lab.experiment.placement_seeds import SeedsReport


def following_tables(report: FollowingReport) -> Group:
    """Return the errors of each scenario with and without compensation, and the end after an occlusion."""
    title = f"Following a head, {report.workflow}, seed {report.seed}, {report.duration:g} s each: simulated cell"
    runs = Table(title=title, box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for name in ("head", "latency"):
        runs.add_column(name, no_wrap=True)
    for name in (
        "true rms mm",
        "p99",
        "max",
        "measured rms mm",
        "p99 ",
        "allowed %",
        "max true while allowed mm",
        "lag s",
    ):
        runs.add_column(name, justify="right")
    for run in sorted(report.runs, key=lambda each: [other.scenario for other in report.runs].index(each.scenario)):
        runs.add_row(
            run.scenario + (" (lost)" if run.lost else ""),
            "compensated" if run.compensated else "as it is",
            *_numbers(run.true_mm),
            f"{run.true_mm.max:.2f}",
            *_numbers(run.measured_mm),
            f"{100.0 * run.allowed:.1f}",
            f"{run.true_allowed_mm:.2f}",
            f"{run.lag:.2f}",
        )
    motions = [f"{run.scenario}: {run.motion}" for run in report.runs if run.compensated]
    return Group(runs, "; ".join(motions) + ".", _occluded(report.occlusion))


def _numbers(spread: ErrorSummary) -> tuple[str, str]:
    return f"{spread.rms:.3f}", f"{spread.p99:.2f}"


def _occluded(found: Occluded) -> str:
    latched = "latched" if found.latched else "NOT latched"
    return (
        f"Reference hidden for {found.seconds:g} s while the head breathed: the tool is {found.state}, Stop is "
        f"{latched}, alignment {found.alignment}; it went {found.moved_mm:.2f} mm."
    )


def monte_carlo_tables(report: MonteCarloReport) -> Group:
    """Return the results of every row, and the rates of wrong decisions of each gate."""
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
        "landmark are refused by the workflow itself at any noise, and are not counted."
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


def seeds_tables(report: SeedsReport) -> Group:
    """Return the errors of each seed and of all together."""
    title = f"Placements over {len(report.runs)} seeds, {report.workflow}: simulated cell, mean ± sd"
    seeds = Table(title=title, box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for name in ("seed", "residual mm", "mm", "max", "°", "true mm", "max ", "true °", "TRE mm"):
        seeds.add_column(name, justify="right", no_wrap=True)
    for run in report.reports:
        summary = run.summary
        seeds.add_row(
            str(run.seed),
            f"{run.residual_mm:.2f}",
            spread(summary.translation_error_mm, 3),
            f"{summary.translation_error_mm.max:.3f}",
            spread(summary.rotation_error_deg, 3),
            spread(summary.true_translation_error_mm, 3),
            f"{summary.true_translation_error_mm.max:.3f}",
            spread(summary.true_rotation_error_deg, 3),
            spread(summary.target_registration_error_mm, 2),
        )
    refused = [f"Seed {run.seed} was refused: {run.refused}" for run in report.runs if run.refused is not None]
    if report.pooled is None:
        return Group(*refused)
    pooled = summary_table(report.pooled, "All seeds together. The paper's robot was real; this is simulated.")
    return Group(seeds, pooled, *refused)
