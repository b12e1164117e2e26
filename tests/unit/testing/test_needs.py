"""What a fault needs is looked for when it is run, not when it is registered."""

from __future__ import annotations

import pytest

from pcmrs.testing.needs import ROOT, module, program


def test_a_program_is_found_on_the_present_search_path(monkeypatch: pytest.MonkeyPatch) -> None:
    shell = program("sh")
    assert (shell.name, shell.is_met()) == ("sh", True)
    monkeypatch.setenv("PATH", "")
    assert not shell.is_met()


def test_a_module_is_met_without_being_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    assert module("json").is_met()
    assert not module("no_such_module").is_met()


@pytest.mark.parametrize(("user", "met"), [(0, True), (1000, False)])
def test_root_is_the_effective_user(monkeypatch: pytest.MonkeyPatch, user: int, met: bool) -> None:
    monkeypatch.setattr("os.geteuid", lambda: user)
    assert ROOT.is_met() is met
