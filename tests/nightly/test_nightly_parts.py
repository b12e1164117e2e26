"""The parts of a nightly run hold every nightly test once, and a part counts as green only when it is."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path
from typing import Any

import msgspec
import pytest

from tests import ROOT
from tests.nightly import nightly_results, run
from tests.nightly.nightly_counts import counted
from tests.nightly.nightly_parts import Part, chosen, command_of, holders, parts
from tests.nightly.nightly_results import Result, has_code_of, publish, published, this_machine

MOST_HOURS = 6
REPORT = """<testsuites><testsuite>
<testcase classname="tests.unit.fsm.test_walk" name="test_a[1]"/>
<testcase classname="tests.unit.fsm.test_walk" name="test_b"><failure message="x"/></testcase>
<testcase classname="tests.unit.fsm.test_walk" name="test_c"><error message="x"/></testcase>
<testcase classname="tests.unit.fsm.test_walk" name="test_d"><skipped message="no spin"/></testcase>
<testcase classname="tests.unit.fsm.test_walk" name="test_e"><skipped type="pytest.xfail" message="x"/></testcase>
</testsuite></testsuites>"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Results go there."""
    monkeypatch.setattr(nightly_results, "FOLDER", tmp_path)
    monkeypatch.setattr(run, "FOLDER", tmp_path)
    return tmp_path


def test_every_nightly_test_is_in_one_part(collected: list[Any]) -> None:
    """Of those that this run has collected: in `make test` all."""
    table = {part.name: part for part in parts()}
    files = {each.file for each in collected if each.only == "nightly"}

    assert {file: found for file in sorted(files) if len(found := holders(file, table)) != 1} == {}


def test_parts_are_unique_there_and_together_not_too_long() -> None:
    names = [part.name for part in parts()]

    assert len(set(names)) == len(names)
    assert [file for part in parts() for file in part.tests if not (ROOT / "tests" / file).exists()] == []
    assert [part.name for part in parts() if bool(part.tests) == bool(part.command)] == []
    assert sum(part.minutes for part in parts()) <= 60 * MOST_HOURS


def test_a_part_is_chosen_by_its_name_or_its_first_word() -> None:
    assert [part.name for part in chosen("sham")] == ["sham-1", "sham-2", "sham-3"]
    assert [part.name for part in chosen("faults-clock")] == ["faults-clock"]
    assert chosen("fault") == []
    assert chosen("") == parts()
    assert "--sham --part 2/3 " in command_of(chosen("sham-2")[0], Path("unused"), 0)[-1]


def test_results_of_pytest_are_counted(tmp_path: Path) -> None:
    report = tmp_path / "report.xml"
    report.write_text(REPORT)

    found = counted("pytest", report, "", 1)

    file = "tests/unit/fsm/test_walk.py"
    assert (found.passed, found.failed, found.skipped) == (2, 3, {"no spin": 1})
    assert found.failures == [f"{file}::test_b", f"{file}::test_c", f"skipped: {file}::test_d: no spin"]


def test_skips_that_the_budget_has_are_no_failures(tmp_path: Path) -> None:
    report = tmp_path / "report.xml"
    report.write_text(REPORT.replace("no spin", "no package index can be reached"))

    assert counted("pytest", report, "", 1).failed == 2


def test_a_part_of_pytest_is_run_with_the_budget_of_skips() -> None:
    assert "--tools-installed " in command_of(chosen("journal")[0], Path("unused"), 0)[-1]


def test_faults_that_are_not_proved_or_not_run_have_failed() -> None:
    outcomes = ("passed", "failed", "not_proved", "not_run")
    faults = [{"id": each, "outcome": each, "response": "seen"} for each in outcomes]

    found = counted("faults", Path("unused"), json.dumps({"faults": faults}), 1)

    assert (found.passed, found.skipped) == (1, {"seen": 1})
    assert found.failures == ["failed", "not_proved", "skipped: not_run: seen"]


def test_broken_sessions_have_failed() -> None:
    sessions = {"sessions": 9, "broken": [{"seed": 4, "invariant": "stop_holds"}]}

    found = counted("explore", Path("unused"), json.dumps(sessions), 1)

    assert (found.passed, found.failures) == (8, ["seed 4: stop_holds"])


@pytest.mark.parametrize(("wanted", "failures"), [(1.0, ["b: survived"]), (0.5, [])])
def test_missed_mutants_have_failed_unless_enough_are_caught(wanted: float, failures: list[str]) -> None:
    mutants = [
        {"name": "a", "outcome": "caught", "allowed": ""},
        {"name": "b", "outcome": "survived", "allowed": ""},
        {"name": "c", "outcome": "survived", "allowed": "changes nothing"},
    ]
    said = {"mutants": mutants, "caught": 1, "share": 0.5, "wanted": wanted, "unfit": []}

    found = counted("mutants", Path("unused"), json.dumps(said), len(failures))

    assert (found.passed, found.failures) == (1, failures)
    assert found.skipped == {"c: changes nothing": 1} | ({} if failures else {"b: survived": 1})


