"""Rows of an account in the name of a device: what must be refused is, is counted, and works with the key."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from pcmrs.bus import Bus
from pcmrs.devices.gate import ACTS
from pcmrs.errors import DeviceError
from pcmrs.messages import (
    Beat,
    DeviceEvent,
    DeviceHealth,
    DeviceReply,
    DeviceRequest,
    GateState,
    NodeBeat,
    Reason,
)
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.fault import Evidence, Injector
from pcmrs_lab.campaign.faults import impersonation
from pcmrs_lab.campaign.faults.impersonation import FAR_AHEAD, FORGED, FORGED_EVENT
from pcmrs_lab.campaign.sham import sham
from tests.unit.lab.campaign.faults.operated import OperatedCell, lab_of, proves, run
from tests.unit.lab.campaign.scripted_cell import ScriptedBus
from tests.unit.lab.scripted_client import row

REFUSAL = DeviceReply(failure=Reason(code="not_sealed", text="It has no seal."))
JOINTS = {"positions": [0.0, 0.0]}
GATES = {device: GateState(node=f"node of {device}", epoch=3, latched=True, daemon="daemon") for device in ACTS}
BEAT = Beat(number=5, session="daemon", alive=1.0, sent=1.0)


class Guarded(OperatedCell):
    """A cell that counts messages without the key, and a stranger's bus to it.

    Attributes:
        answer: What a stranger's request is answered with.
        believes: Messages without the key count.
        repeats: Number of repeated messages that are counted.
        device: Bus of a device's certificate on another machine, which may put nothing in the daemon's name.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__()
        self.answer: Any = REFUSAL
        self.believes = False
        self.repeats = FORGED
        self.implausible = 0
        self.dropped = {"bus.not_sealed": 4, "events.misnamed": 1}
        self.strange, self.device = ScriptedBus(), ScriptedBus()
        self.strange.answers = {f"dev/{name}/cmd": self._answer for name in ACTS}
        self.bus.answers["dev/robot/cmd"] = self._serve
        self.client.devices["robot.joints"] = JOINTS
        self.own, self.foreign, self._listen = self.bus.publish, self.strange.publish, self.client.listen
        monkeypatch.setattr(self.strange, "publish", self._dropped)
        monkeypatch.setattr(self.bus, "publish", self._published)
        monkeypatch.setattr(self.device, "publish", self._published_by_device)
        monkeypatch.setattr(self.client, "health", self._health)
        monkeypatch.setattr(self.client, "listen", self._told)
        monkeypatch.setattr(self.client, "holding", self._holding, raising=False)
        monkeypatch.setattr(impersonation, "stranger", self._stranger)
        monkeypatch.setattr(impersonation, "reachable_cell", self._reachable)
        monkeypatch.setattr(impersonation, "device_session", self._device_session)
        monkeypatch.setattr(impersonation, "_gates", self._gates)
        monkeypatch.setattr(impersonation, "_replay", self._replay)

    def _answer(self, _: DeviceRequest) -> Any:
        return self.answer

    def _serve(self, request: DeviceRequest) -> DeviceReply:
        self.client.restless = self.client.restless or request.method == "follow"
        return DeviceReply(result=JOINTS)

    async def _gates(self, _: Any) -> dict[str, GateState]:
        return GATES

    def _replay(self, _: Any) -> int:
        self.dropped["bus.not_sealed"] += self.repeats
        return self.repeats

    @asynccontextmanager
    async def _stranger(self, _: Any) -> AsyncIterator[ScriptedBus]:
        yield self.strange

    @asynccontextmanager
    async def _reachable(self, _: Any) -> AsyncIterator[Any]:
        yield SimpleNamespace(cell=self)

    @asynccontextmanager
    async def _device_session(self, _: Any) -> AsyncIterator[ScriptedBus]:
        yield self.device

    @asynccontextmanager
    async def _holding(self) -> AsyncIterator[None]:
        yield

    async def _health(self) -> Any:
        return SimpleNamespace(dropped=dict(self.dropped))

    def _told(self, key: str, kind: type, handler: Callable[[Any], None]) -> Callable[[], Awaitable[None]]:
        """Listen as the cell's client does; send beats and health until the listener is closed."""
        end = self._listen(key, kind, handler)
        if key not in ("daemon/beat", "dev/robot/state"):
            return end
        telling = asyncio.get_running_loop().create_task(self._tell(key))

        async def ended() -> None:
            telling.cancel()
            await end()

        return ended

    async def _tell(self, key: str) -> None:
        while True:
            health = DeviceHealth(device="robot", connected=True, dropped={"implausible_beats": self.implausible})
            self.client.tell(key, BEAT if key == "daemon/beat" else health)
            await asyncio.sleep(0.1)

    def _dropped(self, key: str, message: Any) -> None:
        self.foreign(key, message)
        if self.believes:
            self._published(key, message)
        else:
            self.dropped["bus.not_sealed"] += 1

    def _published_by_device(self, key: str, message: Any) -> None:
        if key.startswith("dev/"):
            self._published(key, message)

    def _published(self, key: str, message: Any) -> None:
        self.own(key, message)
        self.implausible += isinstance(message, Beat) and message.sent == FAR_AHEAD
        if not isinstance(message, DeviceEvent):
            return
        if message == FORGED_EVENT:
            self.client.lose()
        elif key == f"dev/{message.device}/event" or self.believes:
            self.client.rows.append(row("device", operation=message.code, source=message.device))
        else:
            self.dropped["events.misnamed"] += 1


