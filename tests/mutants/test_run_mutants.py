"""A removed guard is caught by a test that the map names; another way to say it survives, and no program is broken."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import msgspec
import pytest

from tests import ROOT
from tests.mutants import run_mutants
from tests.mutants.coverage_map import CoverageMap, MapError, MappedFile, MappedTest, read_map, write_map
from tests.mutants.listed_guards import listed
from tests.mutants.places import find
from tests.mutants.run_mutants import allowed, candidates
from tests.mutants.selecting_tests import Limits, changed, own_tests, select
from tests.mutants.trying import COPIED, Candidate, Found, Run, outcome_of, run_importable, try_mutants

SHOWN = ("a_series_is_planned_twice", "a_rotation_of_any_age")
"""Mutants whose tests are quick: the way of trying them works."""
BEATS = "tests/unit/bus/test_heart.py::test_beat_carries_the_loops_sign_and_stops_if_the_loop_hangs"
FEW = Limits(tests=10, seconds=30.0)


@pytest.fixture(scope="module")
def coverage(tmp_path_factory: pytest.TempPathFactory) -> CoverageMap:
    return write_map(["tests/unit/gateway/test_handlers.py", BEATS], 0, tmp_path_factory.mktemp("map") / "map.json")


def harmless(name: str, without: str) -> Candidate:
    """A change of a number that is no guard."""
    return Candidate(
        name=name,
        where="gateway.series:",
        place=find(ROOT, "gateway.series", "", "PAIR_WINDOW = 1.0"),
        without=without,
    )


def test_a_removed_guard_is_caught_by_a_named_test(coverage: CoverageMap) -> None:
    report = try_mutants(candidates(SHOWN[:1]), coverage, FEW, 1.0, allowed={}, jobs=1, show=lambda _: None)
    assert [each.outcome for each in report.mutants] == ["caught"]
    assert report.mutants[0].by.partition("::")[0] == "tests/unit/gateway/test_handlers.py"
    assert report.good


@pytest.mark.nightly
@pytest.mark.timeout(300)
def test_removed_guard_is_caught_and_harmless_change_is_not(coverage: CoverageMap) -> None:
    mutants = [
        *candidates(SHOWN),
        harmless("another way to say it", "PAIR_WINDOW = 2.0 - 1.0"),
        harmless("no program", "PAIR_WINDOW = no_such_name"),
    ]
    shown: list[Found] = []

    report = try_mutants(mutants, coverage, FEW, 1.0, allowed={}, jobs=1, show=shown.append)

    assert [each.outcome for each in report.mutants] == ["caught", "caught", "survived", "broken"]
    assert {each.by.partition("::")[0] for each in report.mutants[:2]} == {"tests/unit/gateway/test_handlers.py"}
    assert (report.caught, report.share, report.unfit, report.good) == (2, 0.5, [], False)
    assert shown == report.mutants


NOT_IMPORTED = """ERROR tests/{0}.py - NameError: no_such_name
ERROR: found no collectors for /tmp/copy/tests/{0}.py::one
"""


@pytest.mark.parametrize("failing", [True, False])
def test_file_that_cannot_be_imported_hides_no_other_failure(failing: bool) -> None:
    asked: list[list[str]] = []

    def run(tests: Sequence[str]) -> Run:
        asked.append([test[6:7] for test in tests])
        for name in "ab":
            if name in asked[-1]:
                return Run(4, [], NOT_IMPORTED.format(name))
        return Run(1, ["tests/d.py::one"], "") if failing else Run(0, [], "")

    found = run_importable([f"tests/{name}.py::one" for name in "cabd"], run)

    assert asked == [list("cabd"), list("cbd"), list("cd")]
    assert (found.code, found.failed) == ((1, ["tests/d.py::one"]) if failing else (4, []))
    assert run_importable(["tests/a.py::one", "tests/a.py::two"], run).code == 4, "there is no other file"


def test_tests_that_reach_the_body_of_a_guard_come_first(coverage: CoverageMap) -> None:
    place = candidates(SHOWN[1:])[0].place
    body = {test.id for test in coverage.reaching(place.file, changed(ROOT, place).body)}

    tests = select(ROOT, place, coverage, Limits(tests=1000, seconds=1000.0))

    assert 0 < len(body) < len(tests)
    assert set(tests[: len(body)]) == body


@pytest.mark.parametrize(
    ("file", "tests"),
    [
        ("pcmrs/gateway/auth/peers.py", "tests/unit/gateway/"),
        ("pcmrs/bucket.py", "tests/unit/test_bucket.py::"),
        ("sim/pcmrs_sim/faults/robot.py", "tests/unit/sim/"),
        ("lab/pcmrs_lab/campaign/run.py", "tests/unit/lab/"),
    ],
)
def test_tests_of_a_package_are_found_where_they_are(file: str, tests: str) -> None:
    assert own_tests(Path(file)) == tests
    assert (ROOT / tests.removesuffix("::")).exists()


def test_tests_of_the_same_package_come_first(coverage: CoverageMap) -> None:
    """Where all else is equal: of two tests that reach a guard, the one of its package is tried before."""
    place = candidates(SHOWN[:1])[0].place
    other, own = (MappedTest(f"tests/unit/{name}/test_x.py::test_x", 1.0) for name in ("bus", "gateway"))
    mapped = dict.fromkeys(coverage.files[str(place.file)].lines, "3")
    files = {str(place.file): msgspec.structs.replace(coverage.files[str(place.file)], lines=mapped)}

    assert select(ROOT, place, CoverageMap([other, own], [], files, 0), FEW) == [own.id, other.id]


FAILS = """
import pytest
@pytest.fixture
def broken(): raise OSError
@pytest.fixture
def left():
    yield
    raise OSError
