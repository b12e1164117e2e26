"""Table of the registration experiment."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.table import Table

from pcmrs_lab.experiment.registrations import USUAL, MethodErrors, RegistrationsReport


def registration_table(report: RegistrationsReport) -> Table:
    """Return true and predicted errors by landmarks, by the refinement without and with offsets, and by plain ICP."""
    title = (
        f"Registrations of a head by landmarks and skin, {report.runs} simulated runs of each row, seed {report.seed}"
    )
    caption = (
        f"Rms errors at the target, mm, over the runs that are not refused. Each row changes one property of "
        f"{USUAL.points} points of {USUAL.region} with {USUAL.noise_mm:g} mm noise, {USUAL.hair_mm:g} mm hair and "
        f"{USUAL.outliers} % outliers; landmarks have {report.sigma_mm:g} mm per axis. Plain ICP: {report.icp}."
    )
    table = Table(title=title, caption=caption, box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for name in ("property", ""):
        table.add_column(name, no_wrap=True)
    for name in (
        *("landmarks", "refined", "predicted", "refused", "hair mm"),
        *("no offset", "predicted", "refused", "plain ICP"),
    ):
        table.add_column(name, justify="right", no_wrap=True)
    for row in report.rows:
        refined, bare = row.refined, row.without_offset
        table.add_row(
            row.property,
            row.value,
            _mm(row.landmarks.true_mm),
            *(_mm(refined.true_mm), _mm(refined.predicted_mm), _refused(refined, report.runs), _mm(row.hair_mm)),
            *(_mm(bare.true_mm), _mm(bare.predicted_mm), _refused(bare, report.runs)),
            _mm(row.icp.true_mm),
        )
    return table


def _mm(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


def _refused(errors: MethodErrors, runs: int) -> str:
    return f"{100.0 * sum(errors.refused.values()) / runs:.0f} %"