@pytest.fixture
def cell(monkeypatch: pytest.MonkeyPatch) -> Guarded:
    return Guarded(monkeypatch)


def ran(monkeypatch: pytest.MonkeyPatch, folder: Path, cell: Guarded, injection: Injector) -> Evidence:
    return run(monkeypatch, injection(lab_of(folder, cell)))


def test_valid_requests_without_the_key_are_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: Guarded
) -> None:
    found = ran(monkeypatch, tmp_path, cell, impersonation.requests_past_the_daemon)
    assert proves(found)
    assert set(found.took_place["answered_by_the_nodes"].values()) == {"not_sealed"}
    assert len(found.took_place["answered_by_the_nodes"]) == 6
    assert found.control["moved_by_the_same_requests_with_the_key_rad"] > 0.0
    assert found.details["with_the_key"] == dict.fromkeys(("joints", "release_latch", "follow"), "served")
    cell.client.restless = False
    cell.answer = DeviceError("It is refused.", reason="not_sealed")
    assert ran(monkeypatch, tmp_path, cell, impersonation.requests_past_the_daemon).took_place == found.took_place


def test_a_request_that_is_served_is_unmet(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: Guarded) -> None:
    cell.answer = DeviceReply(result=JOINTS)
    with pytest.raises(Unmet, match=r"'robot\.joints': 'served'"):
        ran(monkeypatch, tmp_path, cell, impersonation.requests_past_the_daemon)
    cell.answer = REFUSAL
    cell.bus.answers["dev/robot/cmd"] = REFUSAL
    with pytest.raises(Unmet, match="With the key, too, the arm has not moved"):
        ran(monkeypatch, tmp_path, cell, impersonation.requests_past_the_daemon)


def test_requests_that_were_not_sent_are_found_out(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: Guarded
) -> None:
    with sham(), pytest.raises(Unmet, match=r"were answered: \{\}"):
        ran(monkeypatch, tmp_path, cell, impersonation.requests_past_the_daemon)


def test_requests_name_the_present_sessions_and_epochs() -> None:
    for device, request in impersonation._valid_requests(GATES, [0.0]):
        if request.method != "joints":
            token, gate = request.token, GATES[device]
            assert token is not None
            assert (token.daemon, token.node, token.epoch) == (gate.daemon, gate.node, gate.epoch)


async def test_gates_are_read_from_the_heartbeats_of_the_nodes() -> None:
    bus = ScriptedBus()
    reading = asyncio.create_task(impersonation._gates(cast(Bus, bus)))
    while not bus.handlers:  # noqa: ASYNC110  # the task subscribes in its first turn
        await asyncio.sleep(0)
    for device, gate in GATES.items():
        bus.handlers["dev/*/beat"](f"dev/{device}/beat", NodeBeat(number=1, sent=0.0, gate=gate))
        bus.handlers["dev/*/beat"]("dev/tracker/beat", NodeBeat(number=1, sent=0.0))
    assert await reading == GATES


def test_messages_in_a_devices_name_are_dropped(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: Guarded) -> None:
    found = ran(monkeypatch, tmp_path, cell, impersonation.messages_in_a_devices_name)
    assert proves(found)
    assert found.took_place == {"counted": 5 * FORGED, "counted_of_repeated_ones": FORGED}
    assert found.control == {"motion": "accepted", "the_event_with_the_key_latches": True}


def test_messages_that_are_believed_are_unmet(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: Guarded) -> None:
    cell.believes = True
    with pytest.raises(Unmet, match="Of the forged messages the daemon counted 0"):
        ran(monkeypatch, tmp_path, cell, impersonation.messages_in_a_devices_name)


def test_repeated_messages_that_count_again_are_unmet(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: Guarded
) -> None:
    cell.repeats = 0
    with pytest.raises(Unmet, match="Of the forged messages the daemon counted 0"):
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


def test_an_implausible_heartbeat_is_counted_and_moves_on(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: Guarded
) -> None:
    found = ran(monkeypatch, tmp_path, cell, impersonation.implausible_heartbeat)
    assert proves(found)
    assert found.took_place == {"implausible_at_the_node": impersonation.IMPLAUSIBLE}
    assert found.control["motion"] == "accepted"


def test_a_heartbeat_that_reaches_the_node_is_unmet(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: Guarded
) -> None:
    monkeypatch.setattr(cell.device, "publish", cell.bus.publish)
    with pytest.raises(Unmet, match="with a device's certificate has reached the node"):
        ran(monkeypatch, tmp_path, cell, impersonation.implausible_heartbeat)


def test_an_implausible_heartbeat_that_was_not_put_is_found_out(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: Guarded
) -> None:
    with sham(), pytest.raises(Unmet, match="has counted no implausible heartbeat"):
        ran(monkeypatch, tmp_path, cell, impersonation.implausible_heartbeat)
