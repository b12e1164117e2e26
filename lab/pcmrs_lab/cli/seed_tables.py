"""The placement experiment over several seeds as tables."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.console import Group
from rich.markup import escape
from rich.table import Table

from pcmrs_lab.cli.tables import spread, summary_table
from pcmrs_lab.experiment.placement_seeds import SeedsReport


def seeds_tables(report: SeedsReport) -> Group:
    """The errors of each seed and of all together."""
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
    refused = [f"Seed {run.seed} was refused: {escape(run.refused)}" for run in report.runs if run.refused is not None]
    if report.pooled is None:
        return Group(*refused)
    pooled = summary_table(report.pooled, "All seeds together. The paper's robot was real; this is simulated.")
    return Group(seeds, pooled, *refused)
