"""Every guard that is listed is still there, once; without it the product still runs, and some test misses it."""

from __future__ import annotations

import ast
import importlib
import types
from collections import Counter

import pytest
from removed_guards import TREE, Mutant, declared
from run_removed_guards import WANTED, Found, run_mutants

MUTANTS = declared()
FILES = sorted({mutant.file for mutant in MUTANTS})
GUARDLESS = {
    "dispatcher/events.py", "dispatcher/planner.py", "dispatcher/recorder.py", "dispatcher/run.py",
    "dispatcher/stage.py", "dispatcher/tasks.py", "gateway/core.py", "gateway/markers.py", "gateway/permissions.py",
    "journal/export.py", "journal/notes.py",
}  # fmt: skip
"""Files of the three packages in which there is nothing to take out."""
SHOWN = ("numbers_beyond_all_bounds", "a_rotation_of_any_age")
"""Mutants that are tried in every run of the suite, since their tests are quick: the way of trying them works."""
PACKAGES = ("dispatcher", "gateway", "journal")


def test_names_are_unique_and_the_tests_are_there() -> None:
    assert [name for name, often in Counter(mutant.name for mutant in MUTANTS).items() if often > 1] == []
    files = {test.partition("::")[0] for mutant in MUTANTS for test in mutant.tests}
    assert [file for file in sorted(files) if not (TREE / "tests" / file).exists()] == []
    assert [mutant.name for mutant in MUTANTS if not (mutant.harm and mutant.tests)] == []


def test_no_file_of_the_three_packages_is_forgotten() -> None:
    folder = TREE / "pcmrs"
    found = {str(path.relative_to(folder)) for name in PACKAGES for path in (folder / name).glob("*.py")}
    assert {file for file in found if not file.endswith("__init__.py")} - set(FILES) == GUARDLESS


@pytest.mark.parametrize("file", FILES)
def test_a_listed_guard_is_there_once_and_can_be_taken_out(file: str) -> None:
    """What remains can be imported, and is another program: tests can miss the guard, and nothing else."""
    name = "pcmrs." + file.removesuffix(".py").replace("/", ".")
    importlib.import_module(name)
    whole = ast.dump(ast.parse((TREE / "pcmrs" / file).read_text()))
    for mutant in MUTANTS:
        if mutant.file == file:
            altered = ast.parse(mutant.altered(TREE))
            assert ast.dump(altered) != whole, mutant.name
            exec(compile(altered, file, "exec"), types.ModuleType(name).__dict__)


def harmless(name: str, without: str) -> Mutant:
    """A change of a number that is no guard."""
    return Mutant(
        name=name,
        file="gateway/series.py",
        guard="PAIR_WINDOW = 1.0",
        without=without,
        harm="None.",
        tests=("gateway/test_gateway_series.py",),
    )


@pytest.mark.nightly
def test_a_removed_guard_is_caught_and_what_takes_none_out_is_not() -> None:
    mutants = [
        *(mutant for mutant in MUTANTS if mutant.name in SHOWN),
        harmless("another way to say it", "PAIR_WINDOW = 2.0 - 1.0"),
        harmless("no program", "PAIR_WINDOW = no_such_name"),
    ]
    shown: list[Found] = []
    report = run_mutants(mutants, 1, shown.append)
    assert [each.outcome for each in report.mutants] == ["caught", "caught", "survived", "broken"]
    assert (report.caught, report.unfit, report.good) == (2, [], False)
    assert shown == report.mutants


@pytest.mark.nightly
@pytest.mark.timeout(7200)
def test_the_suite_misses_nearly_every_guard() -> None:
    report = run_mutants(MUTANTS, 2, lambda _: None)
    assert report.unfit == []
    assert report.share >= WANTED, [each.name for each in report.mutants if each.outcome != "caught"]
