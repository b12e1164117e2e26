"""The row of a new folder: lost counters are reported before anything is accepted; kept ones refuse a repeat."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pcmrs.gateway.links import RESET
from pcmrs.gateway.rejection_log import REFUSED
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.fault import Evidence
from pcmrs_lab.campaign.faults import new_folder
from pcmrs_lab.campaign.sham import sham
from tests.unit.lab.campaign.faults.operated import OperatedCell, proves, run
from tests.unit.lab.campaign.scripted_cell import ScriptedCell, ScriptedLab
from tests.unit.lab.scripted_client import row


class Folders(ScriptedLab):
    """A lab of daemons that keep the counters of their peers in their folders.

    Attributes:
        reports: Times that a daemon without counters reports that.
        always: A daemon that has its counters reports, too.
        forgets: A daemon accepts what it has accepted already.
        answers: A repeated command is answered.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
        super().__init__(folder, OperatedCell())
        self.reports, self.always, self.forgets, self.answers = 1, False, False, False
        self._known: dict[str, OperatedCell] = {}
        monkeypatch.setattr(new_folder, "send_accepted", self._send)
        monkeypatch.setattr(new_folder, "raw_socket", self._raw)
        monkeypatch.setattr(new_folder, "until_true", self._until)

    @asynccontextmanager
    async def daemon(self, *overrides: str, **given: Any) -> AsyncIterator[ScriptedCell]:
        folder: Path = given["folder"]
        is_new = folder.name not in self._known
        cell = self._known.setdefault(folder.name, OperatedCell(folder))
        if (is_new and folder.name != "old") or (self.always and not is_new):
            for _number in range(self.reports):
                text = {"text": "Counters of slicer begin at 0."}
                cell.client.rows.append(row("device", operation=RESET, result=text))
                cell.log += f"warning {RESET}\n"
        yield cell

    async def _send(self, _: OperatedCell, command: bytes) -> str:
        assert b"|slicer|1|" in command
        return "1_accepted"

    @asynccontextmanager
    async def _raw(self, _: Any) -> AsyncIterator[Any]:
        cell = self._known["old"]

        def send(_: bytes) -> None:
            if not self.forgets:
                fields = {"fields": {"count": 1, "reason": "repeated"}}
                cell.client.rows.append(row("device", operation=REFUSED, result=fields))

        yield SimpleNamespace(send=send, answers=SimpleNamespace(empty=lambda: not self.answers))

    async def _until(self, condition: Any, missing: str) -> None:
        if not condition():
            raise Unmet(missing)


@pytest.fixture
def folders(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Folders:
    return Folders(monkeypatch, tmp_path)


def ran(monkeypatch: pytest.MonkeyPatch, folders: Folders) -> Evidence:
    return run(monkeypatch, new_folder.counters_are_gone(folders.as_lab))


def test_lost_counters_are_reported_at_the_start(monkeypatch: pytest.MonkeyPatch, folders: Folders) -> None:
    found = ran(monkeypatch, folders)
    assert proves(found)
    assert found.took_place == {"taken_once_more": "1_accepted"}
    assert found.control["refused_with_its_counters"] == 1
    assert found.control["taken_when_it_was_sent"]
    assert found.details == {"text": "Counters of slicer begin at 0."}


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        ({"reports": 0}, r"At the start the journal reports \[\]"),
        ({"reports": 2}, "At the start the journal reports"),
        ({"always": True}, "reports counters as lost that it still has"),
        ({"forgets": True}, "The journal has no refusal of the repeated command"),
        ({"answers": True}, "The repeated command is answered"),
    ],
)
def test_anything_else_is_unmet(
    monkeypatch: pytest.MonkeyPatch, folders: Folders, changed: dict[str, Any], text: str
) -> None:
    for name, value in changed.items():
        setattr(folders, name, value)
    with pytest.raises(Unmet, match=text):
        ran(monkeypatch, folders)


def test_a_folder_that_is_not_new_is_found_out(monkeypatch: pytest.MonkeyPatch, folders: Folders) -> None:
    with sham(), pytest.raises(Unmet, match=r"At the start the journal reports \[\]"):
        ran(monkeypatch, folders)
