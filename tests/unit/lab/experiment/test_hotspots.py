"""`pcmrs experiment hotspots`: searches on simulated subjects, without a daemon."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from pcmrs.cli import main
from pcmrs_lab.experiment.hotspots import METHODS, NEAR, HotspotReport, SearchResult, run_hotspots


@pytest.fixture(scope="module")
def ran() -> tuple[HotspotReport, dict[str, list[SearchResult]]]:
    report, searched, _ = run_hotspots(6, 1, 120.0, lambda _text, _done, _total: None)
    return report, searched


def test_both_methods_come_near_every_kind_of_subject(ran: tuple[HotspotReport, dict[str, list[SearchResult]]]) -> None:
    """Bounds that 6 subjects keep by a wide margin; the figures of 200 are in docs/tms.md."""
    report, _ = ran
    assert [result.method for result in report.methods] == list(METHODS)
    for result in report.methods:
        assert result.near >= 0.75
        assert result.unanswered == 0
        assert result.pulses_until_near.median is not None
        assert result.pulses_until_near.median <= 30
        assert result.error_mm.median is not None
        assert result.error_mm.median < 3.5
        assert result.pulses.p95 is not None
        assert result.pulses.p95 <= 60


def test_near_means_near_and_staying_there(ran: tuple[HotspotReport, dict[str, list[SearchResult]]]) -> None:
    _, searched = ran
    for each in (each for found in searched.values() for each in found):
        assert len(each.errors) == len(each.search.pulses)
        if each.near_after is None:
            assert each.errors[-1] > NEAR
        else:
            assert max(each.errors[each.near_after - 1 :]) <= NEAR
            assert each.near_after == 1 or each.errors[each.near_after - 2] > NEAR


def test_methods_share_subjects_and_a_seed_fixes_the_result() -> None:
    first, searched, _ = run_hotspots(2, 4, 120.0, lambda *_: None)
    again, _, _ = run_hotspots(2, 4, 120.0, lambda *_: None)
    other, _, _ = run_hotspots(2, 5, 120.0, lambda *_: None)
    assert first == again != other
    for adaptive, grid in zip(searched["adaptive"], searched["grid"], strict=True):
        assert adaptive.subject.recruitment == grid.subject.recruitment
        assert (adaptive.subject.image_from_hotspot.matrix == grid.subject.image_from_hotspot.matrix).all()


def test_far_below_the_threshold_nothing_is_found_and_reported() -> None:
    report, _, _ = run_hotspots(1, 1, 50.0, lambda *_: None)
    for result in report.methods:
        assert (result.near, result.unanswered) == (0.0, 1)
        assert result.pulses_until_near.median is None
        assert result.error_mm.median is None


@pytest.mark.nightly
def test_the_command_prints_and_draws(tmp_path: Path) -> None:
    picture = tmp_path / "hotspots.png"
    words = ["experiment", "hotspots", "--subjects", "2", "--seed", "4"]
    ended = CliRunner().invoke(main, [*words, "--plot", str(picture)])
    assert ended.exit_code == 0, ended.stderr
    assert "adaptive" in ended.stdout
    assert picture.read_bytes().startswith(b"\x89PNG")
    printed: dict[str, Any] = json.loads(CliRunner().invoke(main, [*words, "--json"]).stdout)
    assert (printed["subjects"], printed["seed"], printed["simulated"]) == (2, 4, True)
    assert [result["method"] for result in printed["methods"]] == ["adaptive", "grid"]


@pytest.mark.parametrize(
    "words", [("--subjects", "0"), ("--seed", "-1"), ("--intensity", "nan"), ("--plot", "/no/x.png")]
)
def test_bad_requests_are_refused_in_one_line(words: tuple[str, ...]) -> None:
    ended = CliRunner().invoke(main, ["experiment", "hotspots", *words])
    assert ended.exit_code == 2
    assert ended.stdout == ""
    assert words[0] in ended.stderr
