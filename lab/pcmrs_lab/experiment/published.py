"""Results of the paper: Liu, Kheradmand, Armand, Toward Process Controlled Medical Robotic System (2023)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import msgspec

from pcmrs.errors import ConfigurationError

PublishedInjection = Literal["none", "missing_landmark_plan", "missing_landmark", "large_digitization_error"]


@dataclass(frozen=True, slots=True)
class FailureRun:
    """One row of the table of failure injections.

    Attributes:
        run: Number in the table.
        landmark: Number of the affected landmark, from 1.
        offset_in_image: Injected error of its digitization in the image, m.
        residual_mm: Average registration residual, mm, if one was computed.
        rejected_at: State that could not be reached; None for the controls.
    """

    run: int
    injection: PublishedInjection
    landmark: int | None = None
    offset_in_image: tuple[float, float, float] | None = None
    residual_mm: float | None = None
    rejected_at: str | None = None


class Reported(msgspec.Struct, frozen=True):
    """Mean, and the standard deviation if the paper has one."""

    mean: float
    sd: float | None = None


@dataclass(frozen=True, slots=True)
class Published:
    """Results of one workflow.

    Attributes:
        tool: Name of the tool.
        translation_error_mm: Mean of 12 placements, mm, and their standard deviation if it was reported.
        rotation_error_deg: Mean of the angles, °, and their standard deviation if it was reported.
        failures: Failure injections.
    """

    tool: str
    translation_error_mm: Reported
    rotation_error_deg: Reported
    failures: tuple[FailureRun, ...]


PUBLISHED = {
    "ratms": Published(
        "coil",
        Reported(0.5096),
        Reported(0.1692),
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
    "femoroplasty": Published(
        "guide",
        Reported(0.5979, 0.3280),
        Reported(0.1480, 0.0855),
        (
            FailureRun(4, "none", residual_mm=1.2677),
            FailureRun(5, "none", residual_mm=1.0523),
            FailureRun(6, "none", residual_mm=1.1231),
            FailureRun(8, "missing_landmark_plan", rejected_at="100"),
            FailureRun(12, "missing_landmark", 1, rejected_at="110"),
            FailureRun(13, "missing_landmark", 2, rejected_at="110"),
            FailureRun(14, "missing_landmark", 3, rejected_at="110"),
            FailureRun(18, "large_digitization_error", 1, (0.025, 0.0, 0.0), 8.6603, "111"),
            FailureRun(19, "large_digitization_error", 2, (0.0, 0.020, 0.0), 8.2317, "111"),
            FailureRun(20, "large_digitization_error", 3, (0.0, 0.0, -0.023), 6.8120, "111"),
        ),
    ),
}


def published(workflow: str) -> Published:
    """Return the published results of a workflow; raise `ConfigurationError` if there are none."""
    if workflow not in PUBLISHED:
        text = f"The paper has no experiment with workflow {workflow!r}. Use {' or '.join(PUBLISHED)}."
        raise ConfigurationError(text, workflow=workflow)
    return PUBLISHED[workflow]
