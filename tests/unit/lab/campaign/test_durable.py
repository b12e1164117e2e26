"""A daemon whose disk fails: what it must refuse, what it must still do, and what its journal must have afterwards."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.journal import Journal
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.durable import AnsweredCommands
from tests.unit.lab.campaign.scripted_cell import ScriptedCell, run
from tests.unit.lab.scripted_client import Answer, rejected, row, verdict

NAME = "registration.reinit"
BROKEN = rejected("journal_broken")
ACCEPTED: Answer = ("accepted", None)


def asked(*answers: Answer) -> tuple[ScriptedCell, AnsweredCommands]:
    cell = ScriptedCell()
    cell.client.answers[NAME] = list(answers)
    return cell, AnsweredCommands(cell.as_cell)


async def test_a_degraded_daemon_refuses_and_still_stops() -> None:
    cell, commands = asked(BROKEN, BROKEN)
    assert await commands.degraded() == {"refused_as": "journal_broken", "latched": True}
    assert cell.client.asked == [NAME, NAME]


async def test_the_outcome_of_the_first_command_may_be_unknown() -> None:
    cell, commands = asked(BROKEN)
    cell.client.silent = True
    assert await commands.request() is None
    assert commands.verdicts == {}, "what was not answered need not be in the journal"
    cell.client.silent = False
    cell.client.answers[NAME] = [("failed", BROKEN[1]), BROKEN]
    await commands.degraded()
    assert list(commands.verdicts) == ["durable2", "durable3"], "every command has its own id"


@pytest.mark.parametrize(
    ("answers", "text"),
    [
        ((ACCEPTED, BROKEN), "A change of state was accepted"),
        ((BROKEN, ACCEPTED), "was accepted; expected rejected"),
        ((BROKEN, ("failed", None)), "was failed; expected rejected"),
    ],
)
async def test_a_daemon_that_changes_state_is_not_degraded(answers: tuple[Answer, ...], text: str) -> None:
    _, commands = asked(*answers)
    with pytest.raises(Unmet, match=text):
        await commands.degraded()


async def test_a_daemon_that_ends_or_does_not_latch_is_unmet(monkeypatch: pytest.MonkeyPatch) -> None:
    cell, commands = asked(BROKEN, BROKEN)
    cell.process.returncode = 1
    with pytest.raises(Unmet, match="daemon has ended"):
        await commands.degraded()

    async def ignore() -> None:
        pass

    cell, commands = asked(BROKEN, BROKEN)
    monkeypatch.setattr(cell.client, "stop", ignore)
    with pytest.raises(Unmet, match="Stop did not latch"):
        await commands.degraded()


def test_a_daemon_recovers_when_it_accepts_again(monkeypatch: pytest.MonkeyPatch) -> None:
    _, commands = asked(BROKEN, BROKEN)
    assert run(monkeypatch, commands.recovers())


def test_a_daemon_that_refuses_for_good_or_ends_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    _, commands = asked(*[BROKEN] * 9)
    assert not run(monkeypatch, commands.recovers(1.0))
    cell, commands = asked()
    cell.process.returncode = 1
    assert not run(monkeypatch, commands.recovers())
    assert cell.client.asked == []


async def test_an_acknowledged_decision_must_be_in_the_journal(tmp_path: Path) -> None:
    _, commands = asked()
    commands.verdicts = {
        "1": verdict(id="1"),
        "2": verdict(id="2", decision="rejected", code="busy"),
        "3": verdict(id="3"),
    }
    path = tmp_path / "ratms.sqlite"
    journal = Journal.open(path)
    await journal.append([row(verdict=commands.verdicts["1"])])
    with pytest.raises(Unmet, match="1 of 2 acknowledged decisions are not in the journal"):
        commands.check_journalled(path)
    await journal.append([row(verdict=commands.verdicts["3"])])
    assert commands.check_journalled(path) == 2
    await journal.close()
