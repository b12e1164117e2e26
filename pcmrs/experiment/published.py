"""What the paper reports: Liu, Kheradmand, Armand, Toward Process Controlled Medical Robotic System (2023)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pcmrs.errors import ConfigurationError

Injection = Literal["none", "missing_landmark_plan", "missing_landmark", "large_digitization_error"]


@dataclass(frozen=True, slots=True)
class FailureRun:
    """One row of the table of failure injections.

    Attributes:
        run: Its number in the table.
        landmark: Number of the affected landmark, from 1.
        offset_in_image: Injected error of its digitization, m.
        residual_mm: Average registration residual, where one was computed.
        rejected_at: State that could not be reached; None for the controls.
    """

    run: int
    injection: Injection
    landmark: int | None = None
    offset_in_image: tuple[float, float, float] | None = None
    residual_mm: float | None = None
    rejected_at: str | None = None


@dataclass(frozen=True, slots=True)
class Published:
    """The results of one workflow: mean placement errors of 12 trials, and the failure injections."""

    translation_error_mm: float
    rotation_error_deg: float
    failures: tuple[FailureRun, ...]


PUBLISHED = {
    "ratms": Published(
        0.5096,
        0.1692,
        (
            FailureRun(1, "none", residual_mm=2.3009),
            FailureRun(2, "none", residual_mm=2.5526),
            FailureRun(3, "none", residual_mm=2.3637),
            FailureRun(7, "missing_landmark_plan", rejected_at="100"),
            FailureRun(9, "missing_landmark", 1, rejected_at="110"),
            FailureRun(10, "missing_landmark", 2, rejected_at="110"),
            FailureRun(11, "missing_landmark", 3, rejected_at="110"),
            FailureRun(15, "large_digitization_error", 1, (0.025, 0.0, 0.0), 7.5900, "111"),
            FailureRun(16, "large_digitization_error", 2, (0.0, 0.020, 0.0), 6.2370, "111"),
            FailureRun(17, "large_digitization_error", 3, (0.0, 0.0, -0.023), 6.0678, "111"),
        ),
    ),
}


def published(workflow: str) -> Published:
    """What was published of a workflow. Raises `ConfigurationError` when nothing was."""
    if workflow not in PUBLISHED:
        text = f"There is no experiment with {workflow!r}; there is {', '.join(PUBLISHED)}."
        raise ConfigurationError(text, workflow=workflow)
    return PUBLISHED[workflow]
