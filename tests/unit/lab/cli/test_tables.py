"""Tables of placements and failure injections: the paper's values beside the measured ones, in units of people."""

from __future__ import annotations

import msgspec
import pytest

from pcmrs.analysis.placements import Summary
from pcmrs_lab.cli.tables import failure_table, placement_table, spread
from pcmrs_lab.experiment.published import Reported
from pcmrs_lab.experiment.treatment import Treated
from tests.unit.lab.cli.shown import line_of, shown
from tests.unit.lab.experiment.example_reports import failure, failure_report, placement_report


def test_each_trial_has_its_poses_and_errors_in_mm_and_degrees() -> None:
    table = placement_table(placement_report(3))
    pose = ["1.0", "-20.0", "300.0"]
    assert line_of(table, "3.1000") == ["1", *pose, *pose, "3.1000", "0.3100", "6.2000", "0.6200", "3.00"]
    assert "Registration residual 2.00 mm." in shown(table)


def test_the_papers_means_stand_below_the_measured_ones() -> None:
    table = placement_table(placement_report(3))
    assert line_of(table, "measured by the tracker")[-8:] == [
        "3.1500",
        "±",
        "0.0707",
        "3.2000",
        "0.3150",
        "±",
        "0.0071",
        "0.3200",
    ]
    assert line_of(table, "paper,")[-2:] == ["0.5096", "0.1692"]


def test_treatment_names_who_confirmed_and_how_far_guide_is_off() -> None:
    steps = [
        Treated("treatment.start_drilling", "drilling", {"surgeon": "simulated surgeon"}),
        Treated("treatment.check_guide", "checked", {"translation_error": 1.5e-4, "rotation_error": 0.001}),
    ]
    text = shown(placement_table(msgspec.structs.replace(placement_report(3), treatment=steps)))
    assert "treatment.start_drilling → drilling, confirmed by simulated surgeon" in text
    assert "treatment.check_guide → checked: 0.1500 mm, 0.0573° from where the drill began" in text


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (Summary(1.23456, 0.5, 2.0), "1.2346 ± 0.5000"),
        (Summary(1.23456, None, 2.0), "1.2346"),
        (Reported(0.5096), "0.5096"),
    ],
)
def test_without_a_deviation_the_mean_stands_alone(given: Summary | Reported, text: str) -> None:
    assert spread(given) == text


def test_a_run_that_was_rejected_shows_where_and_why() -> None:
    table = failure_table(failure_report(failure(15, "111", paper="111", motion_refused=True)))
    assert line_of(table, "15") == [
        *(
            "15",
            "ratms",
            "digitization",
            "error",
            "#1",
            "111",
            "111",
            "7.1235",
            "7.5900",
            "landmark_outlier",
            "refused",
        ),
    ]


def test_a_motion_that_was_allowed_cannot_be_overlooked() -> None:
    runs = (
        failure(1, None, paper=None),
        failure(15, "111", paper="111", motion_refused=False),
        failure(16, None, paper="111"),
    )
    table = failure_table(failure_report(*runs))
    assert line_of(table, "15")[-1] == "ALLOWED"
    assert line_of(table, "none") == ["1", "ratms", "none", "completed", "completed", "-", "2.3000"]
    assert "2 of 3 runs ended as published" in " ".join(shown(table).split())
    assert "4 mm for ratms and 2.7 mm for femoroplasty" in " ".join(shown(table).split())
