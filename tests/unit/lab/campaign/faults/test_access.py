"""Rows of access: who is refused is not answered, nothing has changed, and what arrived was counted by a receiver."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pcmrs.bus import BusSettings
from pcmrs.bus.codec import pack
from pcmrs.errors import BusError, ConfigurationError
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.fault import Evidence, Injector
from pcmrs_lab.campaign.faults import access
from pcmrs_lab.campaign.faults.access import AT_ONCE
from pcmrs_lab.campaign.sham import sham
from tests.unit.lab.campaign.faults.operated import Operated, OperatedCell, lab_of, proves, run
from tests.unit.lab.campaign.faults.scripted_raw import ScriptedRaw
from tests.unit.lab.campaign.scripted_cell import ScriptedLab
from tests.unit.lab.scripted_client import row, verdict

CONTROL = b"control"


class Reachable:
    """A cell that others reach: each of them with a client of their own, and one of them may hold it."""

    def __init__(self, cell: OperatedCell) -> None:
        self.cell = cell
        self.holder = ""
        self.endpoint = "tls/127.0.0.1:1"
        self.peer_key = Path("panel.key")

    @asynccontextmanager
    async def client(self, name: str) -> AsyncIterator[Person]:
        yield Person(self, name)

    def settings(self, name: str) -> BusSettings:
        return BusSettings(endpoint=self.endpoint, cell=name)


class Person(Operated):
    """A client of one person; all of them see the same cell."""

    def __init__(self, cell: Reachable, name: str) -> None:
        super().__init__()
        self._reachable, self._name = cell, name
        self.deaf = False

    @asynccontextmanager
    async def holding(self) -> AsyncIterator[None]:
        self._reachable.holder = self._name
        try:
            yield
        finally:
            self._reachable.holder = ""

    async def call(self, name: str, arguments: Any = None, **more: Any) -> Any:
        holder, shared = self._reachable.holder, self._reachable.cell.client
        code = "" if holder == self._name else "lease_held" if holder else "no_lease"
        shared.refuses[name] = code
        decided = await shared.call(name, arguments, **more)
        if code:
            shared.rows.append(row(verdict=decided, source=f"bus:{self._name}"))
        return decided

    async def stop(self, timeout: float = 0.0) -> None:
        if not self.deaf:
            self._reachable.cell.client.latched = True

    async def state(self, timeout: float = 0.0) -> Any:
        return await self._reachable.cell.client.state()


@pytest.fixture
def reachable(monkeypatch: pytest.MonkeyPatch) -> Reachable:
    made = Reachable(OperatedCell())

    @asynccontextmanager
    async def opened(*_: Any) -> AsyncIterator[Reachable]:
        yield made

    monkeypatch.setattr(access, "reachable_cell", opened)
    return made


def ran(monkeypatch: pytest.MonkeyPatch, folder: Path, row_of: Injector) -> Evidence:
    return run(monkeypatch, row_of(lab_of(folder, OperatedCell())))


def test_who_does_not_hold_the_cell_may_only_stop_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, reachable: Reachable
) -> None:
    found = ran(monkeypatch, tmp_path, access.two_operators)
    assert proves(found)
    assert found.took_place == {"rejected_in_the_journal": 3}
    assert found.details["held"].startswith("lease_held")


@pytest.mark.usefixtures("reachable")
def test_a_cell_that_obeys_everybody_is_unmet(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with sham(), pytest.raises(Unmet, match="must be rejected: lease_held"):
        ran(monkeypatch, tmp_path, access.two_operators)
    monkeypatch.setattr(Person, "stop", _nothing)
    with pytest.raises(Unmet, match="Stop was not honoured"):
        ran(monkeypatch, tmp_path, access.two_operators)


async def _nothing(_: Any, timeout: float = 0.0) -> None:
    pass


@pytest.fixture
def raw(monkeypatch: pytest.MonkeyPatch, reachable: Reachable) -> ScriptedRaw:
    made = ScriptedRaw(reachable.cell)

    def take(datagram: bytes) -> bytes:
        made.refuse()
        return b""

    async def send(_: Any, *commands: bytes) -> str:
        return commands[-1].decode() + "_accepted_"

    made.takes = take
    monkeypatch.setattr(access, "raw_socket", made.open)
    monkeypatch.setattr(access, "send_accepted", send)
    return made


def ignored(monkeypatch: pytest.MonkeyPatch, reachable: Reachable, number: int) -> Evidence:
    return run(
        monkeypatch,
        access._check_ignored(reachable, [b"forged"] * number, control=CONTROL),  # type: ignore[arg-type]
    )


def test_forged_datagrams_are_refused_and_not_answered(
    monkeypatch: pytest.MonkeyPatch, reachable: Reachable, raw: ScriptedRaw
) -> None:
    found = ignored(monkeypatch, reachable, 2 * AT_ONCE + 3)
    assert proves(found)
    assert found.took_place == {"refused_in_the_journal": 2 * AT_ONCE + 3}
    assert found.control == {"signed_by_the_peer": "control_accepted_"}
    assert found.details == {"sent": 2 * AT_ONCE + 3, "reasons": ["bad_signature"]}
    assert len(raw.sent) == 2 * AT_ONCE + 3


def test_a_datagram_that_is_answered_or_has_an_effect_is_unmet(
    monkeypatch: pytest.MonkeyPatch, reachable: Reachable, raw: ScriptedRaw
) -> None:
    refuse = raw.takes

    def answer(datagram: bytes) -> bytes:
        refuse(datagram)
        return b"1_rejected"

    def change(datagram: bytes) -> bytes:
        reachable.cell.client.branches["robot"] = "0"
        return refuse(datagram)

    raw.takes = answer
    with pytest.raises(Unmet, match="3 datagrams were answered"):
        ignored(monkeypatch, reachable, 3)
    raw.answers = asyncio.Queue()
    raw.takes = change
    with pytest.raises(Unmet, match="The state has changed"):
        ignored(monkeypatch, reachable, 3)


@pytest.mark.usefixtures("raw")
def test_datagrams_that_were_not_sent_are_found_out(monkeypatch: pytest.MonkeyPatch, reachable: Reachable) -> None:
    with sham(), pytest.raises(Unmet, match="The journal does not have 3 refusals"):
        ignored(monkeypatch, reachable, 3)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda cell: cell.client.branches.update(robot="0"), "The state has changed"),
        (lambda cell: cell.client.rows.append(row("intent")), "1 commands reached the dispatcher"),
        (lambda cell: cell.client.rows.append(row("device", operation="refused")), ""),
    ],
)
def test_a_cell_must_be_unmoved(
    monkeypatch: pytest.MonkeyPatch, reachable: Reachable, change: Callable[[OperatedCell], None], text: str
) -> None:
    async def attack() -> None:
        async with access.unmoved(reachable):  # type: ignore[arg-type]
            change(reachable.cell)

    if text:
        with pytest.raises(Unmet, match=text):
            run(monkeypatch, attack())
    else:
        run(monkeypatch, attack())


async def test_a_session_is_opened_or_not(monkeypatch: pytest.MonkeyPatch) -> None:
    closed: list[bool] = []

    def opened(settings: BusSettings) -> Any:
        if settings.cell == "old":
            raise BusError("Not admitted.")
        return SimpleNamespace(close=lambda: closed.append(True))

    monkeypatch.setattr(access, "open_session", opened)
    assert await access._is_admitted(BusSettings(cell="anna"))
    assert closed == [True]
    assert not await access._is_admitted(BusSettings(cell="old"))


def test_the_reason_of_a_refusal_is_its_text(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def read(folder: Path, now: float) -> Any:
        if now > 10.0:
            raise ConfigurationError("anna.pem has expired on Monday.")
        return "credentials"

    monkeypatch.setattr(access, "read_credentials", read)
    assert access._refusal_text(tmp_path, 5.0) == "nothing"
    assert access._refusal_text(tmp_path, 15.0) == "anna.pem has expired on Monday."


class Session:
    """A session of an attacker; answers are those of a test."""

    def __init__(self, answers: list[bytes]) -> None:
        self.answers = answers
        self.put_to: list[str] = []

    async def put(self, key: str, _: bytes) -> None:
        self.put_to.append(key)

    async def ask(self, key: str, _: bytes) -> list[bytes]:
        return self.answers


async def test_no_forbidden_message_is_answered(reachable: Reachable) -> None:
    session = Session([])
    await access.send_forbidden(reachable, session, "anna")  # type: ignore[arg-type]
    assert f"pcmrs/lab/{reachable.cell.name}/cmd/anna/lease/take_over" in session.put_to
    assert f"pcmrs/lab/{reachable.cell.name}/dev/robot/cmd" in session.put_to
    with pytest.raises(Unmet, match="cmd/anna/robot/connect was answered"):
        await access.send_forbidden(reachable, Session([b"yes"]), "anna")  # type: ignore[arg-type]


async def test_under_another_name_stop_and_set_points_are_sent_too(reachable: Reachable) -> None:
    """Under their own name viewers may press Stop."""
    own, other = Session([]), Session([])
    await access.send_forbidden(reachable, own, "eve", is_own=True)  # type: ignore[arg-type]
    await access.send_forbidden(reachable, other, "anna")  # type: ignore[arg-type]
    prefix = f"pcmrs/lab/{reachable.cell.name}"
    assert not any(key.startswith((f"{prefix}/stop", f"{prefix}/svc", f"{prefix}/teleop")) for key in own.put_to)
    assert {f"{prefix}/{key}/anna" for key in ("stop", "teleop", "svc/setup", "svc/check")} <= set(other.put_to)


@pytest.mark.parametrize(
    ("answers", "text"),
    [
        ([verdict("robot.connect")], ""),
        ([], "had 0 answers"),
        ([verdict("robot.connect", "rejected", "busy")], "by a permitted user was rejected: busy"),
    ],
)
async def test_the_control_is_accepted(
    monkeypatch: pytest.MonkeyPatch, reachable: Reachable, answers: list[Any], text: str
) -> None:
    replies = [
        SimpleNamespace(ok=SimpleNamespace(payload=SimpleNamespace(to_bytes=lambda each=each: pack(each))))
        for each in answers
    ]
    session = SimpleNamespace(get=lambda *_, **__: [*replies, SimpleNamespace(ok=None)])
    monkeypatch.setattr(access, "open_session", lambda _: nullcontext(session))
    work = access._accepted_from(reachable, "anna")  # type: ignore[arg-type]
    if text:
        with pytest.raises(Unmet, match=text):
            await work
    else:
        assert await work == "accepted"


class Keys(ScriptedLab):
    """A lab whose daemons refuse keys that others may read."""

    def __init__(self, folder: Path, key_mode: int = 0o644) -> None:
        cell = OperatedCell(folder / "cell1")
        super().__init__(folder, cell)
        (folder / "cell1").mkdir()
        self.keys = [folder / "daemon1" / "daemon1.key", folder / "panel.key", folder / "cell1" / "journal.key"]
        for key in self.keys:
            key.parent.mkdir(exist_ok=True)
            key.write_text("secret")
            key.chmod(0o600)
        self.status, self.text = 4, "{} may be read by others (0644)."

    async def start_refused(self, *overrides: str, folder: Path | None = None) -> tuple[int, str]:
        wrong = next((key for key in self.keys if key.stat().st_mode & 0o077), None)
        return (0, "") if wrong is None else (self.status, self.text.format(wrong))


@pytest.fixture
def keys(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Keys:
    made = Keys(tmp_path)
    open_cell = SimpleNamespace(cell=made.cells[0], people=SimpleNamespace(folder=tmp_path), peer_key=made.keys[1])

    @asynccontextmanager
    async def opened(*_: Any) -> AsyncIterator[Any]:
        yield open_cell

    monkeypatch.setattr(access, "reachable_cell", opened)
    return made


def test_a_key_that_others_may_read_is_named(monkeypatch: pytest.MonkeyPatch, keys: Keys) -> None:
    found = run(monkeypatch, access.readable_key(keys.as_lab))
    assert proves(found)
    assert found.took_place == {"modes": dict.fromkeys(("daemon1.key", "panel.key", "journal.key"), "0644")}
    assert all(key.stat().st_mode & 0o777 == 0o600 for key in keys.keys), "they are as before"


def test_a_daemon_that_starts_with_it_is_unmet(monkeypatch: pytest.MonkeyPatch, keys: Keys) -> None:
    with sham(), pytest.raises(Unmet, match="Exit status 0"):
        run(monkeypatch, access.readable_key(keys.as_lab))
    keys.text = "A key may be read by others (0644)."
    with pytest.raises(Unmet, match="Exit status 4: A key may be read"):
        run(monkeypatch, access.readable_key(keys.as_lab))