def test_setup(broken): pass
def test_teardown(left): pass
"""


@pytest.mark.parametrize("call", ["", "def test_call(): assert False\n"])
def test_errors_of_fixtures_catch_nothing(tmp_path: Path, call: str) -> None:
    (tmp_path / "test_few.py").write_text(FAILS + call)
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "tests.mutants.end_at_first_failure",
        "-p",
        "no:cacheprovider",
    ]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    ended = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)

    run = Run(ended.returncode, re.findall(r"^FAILED (\S+)", ended.stdout, re.MULTILINE), ended.stdout)

    assert outcome_of(run, ["test_few.py::test_setup", "test_few.py::test_teardown", "test_few.py::test_call"])[0] == (
        "caught" if call else "broken"
    )
    assert run.failed == (["test_few.py::test_call"] if call else [])


@pytest.mark.parametrize(("failed", "lost", "code"), [([], 0, 0), (["tests/a.py::test_b"], 0, 1), ([], 2, 1)])
def test_a_map_without_some_tests_is_no_success(
    failed: list[str], lost: int, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(run_mutants, "write_map", lambda *_, **__: CoverageMap([], failed, {}, lost))
    monkeypatch.setattr(sys, "argv", ["run_mutants", "map", "--json"])

    assert run_mutants.main() == code
    assert msgspec.json.decode(capsys.readouterr().out) == {"tests": 0, "failed": failed, "lines": 0, "lost": lost}


def test_everything_that_tests_import_is_in_a_copy() -> None:
    """A test file that cannot be imported in a copy catches nothing there."""
    tops = {path.name for path in ROOT.iterdir() if path.is_dir() and not path.name.startswith(".")}
    named = {
        name for path in (ROOT / "tests").rglob("*.py") for name in re.findall(r"ROOT / \"(\w+)\"", path.read_text())
    }

    assert sorted(named & tops - set(COPIED) - {"build"}) == []


def test_lines_run_by_a_process_belong_to_its_test(coverage: CoverageMap) -> None:
    place = find(ROOT, "bus.heart", "main", "open_session(settings.bus)")

    assert [test.id for test in coverage.reaching(place.file, changed(ROOT, place).lines)] == [BEATS]


def test_a_map_of_another_source_or_none_says_how_to_make_one(coverage: CoverageMap, tmp_path: Path) -> None:
    place = candidates(SHOWN[1:])[0].place
    file = coverage.files[str(place.file)]
    other = msgspec.structs.replace(coverage, files={str(place.file): msgspec.structs.replace(file, digest="")})

    with pytest.raises(MapError, match=r"run_mutants map"):
        select(ROOT, place, other, FEW)
    with pytest.raises(MapError, match=r"run_mutants map"):
        read_map(tmp_path / "map.json")


def measured(tests: dict[str, set[int]], digest: str = "as it is") -> CoverageMap:
    """A map of one file, with the lines that each test runs."""
    lines = {line: sum(1 << bit for bit, each in enumerate(tests.values()) if line in each) for line in range(1, 6)}
    file = MappedFile(digest, {line: f"{bits:x}" for line, bits in lines.items() if bits}, set())
    return CoverageMap([MappedTest(name, 1.0) for name in tests], [], {"f.py": file}, 0)


def test_remeasured_tests_replace_themselves_in_the_map() -> None:
    before = measured({"a": {1, 2}, "b": {1, 3}, "c": {3}, "d": {2, 3, 4}})
    after = before.updated(measured({"c": {2, 5}, "e": {1}, "a": {5}}), ["a", "c", "e"])

    reached = {line: {test.id for test in after.reaching(Path("f.py"), [line])} for line in range(1, 6)}
    assert reached == {1: {"b", "e"}, 2: {"c", "d"}, 3: {"b", "d"}, 4: {"d"}, 5: {"a", "c"}}
    with pytest.raises(MapError, match=r"run_mutants map"):
        before.updated(measured({"e": {1}}, digest="changed"), ["e"])


@pytest.mark.parametrize("again", ["t/a.py", "t/a.py/", "t/a.py::renamed", "t", "t/"])
def test_test_that_is_gone_is_removed_from_the_map(again: str) -> None:
    before = measured({"t/a.py::renamed[1]": {1}, "t/a.py::same": {1}, "t/ab.py::other": {1}, "other/c.py::own": {1}})
    after = before.updated(measured({"t/a.py::same": {2}, "t/a.py::new": {1}}), [again])

    kept = {"t/a.py::renamed[1]"} if "::" in again else set()
    kept |= set() if again.rstrip("/") == "t" else {"t/ab.py::other"}
    assert {test.id for test in after.tests} == {"t/a.py::same", "t/a.py::new", "other/c.py::own"} | kept
    assert {test.id for test in after.reaching(Path("f.py"), [1])} == {"t/a.py::new", "other/c.py::own"} | kept


def test_every_allowed_mutant_is_listed_and_has_a_reason() -> None:
    assert allowed().keys() <= {mutant.name for mutant in listed()}
    assert [name for name, entry in allowed().items() if not entry.reason] == []
