"""Reports of experiments that never ran, for tests of their tables and pictures."""

from __future__ import annotations

from pcmrs.analysis.placements import Summary
from pcmrs.messages import PoseMessage
from pcmrs_lab.experiment.error_series import ErrorSeries
from pcmrs_lab.experiment.failures import FailureReport, FailureResult, FailureSummary
from pcmrs_lab.experiment.following import Drawn, ErrorSummary, FollowingReport, FollowingResult, Occluded
from pcmrs_lab.experiment.monte_carlo import FIXED_LIMIT, GATES, GateRates, MonteCarloReport, NoiseUsed, RowRates
from pcmrs_lab.experiment.placements import PlacementReport, Trial, summary_of
from pcmrs_lab.experiment.thresholds import METHODS, MethodResult, Middle, ThresholdReport, ThresholdResult

POSE = PoseMessage(position=(0.001, -0.02, 0.3), quat_wxyz=(1.0, 0.0, 0.0, 0.0))


def trial(number: int, seed: int) -> Trial:
    """Errors that tell trial and seed: the translation error is seed.trial."""
    error = seed + number / 10
    return Trial(number, error, error / 10, 2 * error, error / 5, 3.0, 0.5, POSE, POSE)


def placement_report(seed: int, trials: int = 2, workflow: str = "ratms") -> PlacementReport:
    done = [trial(number, seed) for number in range(1, trials + 1)]
    return PlacementReport(
        experiment="placements",
        workflow=workflow,
        seed=seed,
        rate=1.0,
        settings=[],
        simulated=True,
        tool="coil",
        residual_mm=2.0,
        trials=done,
        treatment=[],
        summary=summary_of(workflow, done),
    )


def followed(scenario: str, *, compensated: bool, lost: bool = False) -> Drawn:
    series = ErrorSeries(times=[0.0, 1.0, 2.0, 3.0], true_mm=[0.1, 2.0, 3.0, 0.2], allowed=[True, True, False, True])
    spread = ErrorSummary(rms=0.123, p99=2.5, max=3.0)
    result = FollowingResult(scenario, f"a head, {scenario}", compensated, spread, spread, 0.75, 2.0, 0.1, lost)
    return Drawn(result, series)


FOLLOWED = [
    followed(name, compensated=compensated, lost=compensated and name == "steps")
    for compensated in (False, True)
    for name in ("still", "steps")
]


def following_report(*, latched: bool = True) -> FollowingReport:
    occlusion = Occluded(3.0, "held", "0", latched, 0.3)
    return FollowingReport("following", "ratms", 1, 1.0, 20.0, [], True, [run.result for run in FOLLOWED], occlusion)


def _row(run: int, injection: str, landmark: int | None, refused: int, residual: Summary | None) -> RowRates:
    by_construction = injection == "missing_landmark"
    refused_by = dict.fromkeys((*GATES, FIXED_LIMIT), 0) | {"landmark_outlier": refused}
    named = refused if landmark is not None and not by_construction else None
    paper = None if by_construction else 2.5
    return RowRates(
        run, "ratms", injection, landmark, by_construction, 50, refused, {} if by_construction else refused_by,
        named, residual, paper,
    )  # fmt: skip


MONTE_CARLO = MonteCarloReport(
    experiment="failures_monte_carlo",
    seed=3,
    runs=50,
    simulated=True,
    settings=[],
    noise={"ratms": NoiseUsed(1.2, 0.5, 1.31, 4.0, 5.0, 0.01)},
    rows=[
        _row(1, "none", None, 1, Summary(2.2, 0.4, 3.0)),
        _row(9, "missing_landmark", 1, 50, None),
        _row(15, "large_digitization_error", 2, 49, Summary(7.5, None, 7.5)),
    ],
    rates=[GateRates("ratms", "verdict", 0.02, 0.0), GateRates("ratms", FIXED_LIMIT, 0.0, 1.0)],
)

HUNTED = {
    method: [
        ThresholdResult(50.0, 10, 51.0, True if method == "ml" else None),
        ThresholdResult(40.0, 14, 39.0, False if method == "ml" else None),
        ThresholdResult(60.0, 20, None, None),
    ]
    for method in METHODS
}
"""Two estimates and a refusal of each method."""

THRESHOLDS = ThresholdReport(
    experiment="thresholds",
    seed=1,
    subjects=3,
    simulated=True,
    threshold=Middle(50.0, 59.0),
    interval=0.08,
    methods=[
        MethodResult(method, 1, Middle(12.0, 14.0), Middle(2.25, 2.5), Middle(1.0, 1.0), -0.25, held)
        for method, held in zip(METHODS, (0.5, None, None), strict=True)
    ],
)


def failure(
    run: int, rejected_at: str | None, *, paper: str | None, motion_refused: bool | None = None
) -> FailureResult:
    rejected = rejected_at is not None
    return FailureResult(
        run=run,
        workflow="ratms",
        injection="large_digitization_error" if paper else "none",
        landmark=1 if paper else None,
        outcome="rejected" if rejected else "completed",
        rejected_at=rejected_at,
        residual_mm=7.123456 if rejected else None,
        reason="landmark_outlier" if rejected else None,
        motion_refused=motion_refused,
        published_rejected_at=paper,
        published_residual_mm=7.59 if paper else 2.3,
    )


def failure_report(*runs: FailureResult) -> FailureReport:
    as_published = sum(run.rejected_at == run.published_rejected_at for run in runs)
    summary = FailureSummary(len(runs), as_published, 1, as_published - 1)
    return FailureReport("failures", 2, 5.0, [], True, {"ratms": 4.0, "femoroplasty": 2.7}, list(runs), summary)