def test_tests_that_failed_under_coverage_are_named() -> None:
    said = {"tests": 7, "failed": ["tests/unit/a.py::test_b"], "lines": 9, "lost": 2}

    found = counted("map", Path("unused"), json.dumps(said), 1)

    assert (found.passed, found.failures) == (7, ["tests/unit/a.py::test_b", "2 processes without data"])


def test_guards_that_no_test_runs_are_counted_and_named() -> None:
    entry = {"module": "bus.seal", "function": "f", "guard": "x > 1", "side": "never holds"}
    said = {"guards": 9, "uncovered": [{**entry, "reason": ""}, {**entry, "function": "g", "reason": "narrows a type"}]}

    found = counted("uncovered", Path("unused"), json.dumps(said), 1)

    assert (found.passed, found.failures) == (7, ["bus.seal:f: x > 1 never holds"])
    assert found.skipped == {"bus.seal:g: x > 1 never holds: narrows a type": 1}


@pytest.mark.parametrize("how", ["pytest", "faults", "explore", "mutants", "map", "uncovered", "exit"])
@pytest.mark.parametrize(("output", "code"), [("", 1), ("{", -9), ("[]", 2), ('{"faults": []}', 139)])
def test_part_without_a_valid_report_has_failed(tmp_path: Path, how: str, output: str, code: int) -> None:
    found = counted(how, tmp_path / "none.xml", output, code)  # type: ignore[arg-type]

    assert found.failed > 0


@pytest.mark.parametrize(("code", "green"), [(0, True), (3, False)])
def test_a_part_is_run_and_its_result_kept(folder: Path, code: int, green: bool) -> None:
    part = Part(name="short", minutes=1, command=f"exit {code}")

    result = run.run_part(part, "0123456789")

    assert result.green is green
    assert nightly_results.result_of(part) == result
    assert (result.part, result.commit, result.exit_code) == ("short", "0123456789", code)
    assert result.machine == this_machine()


def test_a_part_that_hangs_is_ended_with_what_it_started(folder: Path) -> None:
    part = Part(name="hangs", minutes=0.2 / 60, command="sleep 600 & sleep 600")

    result = run.run_part(part, "0123456789")

    assert (result.green, result.exit_code) == (False, 124)
    assert result.seconds < 60


def test_a_part_that_tried_nothing_is_not_green(folder: Path) -> None:
    part = Part(name="none", minutes=1, command="echo '{{\"faults\": []}}'", counted="faults")

    assert not run.run_part(part, "0123456789").green


def test_publishing_replaces_only_parts_that_were_run(folder: Path) -> None:
    first, second = parts()[:2]
    kept = run.run_part(msgspec.structs.replace(first, tests=(), command="true", counted="exit"), "1" * 40)
    before = [msgspec.structs.replace(kept, part=name, commit="2" * 40) for name in (first.name, second.name, "gone")]
    path = folder / "last.json"
    path.write_bytes(msgspec.json.encode(before))

    publish(path)

    assert [(each.part, each.commit[0]) for each in published(path)] == [(first.name, "1"), (second.name, "2")]


def test_a_result_published_elsewhere_is_the_last_one(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    part = Part(name="short", minutes=1, command="true")
    here = run.run_part(part, "1" * 40)
    elsewhere = msgspec.structs.replace(here, commit="2" * 40)
    monkeypatch.setattr(nightly_results, "PUBLISHED", folder / "last.json")
    nightly_results.PUBLISHED.write_bytes(msgspec.json.encode([elsewhere]))
    assert nightly_results.result_of(part) == here
    (folder / "short.json").unlink()
    assert nightly_results.result_of(part) == elsewhere
    assert nightly_results.result_of(msgspec.structs.replace(part, name="other")) is None


def test_a_result_counts_while_only_reports_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def git(*words: str) -> None:
        author = ("-c", "user.name=a", "-c", "user.email=a@example.org")
        subprocess.run(["git", *author, *words], cwd=tmp_path, capture_output=True, check=True)

    def commit(file: str) -> str:
        (tmp_path / file).parent.mkdir(exist_ok=True)
        with (tmp_path / file).open("a") as changed:
            changed.write("a line\n")
        git("add", "-A")
        git("commit", "-m", file)
        return nightly_results.this_commit()

    monkeypatch.setattr(nightly_results, "ROOT", tmp_path)
    git("init")
    code, documents, more_code = commit("pcmrs/a.py"), commit("docs/evidence.md"), commit("pcmrs/b.py")
    assert has_code_of(documents, code)
    assert not has_code_of(more_code, documents)
    (tmp_path / "pcmrs/b.py").write_text("changed\n")
    changed = nightly_results.this_commit()
    assert changed == more_code + "+"
    assert not has_code_of(changed, changed)
    assert not has_code_of(more_code, "0" * 40), "a commit that is not known here"


def test_published_results_are_readable() -> None:
    for result in published():
        assert isinstance(result, Result)
        assert re.fullmatch(r"[0-9a-f]{40}\+?", result.commit)
