"""The timeline is the journal: the session so far, what is new, and further back when asked; nothing twice."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pcmrs.console import _history as history
from pcmrs.console._history import History, entries_from_events, matching
from pcmrs.journal import Journal, JournalRow
from pcmrs.messages import BlueprintTag, DeviceEvent, JournalPage, JournalQuery, Reason, Verdict
from pcmrs.service.publishing import journal_page

TAG = BlueprintTag(id="ratms", version="1", hash="0")


class Asked:
    """A client whose journal is a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    async def journal(self, query: JournalQuery) -> JournalPage:
        return journal_page(self.path, query)


def row(session: str, kind: Any = "outcome", **fields: Any) -> JournalRow:
    verdict = Verdict(
        id="1", branch="robot", operation="connect", decision="rejected", state="0", sequence=1,
        reason=Reason(code="why", text="The cable is loose."),
    )  # fmt: skip
    known: dict[str, Any] = {"branch": "robot", "operation": "connect", "user": "anna", "verdict": verdict}
    known["source"] = "bus:anna"
    return JournalRow(
        kind=kind, wall=1.7e9, monotonic=1.0, boot_id="b", session_id=session, blueprint=TAG, **known | fields
    )


@pytest.fixture(autouse=True)
def small_pages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(history, "PAGE", 4)


async def test_session_is_read_first_then_new_rows_then_older_ones(tmp_path: Path) -> None:
    """Older rows are read when they are requested."""
    journal = Journal.open(tmp_path / "journal.sqlite", durable=False)
    await journal.append([row("old")] * 20)
    await journal.append([row("new")] * 9)
    asked: Any = Asked(tmp_path / "journal.sqlite")
    told = History()
    await told.follow(asked)
    assert [each.sequence for each in told.entries][-9:] == list(range(21, 30)), "the whole session"
    assert not told.whole
    await journal.append([row("new")] * 9)
    await told.follow(asked)
    await told.follow(asked)
    while not told.whole:
        await told.read_older(asked)
    assert [each.sequence for each in told.entries] == list(range(1, 39))
    await journal.close()


async def test_an_empty_journal_is_followed_from_its_first_row(tmp_path: Path) -> None:
    journal = Journal.open(tmp_path / "journal.sqlite", durable=False)
    asked: Any = Asked(tmp_path / "journal.sqlite")
    told = History()
    await told.follow(asked)
    assert told.whole
    await journal.append([row("new")] * 2)
    await told.follow(asked)
    assert [each.sequence for each in told.entries] == [1, 2]
    await journal.close()


async def test_rows_say_who_what_and_why(tmp_path: Path) -> None:
    journal = Journal.open(tmp_path / "journal.sqlite", durable=False)
    event = {"verdict": None, "branch": None, "user": None, "source": "robot", "operation": "link_lost"}
    await journal.append(
        [
            row("s"),
            row("s", "intent"),
            row("s", "device", **event, result={"text": "Gone.", "danger": True, "fields": {}}),
            row("s", source="activity:watch_alignment"),
        ]
    )
    told = History()
    await told.follow(Asked(tmp_path / "journal.sqlite"))  # type: ignore[arg-type]
    decided, lost, by_itself = told.entries
    assert (decided.who, decided.what, decided.result) == ("anna", "robot.connect: rejected", "The cable is loose.")
    assert (lost.who, lost.what, lost.result) == ("", "robot: link_lost", "Gone.")
    assert by_itself.kind == "activity"
    assert matching(told.entries, "CABLE", ["outcome"], 10) == [decided]
    assert matching(told.entries, "", [], 2) == [decided, lost]
    assert matching(told.entries, "anna", ["device"], 10) == []
    await journal.close()


def test_role_without_the_journal_sees_received_messages() -> None:
    verdict = Verdict(id="1", branch="robot", operation="connect", decision="accepted", state="1", sequence=1)
    event = DeviceEvent(device="robot", code="link_lost", text="Gone.")
    decided, lost = entries_from_events([(1.0, verdict), (2.0, event)])
    assert (decided.wall, decided.what, decided.result) == (1.0, "robot.connect: accepted", "")
    assert (lost.kind, lost.what, lost.result) == ("device", "robot: link_lost", "Gone.")
