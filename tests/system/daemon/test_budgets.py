"""Budgets of speed: what a check fails for, without measuring anything."""

import importlib
from types import ModuleType

import pytest

from tests import ROOT


def shipped_bench(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    return importlib.import_module("bench")


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The program, with one part and a budget of 2 for its figure."""
    module = shipped_bench(monkeypatch)
    monkeypatch.setattr(module, "CHECKED", {"part": ["part.py"]})
    monkeypatch.setattr(module, "budgets", lambda: {"command": 2.0})
    return module


def runs(bench: ModuleType, monkeypatch: pytest.MonkeyPatch, *values: float) -> int:
    """Exit code of a check whose runs measure these values, beside a peer of 10."""
    left = iter(values)
    monkeypatch.setattr(
        bench, "measured", lambda _name, _words: [bench.Figure("command", next(left), "µs", "bare echo", 10.0)]
    )
    code: int = bench.check()
    assert next(left, None) is None
    return code


def test_a_figure_over_its_budget_in_three_runs_fails(bench: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    assert runs(bench, monkeypatch, 26.0, 25.1, 40.0) == 1


def test_one_run_within_the_budget_passes(bench: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    assert runs(bench, monkeypatch, 26.0, 25.0) == 0


def test_a_rate_that_falls_costs_more(bench: ModuleType) -> None:
    slow = bench.Figure("engine", 50.0, "events/s", "best peer", 100.0, faster_is_more=True)
    assert (slow.ratio, bench.Figure("x", 1.0, "µs", "not installed", None).ratio) == (2.0, None)


def test_every_checked_part_and_budget_exists(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = shipped_bench(monkeypatch)
    assert bench.CHECKED.keys() <= bench.PARTS.keys()
    assert bench.budgets()


def test_a_peer_that_is_not_installed_is_named(bench: ModuleType) -> None:
    page = bench.as_markdown([bench.Figure("whole daemon", 900.0, "µs", "2 times the roscpp chain", None)])
    assert "| whole daemon | 900 µs | 2 times the roscpp chain | not installed |" in page
