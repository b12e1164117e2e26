"""Rules that delay frames: they count while their context lasts, and one that delays nothing is found."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path
from typing import Any

import msgspec
import pytest

from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.delays import FOLDER, PATIENCE, VARIABLE, Delayed, Delays, Rule, delays_of
from pcmrs_lab.campaign.sham import sham
from tests.unit.lab.campaign.scripted_cell import ScriptedCell, run

HOLD = Rule("receive", "dev/robot/cmd", "hold", 0.5)


@pytest.fixture
def delays(tmp_path: Path) -> Delays:
    made = Delays(tmp_path / FOLDER)
    made.install()
    return made


def rules(folder: Path) -> list[Rule]:
    return msgspec.json.decode((folder / FOLDER / "rules").read_bytes(), type=list[Rule])


def note(folder: Path, name: str, what: Rule | Delayed) -> None:
    """As a delayed process notes it."""
    with (folder / FOLDER / name).open("ab") as file:
        file.write(msgspec.json.encode(what) + b"\n")


def record(rule: Rule, begun: float = 1.0) -> Delayed:
    return Delayed(rule, begun, begun + 0.5, 3)


def test_process_and_its_children_delayed_by_their_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", "/elsewhere")
    environment = Delays(tmp_path / FOLDER).install()
    assert environment == {VARIABLE: str(tmp_path / FOLDER), "PYTHONPATH": f"{tmp_path / FOLDER}{os.pathsep}/elsewhere"}
    assert "install()" in (tmp_path / FOLDER / "sitecustomize.py").read_text()
    assert rules(tmp_path) == []


def test_rules_of_contexts_within_each_other_all_count(
    tmp_path: Path, delays: Delays, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def nest() -> list[list[Rule]]:
        seen = []
        other = Rule("pass", "journal.before_commit", seconds=1.0)
        async with delays.delaying(HOLD):
            async with delays.delaying(other):
                seen.append(rules(tmp_path))
                note(tmp_path, "done", record(other))
            seen.append(rules(tmp_path))
            note(tmp_path, "done", record(HOLD))
        return [*seen, rules(tmp_path)]

    both, outer, none = run(monkeypatch, nest())
    assert ([rule.key for rule in both], outer, none) == (["dev/robot/cmd", "journal.before_commit"], [HOLD], [])


def test_a_rule_that_delayed_nothing_is_no_fault(
    tmp_path: Path, delays: Delays, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def delay() -> None:
        async with delays.delaying(HOLD):
            note(tmp_path, "begun", HOLD)  # it did not end

    with pytest.raises(Unmet, match=r"The fault was not injected: .* delayed 0 of 1 frames"):
        run(monkeypatch, delay())
    assert rules(tmp_path) == [], "it does not count any more"


def test_a_process_that_ends_in_between_only_has_to_begin(
    tmp_path: Path, delays: Delays, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def delay(begun: bool) -> None:
        async with delays.delaying(rule := Rule("pass", "dispatcher.before_outcome"), ended=False):
            if begun:
                note(tmp_path, "begun", rule)

    run(monkeypatch, delay(begun=True))
    with pytest.raises(Unmet, match="delayed no frame"):
        run(monkeypatch, delay(begun=False))


def test_an_error_in_the_context_ends_its_rules(tmp_path: Path, delays: Delays) -> None:
    async def delay() -> None:
        async with delays.delaying(HOLD):
            raise Unmet("It moved.")

    with pytest.raises(Unmet, match="It moved"):
        asyncio.run(delay())
    assert rules(tmp_path) == []


def test_equal_rules_have_different_records(tmp_path: Path, delays: Delays, monkeypatch: pytest.MonkeyPatch) -> None:
    same = Rule("receive", "dev/robot/cmd", "hold", 0.5)
    assert same != HOLD
    note(tmp_path, "done", record(same))
    note(tmp_path, "done", record(HOLD, 7.0))
    assert run(monkeypatch, delays.wait_until_delayed(HOLD)) == [record(HOLD, 7.0)]


def test_as_many_frames_as_wanted_are_waited_for(
    tmp_path: Path, delays: Delays, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def wait() -> int:
        for after in (1.0, 2.0):
            asyncio.get_running_loop().call_later(after, note, tmp_path, "done", record(HOLD, after))
        return len(await delays.wait_until_delayed(HOLD, 2))

    assert run(monkeypatch, wait()) == 2
    with pytest.raises(Unmet, match="delayed 2 of 3 frames"):
        run(monkeypatch, delays.wait_until_delayed(HOLD, 3))
    assert PATIENCE == 20.0


def test_no_rule_is_in_force_in_a_sham_campaign(
    tmp_path: Path, delays: Delays, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def delay() -> Any:
        async with delays.delaying(HOLD):
            pass

    with sham(), pytest.raises(Unmet, match="not injected"):
        run(monkeypatch, delay())
    assert rules(tmp_path) == []


def test_the_rules_of_a_cell_are_below_its_folder(
    tmp_path: Path, delays: Delays, monkeypatch: pytest.MonkeyPatch
) -> None:
    note(tmp_path, "begun", HOLD)
    run(monkeypatch, delays_of(ScriptedCell(tmp_path).as_cell).wait_until_delaying(HOLD))
