"""The experiments' results as tables."""

from __future__ import annotations

import math

from rich.box import SIMPLE_HEAD
from rich.console import Group
from rich.table import Table

from pcmrs.experiment.failures import FailureReport
from pcmrs.experiment.placements import PlacementReport, Spread
from pcmrs.experiment.published import Reported
from pcmrs.experiment.treatment import Treated


def placement_table(report: PlacementReport) -> Group:
    """Planned and measured positions and all errors of each trial, mean ± sd beside the paper's, and what followed."""
    trials = Table(
        title=f"Placements of the {report.tool}, {report.workflow}, seed {report.seed}: simulated cell",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    for name in ("trial", "planned x y z mm", "measured x y z mm", "mm", "°", "true mm", "true °", "TRE mm"):
        trials.add_column(name, justify="right", no_wrap=True)
    for trial in report.trials:
        trials.add_row(
            str(trial.trial),
            _millimetres(trial.planned.position),
            _millimetres(trial.measured.position),
            f"{trial.translation_error_mm:.4f}",
            f"{trial.rotation_error_deg:.4f}",
            f"{trial.true_translation_error_mm:.4f}",
            f"{trial.true_rotation_error_deg:.4f}",
            f"{trial.target_registration_error_mm:.2f}",
        )
    return Group(trials, _placement_summary(report), *(_treated(step) for step in report.treatment))


def _treated(step: Treated) -> str:
    said = f"{step.operation} → {step.state}"
    if "surgeon" in step.result:
        return f"{said}, confirmed by {step.result['surgeon']}"
    shift_mm, turn_deg = step.result["translation_error"] * 1000, math.degrees(step.result["rotation_error"])
    return f"{said}: {shift_mm:.4f} mm, {turn_deg:.4f}° from where the drill began"


def _placement_summary(report: PlacementReport) -> Table:
    summary = report.summary
    table = Table(
        title="mean ± sd",
        box=SIMPLE_HEAD,
        caption=f"Registration residual {report.residual_mm:.2f} mm. The paper's robot was real; this is simulated.",
    )
    for name in ("", "mm", "°"):
        table.add_column(name, justify="left" if not name else "right", no_wrap=True)
    table.add_row(
        "measured by the tracker against the plan",
        _spread(summary.translation_error_mm),
        _spread(summary.rotation_error_deg),
    )
    table.add_row(
        "paper, the same on a KUKA iiwa",
        _spread(summary.published_translation_error_mm),
        _spread(summary.published_rotation_error_deg),
    )
    table.add_row(
        "true: actual pose against the plan as registered",
        _spread(summary.true_translation_error_mm),
        _spread(summary.true_rotation_error_deg),
    )
    table.add_row("TRE: registration against truth at the target", _spread(summary.target_registration_error_mm, 2), "")
    return table


def failure_table(report: FailureReport) -> Table:
    """Where each run was rejected and its residual, beside the paper's."""
    limits = " and ".join(f"{limit:g} mm for {workflow}" for workflow, limit in report.residual_limits_mm.items())
    table = Table(
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        title=f"Failure injections, seed {report.seed}: simulated",
        caption=(
            f"Residual limit {limits}. {report.summary.as_published} of {report.summary.runs} runs ended as published."
        ),
    )
    for name in ("run", "workflow", "injection", "rejected", "paper", "mm", "paper ", "reason", "motion"):
        table.add_column(name, justify="right" if name in ("mm", "paper ") else "left", no_wrap=True)
    for run in report.runs:
        landmark = f" #{run.landmark}" if run.landmark else ""
        table.add_row(
            str(run.run),
            run.workflow,
            run.injection.removeprefix("large_").replace("_", " ") + landmark,
            run.rejected_at or run.outcome,
            run.published_rejected_at or "completed",
            _number(run.residual_mm),
            _number(run.published_residual_mm),
            run.reason or "",
            "" if run.motion_refused is None else ("refused" if run.motion_refused else "ALLOWED"),
        )
    return table


def _millimetres(position: tuple[float, float, float]) -> str:
    return " ".join(f"{value * 1000:6.1f}" for value in position)


def _spread(spread: Spread | Reported, digits: int = 4) -> str:
    return f"{spread.mean:.{digits}f}" + ("" if spread.sd is None else f" ± {spread.sd:.{digits}f}")


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"
