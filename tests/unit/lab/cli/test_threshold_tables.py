"""The table of the threshold experiment: pulses, errors, and how many stated intervals hold."""

from __future__ import annotations

import math

import msgspec

from pcmrs_lab.cli.threshold_tables import threshold_table
from pcmrs_lab.experiment.thresholds import Middle
from tests.unit.lab.cli.shown import line_of, shown
from tests.unit.lab.experiment.example_reports import THRESHOLDS


def test_a_method_without_intervals_states_no_share_of_them() -> None:
    table = threshold_table(THRESHOLDS)
    numbers = ["12", "14", "2.25", "%", "2.50", "%", "1.00", "1.00", "-0.25"]
    assert line_of(table, "amplitudes") == ["maximum", "likelihood,", "amplitudes", *numbers, "50.0", "%", "1"]
    assert line_of(table, "5 of 10") == ["relative", "frequency,", "5", "of", "10", *numbers, "1"]
    assert "narrower than 8 % of the threshold" in " ".join(shown(table).split())


def test_a_method_that_found_nothing_has_no_numbers() -> None:
    nothing = Middle(math.nan, math.nan)
    first = msgspec.structs.replace(
        THRESHOLDS.methods[0],
        refused=3,
        pulses=nothing,
        error_percent=nothing,
        error_mso=nothing,
        bias_mso=math.nan,
        held=None,
    )
    table = threshold_table(msgspec.structs.replace(THRESHOLDS, methods=[first]))
    assert line_of(table, "amplitudes")[-1] == "3"
    assert line_of(table, "amplitudes").count("nan") == 6
