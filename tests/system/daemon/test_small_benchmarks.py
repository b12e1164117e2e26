"""Benchmarks whose figures pages name still run, each as small as it can be."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests import ROOT

BENCHMARKS = ROOT / "benchmarks"
SMALL = {
    "devices.py": ["servo", "openigtlink", "--seconds", "0.2"],
    "fsm.py": ["--rounds", "1", "--events", "5"],
    "kinematics.py": ["--arms", "iiwa14", "--targets", "3", "--shared", "1"],
    "registration.py": ["--sets", "2", "--rounds", "1"],
    "signature.py": ["--count", "5"],
}
WITH_DAEMONS = {
    "deadman.py": ["idle", "--runs", "1"],
    "recording.py": ["--seconds", "0.5"],
    "recovery.py": ["--rows", "20", "--starts", "1"],
    "teleop.py": ["latency", "--samples", "2"],
    "visualization.py": ["--rates", "60", "--seconds", "1"],
}
NOT_RUN = {
    "bench.py": "CI runs its check of the budgets, and it runs the others",
    "console.py": "it needs a browser, in which `pytest -m browser` runs the same page",
    "loaded.py": "it runs the demo, which tests run, too",
    "reliability.py": "it runs the campaign, which `make nightly` runs",
    "scale.py": "tests/unit/lab/scale runs the same on two workers",
    "verify.py": "it verifies a million joint states",
}
"""Benchmarks that no test runs, and why."""


def measured(name: str, *words: str) -> str:
    command = [sys.executable, str(BENCHMARKS / name), *words]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout


@pytest.mark.timeout(120)
@pytest.mark.parametrize("name", SMALL)
def test_a_benchmark_measures_something(name: str) -> None:
    assert json.loads(measured(name, *SMALL[name], "--json"))


@pytest.mark.timeout(120)
def test_the_distances_to_zones_are_measured() -> None:
    assert "a whole approach" in measured("zones.py", "3")


@pytest.mark.timeout(120)
def test_the_round_trip_of_a_correction_is_measured() -> None:
    assert "round trip" in measured("planning.py", "3")


@pytest.mark.timeout(120)
def test_intrusions_are_searched_for() -> None:
    assert "intrusions found: 2 of 2" in measured("scene.py", "2", "20")


@pytest.mark.nightly
@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", WITH_DAEMONS)
def test_a_benchmark_with_daemons_measures_something(name: str) -> None:
    assert json.loads(measured(name, *WITH_DAEMONS[name], "--json"))


def test_every_benchmark_is_run_by_a_test_or_has_a_reason() -> None:
    programs = {path.name for path in BENCHMARKS.glob("*.py") if "__main__" in path.read_text()}
    text = "".join(path.read_text() for path in Path(__file__).parent.glob("test_*.py"))
    assert {name for name in programs if f'"{name}"' not in text} == set()
    assert set(NOT_RUN) <= programs
