"""The following experiment as tables."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.console import Group
from rich.table import Table

from pcmrs_lab.experiment.following import FollowingReport, Occluded, Spread


def following_tables(report: FollowingReport) -> Group:
    """Errors of each scenario with and without compensation of the latency, and what became of a hidden head."""
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


def _numbers(spread: Spread) -> tuple[str, str]:
    return f"{spread.rms:.3f}", f"{spread.p99:.2f}"


def _occluded(found: Occluded) -> str:
    latched = "latched" if found.latched else "NOT latched"
    return (
        f"Reference hidden for {found.seconds:g} s while the head breathed: the tool is {found.state}, Stop is "
        f"{latched}, alignment {found.alignment}; it went {found.moved_mm:.2f} mm."
    )
