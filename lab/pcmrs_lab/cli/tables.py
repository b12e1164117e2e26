"""Tables of the placement and failure experiments."""

from __future__ import annotations

import math

from rich.box import SIMPLE_HEAD
from rich.console import Group
from rich.table import Table

from pcmrs.analysis.placements import Summary
from pcmrs_lab.experiment.failures import FailureReport
from pcmrs_lab.experiment.placements import PlacementReport, PlacementSummary
from pcmrs_lab.experiment.published import Reported
from pcmrs_lab.experiment.treatment import Treated


def placement_table(report: PlacementReport) -> Group:
    """Return positions and errors of each trial, mean ± sd with the paper's, and the treatment."""
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
    for missed in report.failed:
        trials.add_row(str(missed.trial), missed.reason)
    caption = f"Registration residual {report.residual_mm:.2f} mm. The paper's robot was real; this is simulated."
    return Group(trials, summary_table(report.summary, caption), *(_treated(step) for step in report.treatment))


def _treated(step: Treated) -> str:
    text = f"{step.operation} → {step.state}"
    if "surgeon" in step.result:
        return f"{text}, confirmed by {step.result['surgeon']}"
    shift_mm, turn_deg = step.result["translation_error"] * 1000, math.degrees(step.result["rotation_error"])
    return f"{text}: {shift_mm:.4f} mm, {turn_deg:.4f}° from where the drill began"


def summary_table(summary: PlacementSummary, caption: str) -> Table:
    """Return mean ± sd and maximum of all errors, with the paper's.

    Args:
        summary: Statistics of the trials.
        caption: Text below the table.
    """
    table = Table(title=f"mean ± sd, and max, of {summary.trials} placements", box=SIMPLE_HEAD, caption=caption)
    for name in ("", "mm", "max mm", "°", "max °"):
        table.add_column(name, justify="right" if name else "left", no_wrap=True)
    table.add_row(
        "measured by the tracker against the plan",
        *_with_maximum(summary.translation_error_mm),
        *_with_maximum(summary.rotation_error_deg),
    )
    table.add_row(
        "paper, the same on a KUKA iiwa",
        spread(summary.published_translation_error_mm),
        "",
        spread(summary.published_rotation_error_deg),
    )
    table.add_row(
        "true: actual pose against the plan as registered",
        *_with_maximum(summary.true_translation_error_mm),
        *_with_maximum(summary.true_rotation_error_deg),
    )
    name = "TRE: registration against truth at the target"
    table.add_row(name, *_with_maximum(summary.target_registration_error_mm, 2))
    if summary.predicted_error_mm is not None:
        table.add_row("predicted for the same, rms", *_with_maximum(summary.predicted_error_mm, 2))
    tried = summary.trials + summary.failed
    table.add_row(
        "placements that reached their targets", f"{summary.trials} of {tried}", f"{summary.success_rate:.0%}"
    )
    return table


def _with_maximum(summary: Summary, digits: int = 4) -> tuple[str, str]:
    return spread(summary, digits), f"{summary.max:.{digits}f}"


def failure_table(report: FailureReport) -> Table:
    """Return the state at which each run was rejected and its residual, with the paper's."""
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


def spread(summary: Summary | Reported, digits: int = 4) -> str:
    """Return mean ± sd, or the mean alone if there is no sd.

    Args:
        summary: Mean and standard deviation.
        digits: Number of decimals.
    """
    return f"{summary.mean:.{digits}f}" + ("" if summary.sd is None else f" ± {summary.sd:.{digits}f}")


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"
