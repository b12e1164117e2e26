"""Motor thresholds of simulated subjects: number of pulses that each method needs, and its error.

The subjects are those of a published population (`pcmrs_sim.tms.recruitment`), whose model is not the estimator's. The
true threshold is the intensity at which half of the pulses give a response, which their model gives exactly. Every
method gets the same subjects. There is no daemon, and amplitudes have no noise of the electromyogram, which is measured
elsewhere.
"""

from __future__ import annotations

import msgspec
import numpy as np

from pcmrs.tms.settings import ThresholdMethod, ThresholdSettings
from pcmrs.tms.threshold import MotorThresholdEstimator
from pcmrs_lab.scale.tasks import HERE, ShowProgress, Workers, run_tasks
from pcmrs_sim.tms.recruitment import RESPONSE, Recruitment, draw

METHODS = {
    "ml": "maximum likelihood, amplitudes",
    "ml_yes_no": "maximum likelihood, yes or no",
    "relative_frequency": "relative frequency, 5 of 10",
}

SUBJECTS_AT_ONCE = 10
"""Number of subjects in one request."""


class ThresholdTask(msgspec.Struct, frozen=True):
    """Subject whose threshold every method estimates.

    Attributes:
        seed: Seed of the experiment.
        subject: Number of the subject, from 0.
        interval: Width of the interval at which maximum likelihood ends, share of the threshold.
    """

    seed: int
    subject: int
    interval: float


class ThresholdResult(msgspec.Struct, frozen=True):
    """Result of one method for one subject, percent of the maximum stimulator output.

    Attributes:
        estimate: Estimated threshold; None if the estimation was refused.
        held: True if the stated interval contains the true threshold; None if none is stated.
    """

    threshold: float
    pulses: int
    estimate: float | None
    held: bool | None

    @property
    def error(self) -> float:
        """Signed error; nan if the estimation was refused."""
        return float("nan") if self.estimate is None else self.estimate - self.threshold


class Middle(msgspec.Struct, frozen=True):
    """Median and 95th percentile of a series."""

    median: float
    p95: float


class MethodResult(msgspec.Struct, frozen=True):
    """Results of one method over all subjects.

    Attributes:
        refused: Number of estimations without a threshold; they are not among the errors.
        error_percent: Magnitude of the error, percent of the true threshold.
        error_mso: Magnitude of the error, percent of the maximum stimulator output.
        bias_mso: Mean signed error, percent of the maximum stimulator output.
        held: Share of the intervals that contain the true threshold; None if the method states none.
    """

    method: str
    refused: int
    pulses: Middle
    error_percent: Middle
    error_mso: Middle
    bias_mso: float
    held: float | None


class ThresholdReport(msgspec.Struct, frozen=True):
    """Results of all methods on the same subjects.

    Attributes:
        threshold: True thresholds, percent of the maximum stimulator output.
        interval: Width of the interval at which maximum likelihood ends, share of the threshold.
    """

    experiment: str
    seed: int
    subjects: int
    simulated: bool
    threshold: Middle
    interval: float
    methods: list[MethodResult]


def run_thresholds(
    subjects: int, seed: int, interval: float, progress: ShowProgress, workers: Workers = HERE
) -> tuple[ThresholdReport, dict[str, list[ThresholdResult]]]:
    """Estimate every subject's threshold with every method; equal seeds give equal results.

    Args:
        subjects: Number of subjects, at least one.
        seed: Seed of subjects and of their variability.
        interval: Width of the interval at which maximum likelihood ends, share of the threshold.
        progress: Called with the number of finished subjects.
        workers: Where the thresholds are estimated.

    Returns:
        Report, and the results of all subjects by method.

    Raises:
        ConfigurationError: The workers cannot be used.
    """
    tasks = [ThresholdTask(seed, number, interval) for number in range(subjects)]
    found: dict[int, dict[str, ThresholdResult]] = {}
    for task, result in run_tasks(estimate_thresholds, tasks, workers, SUBJECTS_AT_ONCE):
        found[task.subject] = result
        progress("motor thresholds", len(found), subjects)
    hunted = {method: [found[number][method] for number in range(subjects)] for method in METHODS}
    report = ThresholdReport(
        experiment="thresholds",
        seed=seed,
        subjects=subjects,
        simulated=True,
        threshold=_middle([each.threshold for each in hunted["ml"]]),
        interval=interval,
        methods=[_result(method, found) for method, found in hunted.items()],
    )
    return report, hunted


def estimate_thresholds(tasks: list[ThresholdTask]) -> list[dict[str, ThresholdResult]]:
    """Estimate the threshold of each subject, and return the results by method.

    Args:
        tasks: Subjects.
    """
    return [_estimate_all(task) for task in tasks]


def _estimate_all(task: ThresholdTask) -> dict[str, ThresholdResult]:
    subject = draw(np.random.default_rng((task.seed, task.subject)))
    return {
        method: _estimate(subject, method, task.interval, np.random.default_rng((task.seed, task.subject, index)))
        for index, method in enumerate(METHODS)
    }


def _estimate(subject: Recruitment, method: str, interval: float, rng: np.random.Generator) -> ThresholdResult:
    by: ThresholdMethod = "relative_frequency" if method == "relative_frequency" else "ml"
    hunt = MotorThresholdEstimator.begin(ThresholdSettings(method=by, interval=interval))
    while not hunt.finished and hunt.refusal is None:
        intensity = hunt.next_intensity()
        amplitude = subject.sample(intensity, rng)
        hunt = hunt.after(intensity, amplitude >= RESPONSE, amplitude if method == "ml" else None)
    if not hunt.finished:
        return ThresholdResult(subject.threshold, len(hunt.pulses), None, None)
    found = hunt.estimate
    held = None if found.low is None or found.high is None else found.low <= subject.threshold <= found.high
    return ThresholdResult(subject.threshold, len(hunt.pulses), found.threshold, held)


def _result(method: str, found: list[ThresholdResult]) -> MethodResult:
    ended = [each for each in found if each.estimate is not None]
    held = [each.held for each in ended if each.held is not None]
    return MethodResult(
        method=method,
        refused=len(found) - len(ended),
        pulses=_middle([each.pulses for each in ended]),
        error_percent=_middle([100.0 * abs(each.error) / each.threshold for each in ended]),
        error_mso=_middle([abs(each.error) for each in ended]),
        bias_mso=float(np.mean([each.error for each in ended])) if ended else float("nan"),
        held=float(np.mean(held)) if held else None,
    )


def _middle(values: list[float]) -> Middle:
    """Return median and p95; nan for no values."""
    if not values:
        return Middle(float("nan"), float("nan"))
    median, p95 = np.percentile(values, (50.0, 95.0))
    return Middle(float(median), float(p95))
