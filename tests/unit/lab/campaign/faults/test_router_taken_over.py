"""The row of a router that was taken over: what it says in the name of people is refused, and their own is not."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pcmrs.bus.codec import pack
from pcmrs.bus.stop import Stopping
from pcmrs.messages import Reason
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.fault import Evidence
from pcmrs_lab.campaign.faults import router_taken_over
from pcmrs_lab.campaign.reachable import CARRIED
from pcmrs_lab.campaign.sham import sham
from tests.unit.lab.campaign.faults.operated import OperatedCell, lab_of, proves, run
from tests.unit.lab.scripted_client import verdict

TAKE_OVER, ACQUIRE, REINIT, STOP = ("lease/take_over", "lease/acquire", "registration/reinit", f"stop/{CARRIED}")


class Thief:
    """A session of the router, and a daemon that checks signatures as it should; a test changes one answer.

    Attributes:
        lets_pass: Reason for which the daemon does not refuse.
    """

    def __init__(self) -> None:
        self.lets_pass = ""
        self.source = f"bus:{CARRIED}"
        self.answers = 1
        self.seen: set[tuple[str, bytes]] = set()
        self.ignored = 0
        self.carried: Any = None

    def _why(self, key: str, payload: bytes, signature: bytes | None) -> str:
        if signature is None:
            return "unsigned"
        signer, _, signed = signature.partition(b" ")
        if signer != CARRIED.encode():
            return "certificate"
        if signed != f"{key} ".encode() + payload:
            return "forged"
        return "repeated" if (key, payload) in self.seen else ""

    def put(self, key: str, payload: bytes, *, attachment: bytes | None) -> None:
        why = self._why(key, payload, attachment)
        if not why:
            self.seen.add((key, payload))
        else:
            self.ignored += 1

    def get(self, key: str, *, payload: bytes, attachment: bytes | None, timeout: float) -> list[Any]:
        name = key.rpartition(f"/{CARRIED}/")[2]
        if key.endswith(STOP):
            message: Any = Stopping(source=self.source, number=1)
        else:
            why = self._why(key, payload, attachment)
            if why == "" or why == self.lets_pass:
                self.seen.add((key, payload))
                message = verdict(name.replace("/", "."))
            else:
                reason = Reason(code="not_signed", text="It is not signed.", fields={"why": why})
                message = verdict(name.replace("/", "."), "rejected", reason=reason)
        answer = SimpleNamespace(result=SimpleNamespace(payload=SimpleNamespace(to_bytes=lambda: pack(message))))
        return [answer] * self.answers


class Carried:
    """A counted session of the router; the daemon drops all its messages in the name of others.

    Attributes:
        sent: Keys, in order, and whether somebody has signed.
        answers: What a signed command of another user is answered with.
    """

    def __init__(self) -> None:
        self.sent: list[tuple[str, bool]] = []
        self.answers: list[bytes] = []

    async def put(self, key: str, _: bytes) -> None:
        self.sent.append((key, False))

    async def ask(self, key: str, _: bytes, attachment: bytes | None = None) -> list[bytes]:
        self.sent.append((key, attachment is not None))
        return self.answers if attachment is not None else []

    async def wait_until_arrived(self) -> int:
        return len(self.sent)


@pytest.fixture
def thief(monkeypatch: pytest.MonkeyPatch) -> Thief:
    made = Thief()

    class Signer:
        def __init__(self, who: str) -> None:
            self._who = who

        def sign(self, _: str, key: str, payload: bytes) -> bytes:
            return f"{self._who} {key} ".encode() + payload

    cell, carried = OperatedCell(), Carried()

    async def health() -> Any:
        return SimpleNamespace(dropped={"bus.ignored": made.ignored})

    monkeypatch.setattr(cell.client, "health", health)
    people = SimpleNamespace(credentials=lambda name: name)
    open_cell = SimpleNamespace(cell=cell, people=people, settings=lambda name: name)

    @asynccontextmanager
    async def reachable(_: Any) -> AsyncIterator[Any]:
        yield open_cell

    @asynccontextmanager
    async def unmoved(_: Any) -> AsyncIterator[None]:
        yield

    @asynccontextmanager
    async def counted(*_: Any) -> AsyncIterator[Carried]:
        yield carried

    made.carried = carried
    monkeypatch.setattr(router_taken_over, "counted_session", counted)
    monkeypatch.setattr(router_taken_over, "reachable_cell", reachable)
    monkeypatch.setattr(router_taken_over, "unmoved", unmoved)
    monkeypatch.setattr(router_taken_over, "open_session", lambda _: nullcontext(made))
    monkeypatch.setattr(router_taken_over, "CertificateSigner", SimpleNamespace(read=lambda who, _clock: Signer(who)))
    return made


def ran(monkeypatch: pytest.MonkeyPatch, folder: Path) -> Evidence:
    return run(monkeypatch, router_taken_over.taken_over_router(lab_of(folder, OperatedCell())))


def test_forged_commands_are_refused_and_own_ones_accepted(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, thief: Thief
) -> None:
    found = ran(monkeypatch, tmp_path)
    assert proves(found)
    assert set(found.took_place["answered_by_the_daemon"].values()) == {"unsigned", "certificate", "repeated", "forged"}
    assert found.control == {"signed_by_the_person": "accepted"}
    assert thief.seen


@pytest.mark.parametrize(
    ("lets_pass", "key"),
    [("unsigned", TAKE_OVER), ("certificate", TAKE_OVER), ("repeated", ACQUIRE), ("forged", REINIT)],
)
def test_a_command_that_is_believed_is_unmet(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, thief: Thief, lets_pass: str, key: str
) -> None:
    thief.lets_pass = lets_pass
    with pytest.raises(Unmet, match=f"{key} was accepted"):
        ran(monkeypatch, tmp_path)


def test_stop_is_honoured_for_the_person(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, thief: Thief) -> None:
    thief.source = "bus:gate"
    with pytest.raises(Unmet, match="Stop was not honoured"):
        ran(monkeypatch, tmp_path)


def test_every_command_has_one_answer(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, thief: Thief) -> None:
    thief.answers = 2
    with pytest.raises(Unmet, match="had 2 answers"):
        ran(monkeypatch, tmp_path)


def test_what_was_not_sent_is_found_out(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, thief: Thief) -> None:
    with sham(), pytest.raises(Unmet, match="Of 1 forged set points the daemon has ignored 0"):
        ran(monkeypatch, tmp_path)


def test_router_speaks_for_nobody_whom_it_does_not_carry(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, thief: Thief
) -> None:
    found = ran(monkeypatch, tmp_path)
    assert found.took_place["bytes_in_the_name_of_others_at_the_daemon"] == len(thief.carried.sent)
    keys = {key.split("/", 3)[3] for key, _ in thief.carried.sent}
    assert {f"cmd/{name}/lease/take_over" for name in ("local", "anna", "ray", "zoe")} <= keys
    assert {"stop/anna", "teleop/local", "dev/robot/cmd", "state/fsm", "svc/setup/anna"} <= keys
    assert sum(signed for _, signed in thief.carried.sent) == 2
    thief.carried.answers = [b"yes"]
    with pytest.raises(Unmet, match="A command that ray has signed was answered"):
        ran(monkeypatch, tmp_path)


def test_only_the_genuine_set_point_counts_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, thief: Thief) -> None:
    assert ran(monkeypatch, tmp_path).took_place["set_points_ignored_by_the_daemon"] == 3
    assert thief.ignored == 3
    monkeypatch.setattr(thief, "put", lambda *_, **__: None)
    with pytest.raises(Unmet, match="Of 1 forged set points the daemon has ignored 0"):
        ran(monkeypatch, tmp_path)
