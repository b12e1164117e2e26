"""A program runs without the named guards, and nothing else of it differs."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest

from pcmrs_lab.campaign.without_guard import Finder, Guard, changed, guards, without_guards
from tests import ROOT
from tests.mutants.listed_guards import listed

GATE = "def passes(speed):\n    if speed > 1:\n        return False\n    return True\n"


@pytest.fixture
def gate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A module with a guard, which is not loaded."""
    (tmp_path / "one_gate.py").write_text(GATE)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield "one_gate"
    sys.modules.pop("one_gate", None)


def test_guards_of_controls_are_listed_mutants() -> None:
    """So a test fails without each of them, and not only a row of the campaign."""
    known = {each.name: (f"pcmrs.{each.module}", each.guard, each.without) for each in listed()}
    assert {name: (each.module, each.guard, each.without) for name, each in guards().items()} == {
        name: known.get(name) for name in guards()
    }


@pytest.mark.parametrize("name", guards())
def test_each_guard_is_in_the_source_of_its_module(name: str) -> None:
    guard = guards()[name]
    path = ROOT / Path(*guard.module.split(".")).with_suffix(".py")
    source = changed(path.read_text(), guard)
    compile(source, str(path), "exec", dont_inherit=True)
    assert source != path.read_text()


def test_only_the_named_guard_is_gone(gate: str, monkeypatch: pytest.MonkeyPatch) -> None:
    guard = Guard(gate, "speed > 1", "False")
    monkeypatch.setattr(sys, "meta_path", [Finder([guard]), *sys.meta_path])
    assert import_module(gate).passes(2)
    assert Finder([guard]).find_spec("json", None) is None


def test_the_bytecode_of_the_unchanged_source_is_not_used(gate: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert not import_module(gate).passes(2)
    del sys.modules[gate]
    monkeypatch.setattr(sys, "meta_path", [Finder([Guard(gate, "speed > 1", "False")]), *sys.meta_path])
    assert import_module(gate).passes(2)


@pytest.mark.parametrize("text", ["speed > 5", "return"])
def test_a_text_that_is_not_there_once_is_an_error(gate: str, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "meta_path", [Finder([Guard(gate, text, "pass")]), *sys.meta_path])
    with pytest.raises(ImportError, match=r"occurs \d times in one_gate; it must occur once"):
        import_module(gate)


def test_a_module_that_is_nowhere_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "meta_path", [Finder([Guard("no_such_gate", "x", "y")]), *sys.meta_path])
    with pytest.raises(ImportError, match="no_such_gate, which has the guard 'x', is not found"):
        import_module("no_such_gate")


def test_an_unknown_guard_is_refused_before_anything_starts() -> None:
    with pytest.raises(KeyError, match="no_such_guard"):
        without_guards("a_coordinate_in_millimetres", "no_such_guard")


def test_a_program_of_the_product_starts_without_its_guards(tmp_path: Path) -> None:
    words = ("python", "-m", "pcmrs.cli", "--version")
    ended = subprocess.run(
        [*without_guards("text_is_logged_as_it_came", "bad_rows_are_no_problem"), *words],
        capture_output=True,
        text=True,
        check=True,
        cwd=tmp_path,
    )
    assert "0.1" in ended.stdout
