"""`pcmrs faults cut`: damaged journals and power cuts, and the damage that was silent."""

from __future__ import annotations

import json
from typing import Any

import pytest
from click.testing import CliRunner, Result

from pcmrs.cli import main
from pcmrs_lab.campaign import cuts
from pcmrs_lab.campaign.cuts import CutReport

SILENT: dict[int, list[str]] = {66: [f"killed: journal.sqlite cut at byte {number}: [/x] rows" for number in range(12)]}
"""Silent damage by seed."""


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    requests: list[tuple[Any, ...]] = []

    def report(what: str, seed: int, **changed: Any) -> CutReport:
        given: dict[str, Any] = {"tried": 20, "acknowledged": 60, "reported": 15, "unaffected": 5, "lost": 0}
        given |= {"silent": [], "broken": [], "changed": 18, "whole": 2, "seed": seed, "seconds": 3.6} | changed
        return CutReport(what, **given)

    def damage(count: Any, flips: Any, seed: int, _clock: Any, *, minutes: float | None, progress: Any) -> CutReport:
        requests.append(("damage", count, flips, seed, minutes))
        return report("cut or bent", seed, silent=SILENT.get(seed, []))

    def power(times: int, seed: int, _clock: Any, *, minutes: float | None, progress: Any) -> CutReport:
        requests.append(("power", times, seed, minutes))
        return report("power cut", seed, lost=int(seed == 67))

    monkeypatch.setattr(cuts, "cut_and_flip", damage)
    monkeypatch.setattr(cuts, "cut_power", power)
    return requests


def cut(*words: str) -> Result:
    return CliRunner().invoke(main, ["faults", "cut", *words])


def test_every_byte_is_damaged_unless_a_number_is_given(asked: list[Any]) -> None:
    assert cut("--power", "0").exit_code == 0
    assert cut("--cuts", "0", "--flips", "7", "--minutes", "2", "--seed", "5").exit_code == 0
    assert asked == [("damage", None, None, 1, None), ("damage", 0, 7, 5, 2.0), ("power", 200, 5, 2.0)]


@pytest.mark.parametrize(("seed", "violated"), [("1", [False, False]), ("66", [True, False]), ("67", [False, True])])
def test_a_silent_loss_or_a_lost_row_is_a_violation(asked: list[Any], seed: str, violated: list[bool]) -> None:
    ended = cut("--seed", seed, "--json")
    assert ended.exit_code == int(any(violated))
    assert [found["violated"] for found in json.loads(ended.stdout)["reports"]] == violated


def test_silent_damage_is_listed_as_it_was_found(asked: list[Any]) -> None:
    """Brackets in its text are no style of the table."""
    ended = cut("--seed", "66")
    assert ended.exit_code == 1, ended.exception
    assert "cut at byte 9: [/x] rows" in " ".join(ended.stdout.split())
    assert "byte 10" not in ended.stdout, "the first ten are enough"
