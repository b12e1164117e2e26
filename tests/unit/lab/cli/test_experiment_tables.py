"""Tables of following, of the Monte Carlo and of several seeds: what was lost, blocked or refused is named."""

from __future__ import annotations

import pytest

from pcmrs_lab.cli.experiment_tables import following_tables, monte_carlo_tables, seeds_tables
from pcmrs_lab.experiment.placement_seeds import SeedRun, SeedsReport
from pcmrs_lab.experiment.placements import PlacementReport, summary_of
from tests.unit.lab.cli.shown import line_of, shown
from tests.unit.lab.experiment.example_reports import FOLLOWED, MONTE_CARLO, following_report, placement_report


def test_both_runs_of_a_motion_stand_below_each_other() -> None:
    lines = [line.split() for line in shown(following_tables(following_report())).splitlines()]
    runs = [line for line in lines if line[:1] in (["still"], ["steps"])]
    assert [" ".join(line[:3]) for line in runs] == [
        "still as it",
        "still compensated 0.123",
        "steps as it",
        "steps (lost) compensated",
    ]
    assert runs[1] == ["still", "compensated", "0.123", "2.50", "3.00", "0.123", "2.50", "75.0", "2.00", "0.10"]


@pytest.mark.parametrize("latched", [True, False])
def test_the_table_says_what_became_of_a_hidden_head(latched: bool) -> None:
    text = " ".join(shown(following_tables(following_report(latched=latched))).split())
    assert ("NOT latched" in text) != latched
    assert "Reference hidden for 3 s while the head breathed: the tool is held" in text
    assert text.count("0.123") == 2 * len(FOLLOWED)
    assert text.count("still: a head, still") == 1, "each motion is explained once"


def test_rows_refused_by_construction_have_no_rates() -> None:
    table = monte_carlo_tables(MONTE_CARLO)
    assert line_of(table, "missing landmark #1") == [
        "9",
        "ratms",
        "missing",
        "landmark",
        "#1",
        "all",
        "by",
        "construction",
    ]
    shares = ["98.0", "%", "98.0", "%", "0.0", "%", "98.0", "%"]
    assert line_of(table, "digitization error #2") == [
        "15",
        "ratms",
        "digitization",
        "error",
        "#2",
        *shares,
        "7.50",
        "2.50",
    ]
    assert line_of(table, "none") == [
        "1",
        "ratms",
        "none",
        "2.0",
        "%",
        "2.0",
        "%",
        "0.0",
        "%",
        "2.20",
        "±",
        "0.40",
        "2.50",
    ]


def test_wrong_decisions_and_the_noise_behind_them_are_stated() -> None:
    table = monte_carlo_tables(MONTE_CARLO)
    assert line_of(table, "verdict") == ["ratms", "verdict", "2.0", "%", "0.0", "%"]
    assert line_of(table, "fixed_limit") == ["ratms", "fixed_limit", "0.0", "%", "100.0", "%"]
    text = " ".join(shown(table).split())
    assert "planning bias 1.2 mm and touch noise 0.5 mm per axis (expected: 1.31 mm in all)" in text
    assert "residual 4 mm, predicted TRE 5 mm, 1 % false alarms" in text


def seeds(*runs: SeedRun) -> SeedsReport:
    trials = [trial for run in runs if run.report is not None for trial in run.report.trials]
    pooled = summary_of("ratms", trials) if trials else None
    return SeedsReport("placements", "ratms", 1.0, [], True, list(runs), pooled)


def completed(seed: int) -> SeedRun:
    report: PlacementReport = placement_report(seed)
    return SeedRun(seed, report, None)


def test_refused_seeds_are_named_below_the_completed_ones() -> None:
    refused = SeedRun(6, None, "registration.register was rejected: [red]too large[/red].")
    text = shown(seeds_tables(seeds(completed(5), refused)))
    assert "Seed 6 was refused: registration.register was rejected: [red]too large[/red]." in text
    assert "Placements over 2 seeds" in text
    assert line_of(seeds_tables(seeds(completed(5))), "5.150", "2.00")[:5] == ["5", "2.00", "5.150", "±", "0.071"]


def test_where_every_seed_was_refused_only_reasons_are_shown() -> None:
    text = shown(seeds_tables(seeds(SeedRun(6, None, "It was refused."))))
    assert text.split() == ["Seed", "6", "was", "refused:", "It", "was", "refused."]
