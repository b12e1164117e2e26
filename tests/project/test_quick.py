"""`make check` leaves out what tests/slow.txt lists, and nothing else."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests import ROOT, TESTS
from tests.support.quick import COSTS, LIST, LONGEST, QUICK, slow_tests

SLOW = LIST.read_text().split()


def test_list_names_unit_tests_that_exist(collected: list[Any]) -> None:
    """Those of the files that this run has collected; in `make test` all."""
    files = {each.file for each in collected}
    known = {f"{each.file}::{each.name}" for each in collected}
    assert {name for name in SLOW if name.partition("::")[0] in files} <= known
    assert {name.partition("::")[0] for name in SLOW if not (TESTS / name.partition("::")[0]).exists()} == set()
    assert sorted(set(SLOW)) == SLOW


def test_test_is_slow_if_one_of_its_instances_is() -> None:
    lines = [
        f"{LONGEST / 2} unit/a/test_a.py::test_quick",
        f"{LONGEST / 2} unit/a/test_a.py::test_one_instance",
        f"{LONGEST * 2} unit/a/test_a.py::test_one_instance",
        f"{LONGEST * 9} system/a/test_a.py::test_cell",
    ]
    assert slow_tests(lines) == ["unit/a/test_a.py::test_one_instance"]


def test_quick_run_leaves_out_the_listed_tests_only() -> None:
    file, _, slow = SLOW[0].partition("::")
    every, quick = (_pytest("--collect-only", *option, f"tests/{file}") for option in ((), (QUICK,)))
    assert f"::{slow}" in every
    assert f"::{slow}" not in quick
    names = {name.partition("::")[2] for name in SLOW if name.startswith(file)}
    assert {
        line for line in every.splitlines() if "::" in line and line.split("::")[1].partition("[")[0] not in names
    } == {line for line in quick.splitlines() if "::" in line}


def test_costs_of_each_test_are_noted(tmp_path: Path) -> None:
    file = tmp_path / "costs"
    _pytest(COSTS, str(file), "tests/unit/test_bucket.py")
    lines = file.read_text().splitlines()
    assert {line.split()[1].partition("::")[0] for line in lines} == {"unit/test_bucket.py"}
    assert all(float(line.split()[0]) >= 0.0 for line in lines)


def _pytest(*words: str) -> str:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *words]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert ended.returncode in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED), ended.stdout  # all may be slow
    return ended.stdout
