"""Rows of an account in the name of a device: what must be refused is, is counted, and works with the key."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from pcmrs.bus import Bus
from pcmrs.errors import DeviceError
from pcmrs.messages import DeviceEvent, DeviceReply, DeviceRequest, Reason
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.fault import Evidence, Injector
from pcmrs_lab.campaign.faults import impersonation
from pcmrs_lab.campaign.faults.impersonation import FORGED, FORGED_EVENT
from pcmrs_lab.campaign.sham import sham
from tests.unit.lab.campaign.faults.operated import OperatedCell, lab_of, proves, run
from tests.unit.lab.campaign.scripted_cell import ScriptedBus
from tests.unit.lab.scripted_client import row

REFUSAL = DeviceReply(failure=Reason(code="not_sealed", text="It has no seal."))
JOINTS = {"positions": [0.0, 0.0]}


class Guarded(OperatedCell):
    """A cell that counts messages without the key, and a stranger's bus to it.

    Attributes:
        answer: What a stranger's request is answered with.
        believes: Messages without the key count.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__()
        self.answer: Any = REFUSAL
        self.believes = False
        self.dropped = {"bus.not_sealed": 4, "events.misnamed": 1}
        self.strange = ScriptedBus()
        self.strange.answers = {f"dev/{name}/cmd": self._answer for name in ("robot", "stimulator", "pointer")}
        self.bus.answers["dev/robot/cmd"] = DeviceReply(result=JOINTS)
        self.client.devices["robot.joints"] = JOINTS
        self.own, self.foreign = self.bus.publish, self.strange.publish
        monkeypatch.setattr(self.strange, "publish", self._dropped)
        monkeypatch.setattr(self.bus, "publish", self._published)
        monkeypatch.setattr(self.client, "health", self._health)
        monkeypatch.setattr(impersonation, "stranger", self._stranger)

    def _answer(self, _: DeviceRequest) -> Any:
        return self.answer

    @asynccontextmanager
    async def _stranger(self, _: Any) -> AsyncIterator[ScriptedBus]:
        yield self.strange

    async def _health(self) -> Any:
        return SimpleNamespace(dropped=dict(self.dropped))

    def _dropped(self, key: str, message: Any) -> None:
        self.foreign(key, message)
        if self.believes:
            self._published(key, message)
        else:
            self.dropped["bus.not_sealed"] += 1

    def _published(self, key: str, message: Any) -> None:
        self.own(key, message)
        if not isinstance(message, DeviceEvent):
            return
        if message == FORGED_EVENT:
            self.client.hold()
        elif key == f"dev/{message.device}/event" or self.believes:
            self.client.rows.append(row("device", operation=message.code, source=message.device))
        else:
            self.dropped["events.misnamed"] += 1


@pytest.fixture
def cell(monkeypatch: pytest.MonkeyPatch) -> Guarded:
    return Guarded(monkeypatch)


def ran(monkeypatch: pytest.MonkeyPatch, folder: Path, cell: Guarded, injection: Injector) -> Evidence:
    return run(monkeypatch, injection(lab_of(folder, cell)))


def test_requests_without_the_key_are_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: Guarded) -> None:
    found = ran(monkeypatch, tmp_path, cell, impersonation.requests_past_the_daemon)
    assert proves(found)
    assert set(found.took_place["answered_by_the_nodes"].values()) == {"not_sealed"}
    assert len(found.took_place["answered_by_the_nodes"]) == 5
    assert found.control == {"joints_with_the_key": JOINTS}
    cell.answer = DeviceError("It is refused.", reason="not_sealed")
    assert ran(monkeypatch, tmp_path, cell, impersonation.requests_past_the_daemon).took_place == found.took_place


def test_a_request_that_is_served_is_unmet(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: Guarded) -> None:
    cell.answer = DeviceReply(result=JOINTS)
    with pytest.raises(Unmet, match=r"'robot\.joints': 'served'"):
        ran(monkeypatch, tmp_path, cell, impersonation.requests_past_the_daemon)
    cell.answer = REFUSAL
    cell.bus.answers["dev/robot/cmd"] = REFUSAL
    with pytest.raises(Unmet, match="The same request with the key is refused, too"):
        ran(monkeypatch, tmp_path, cell, impersonation.requests_past_the_daemon)


def test_requests_that_were_not_sent_are_found_out(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: Guarded
) -> None:
    with sham(), pytest.raises(Unmet, match=r"were answered: \{\}"):
        ran(monkeypatch, tmp_path, cell, impersonation.requests_past_the_daemon)


def test_messages_in_a_devices_name_are_dropped(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: Guarded) -> None:
    found = ran(monkeypatch, tmp_path, cell, impersonation.messages_in_a_devices_name)
    assert proves(found)
    assert found.took_place == {"counted": 5 * FORGED}
    assert found.control == {"motion": "accepted", "the_event_with_the_key_latches": True}


def test_messages_that_are_believed_are_unmet(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: Guarded) -> None:
    cell.believes = True
    with pytest.raises(Unmet, match="The motion ended as failed"):
        ran(monkeypatch, tmp_path, cell, impersonation.messages_in_a_devices_name)


def test_messages_that_were_not_put_are_found_out(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: Guarded
) -> None:
    with sham(), pytest.raises(Unmet, match="forged messages the daemon counted 0"):
        ran(monkeypatch, tmp_path, cell, impersonation.messages_in_a_devices_name)


def test_every_kind_of_message_is_forged() -> None:
    bus = ScriptedBus()
    assert impersonation._forge(cast(Bus, bus)) == len(bus.published) == 5 * FORGED
    assert {key for key, _ in bus.published} == {
        "dev/robot/beat",
        "dev/robot/event",
        "state/joints",
        "state/pose/coil",
        "daemon/beat",
    }


def test_an_event_counts_in_its_own_name_only(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: Guarded) -> None:
    found = ran(monkeypatch, tmp_path, cell, impersonation.event_of_another_device)
    assert proves(found)
    assert found.took_place == {"misnamed": 4}
    assert found.control == {"journalled_in_its_own_name": ["tracker"]}
    with sham(), pytest.raises(Unmet, match="Of 4 events in the name of another device 0 were counted"):
        ran(monkeypatch, tmp_path, cell, impersonation.event_of_another_device)
    cell.believes = True
    with pytest.raises(Unmet, match="in the name of another device 0"):
        ran(monkeypatch, tmp_path, cell, impersonation.event_of_another_device)
