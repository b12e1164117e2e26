"""What the paper reports, as it was put into the code."""

from __future__ import annotations

from collections import Counter

from pcmrs_lab.experiment.published import PUBLISHED

ROWS = sorted((run.run, workflow) for workflow, paper in PUBLISHED.items() for run in paper.failures)


def test_the_table_of_failure_injections_is_complete() -> None:
    assert [run for run, _ in ROWS] == list(range(1, 21))
    assert Counter(workflow for _, workflow in ROWS) == {"ratms": 10, "femoroplasty": 10}


def test_both_workflows_had_the_same_errors_injected() -> None:
    injected = {
        workflow: [(run.injection, run.landmark, run.offset_in_image, run.rejected_at) for run in paper.failures]
        for workflow, paper in PUBLISHED.items()
    }
    assert injected["ratms"] == injected["femoroplasty"]


def test_a_residual_stands_where_a_registration_was_tried() -> None:
    for paper in PUBLISHED.values():
        for run in paper.failures:
            tried = run.injection in ("none", "large_digitization_error")
            assert (run.residual_mm is not None) == tried
            assert (run.rejected_at == "111") == (run.injection == "large_digitization_error")
