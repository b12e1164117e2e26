"""The daemon takes from who may come through a router what they have signed themselves, once, and nothing else."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from itertools import count, product
from pathlib import Path
from typing import cast

import msgspec
import pytest
import zenoh
from cryptography.hazmat.primitives.asymmetric.ec import SECP384R1, generate_private_key
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from msgspec.structs import replace

from pcmrs.bus import Bus, BusSettings, CommandEdge, Empty
from pcmrs.bus._session import _signing
from pcmrs.bus.codec import pack
from pcmrs.bus.commands import Envelope
from pcmrs.bus.settings import open_session
from pcmrs.bus.signature import FRESH_FOR, CertificateSigner, Kind, SignatureVerifier
from pcmrs.client import Client
from pcmrs.clock import SystemClock
from pcmrs.errors import ConfigurationError, UnknownOutcomeError
from pcmrs.messages import Command, LeaseState, Snapshot, TeleopSetpoint, Verdict
from pcmrs.messages.identity import EVERY_CELL
from pcmrs.pki import Authority, read_credentials, read_register
from pcmrs.router import router_settings
from pcmrs.testing.daemon import free_port
from tests.unit.bus.bus_cells import TIMEOUT, accepted, open_bus, snapshot

KEY, PAYLOAD = "pcmrs/lab/c1/cmd/tom/robot/connect", b"{}"


class SetClock(SystemClock):
    """A clock that stands where a test has set it."""

    def __init__(self) -> None:
        super().__init__()
        self.now = time.time()

    def wall(self) -> float:
        return self.now


@dataclass
class Lab:
    """An authority with a router, a cell, and tom, who may come through the router; eve may not."""

    folder: Path
    authority: Authority

    @classmethod
    def made(cls, folder: Path) -> Lab:
        now = SystemClock().wall()
        lab = cls(folder, Authority.init(folder / "pki", "lab", now))
        lab.authority.issue("router", "gate", now, hosts=("127.0.0.1",), cells=EVERY_CELL, into=folder)
        lab.authority.issue("daemon", "c1", now, hosts=("127.0.0.1",), cells=EVERY_CELL, into=folder)
        lab.authority.issue("operator", "eve", now, cells=EVERY_CELL, into=folder)
        lab.issue()
        return lab

    @property
    def register(self) -> Path:
        return self.authority.folder / "register.json"

    def issue(self) -> None:
        """Issue a newer certificate to tom."""
        self.authority.issue("operator", "tom", SystemClock().wall(), via=("gate",), cells=EVERY_CELL, into=self.folder)

    def joined(self, name: str, endpoint: str) -> BusSettings:
        return BusSettings(endpoint=endpoint, cell="c1", credentials=read_credentials(self.folder / name, time.time()))

    def daemon(self, routers: tuple[str, ...] = ()) -> BusSettings:
        settings = self.joined("c1", f"tcp/127.0.0.1:{free_port()}")
        return replace(settings, mode="router", routers=routers, members=tuple(read_register(self.register)))

    def signer(self, name: str, clock: SystemClock) -> CertificateSigner:
        return CertificateSigner.read(read_credentials(self.folder / name, time.time()), clock)


@dataclass
class Bench:
    """A signer of tom's and the check of a daemon, on one clock."""

    lab: Lab
    clock: SetClock = field(default_factory=SetClock)

    def __post_init__(self) -> None:
        self.signer = self.lab.signer("tom", self.clock)
        self.signatures = SignatureVerifier(self.lab.daemon(), self.clock)
        self.clock.now += 0.001

    def sign(self, ahead: float = 0.0) -> bytes:
        self.clock.now += ahead
        signature = self.signer.sign("put", KEY, PAYLOAD)
        self.clock.now -= ahead
        return signature

    def why(
        self, signature: bytes, kind: Kind = "put", user: str = "tom", key: str = KEY, payload: bytes = PAYLOAD
    ) -> str:
        """Why a message is not taken; nothing where it is."""
        error = self.signatures.objection(signature, kind, user, key, payload)
        return "" if error is None else str(error.fields["why"])


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    return Lab.made(tmp_path_factory.mktemp("lab"))


@pytest.fixture
def bench(lab: Lab) -> Bench:
    return Bench(lab)


@pytest.mark.filterwarnings("ignore:Parsed a serial number")
def test_signed_message_is_taken_once_and_never_if_a_bit_differs(bench: Bench) -> None:
    signature = bench.sign()
    for known in (False, True):  # the certificate is verified once
        for bit in range(len(signature) * 8):
            changed = bytearray(signature)
            changed[bit // 8] ^= 1 << bit % 8
            assert bench.why(bytes(changed)) in ("forged", "certificate", "old", "ahead")
        assert bench.why(signature) == ("repeated" if known else "")


def test_signature_holds_only_for_the_signed_message(bench: Bench) -> None:
    signature = bench.sign()
    assert bench.why(signature, payload=PAYLOAD + b" ") == "forged"
    assert bench.why(signature, key=KEY.replace("connect", "disconnect")) == "forged"
    assert bench.why(signature, key=KEY.replace("c1", "c2")) == "forged"
    assert bench.why(signature, kind="query") == "forged"
    assert bench.why(b"") == "unsigned"
    for length in range(1, len(signature)):
        assert bench.why(signature[:length]) in ("forged", "certificate")
    assert bench.why(signature) == ""


def test_only_the_newest_certificate_in_the_register_counts(bench: Bench, tmp_path: Path) -> None:
    assert bench.why(bench.lab.signer("eve", bench.clock).sign("put", KEY, PAYLOAD)) == "certificate"
    other = Lab.made(tmp_path / "foreign")
    assert bench.why(other.signer("tom", bench.clock).sign("put", KEY, PAYLOAD)) == "certificate"
    other.issue()
    newer = Bench(other)
    old, newer.signer = newer.signer, Bench(other).signer
    assert newer.why(newer.sign()) == ""
    other.issue()
    assert Bench(other).why(old.sign("put", KEY, PAYLOAD)) == "certificate"


@pytest.mark.parametrize("days", [31.0, -1.0])
def test_certificate_outside_its_validity_is_refused(bench: Bench, days: float) -> None:
    """The register may name a longer time."""
    settings = bench.lab.daemon()
    always = tuple(replace(each, begins=0.0, ends=2.0 * time.time()) for each in settings.members)
    bench.clock.now += days * 86400.0
    bench.signatures = SignatureVerifier(replace(settings, members=always), bench.clock)
    bench.clock.now += 0.001
    assert bench.why(bench.sign()) == "certificate"


def test_fresh_message_is_taken_and_clock_difference_is_named(bench: Bench) -> None:
    assert bench.why(bench.sign(ahead=FRESH_FOR - 0.01)) == ""
    assert bench.why(bench.sign(ahead=FRESH_FOR + 0.01)) == "ahead"
    in_time, late = bench.sign(), bench.sign()
    bench.clock.now += FRESH_FOR - 0.01
    assert bench.why(in_time) == ""
    bench.clock.now += 0.02
    error = bench.signatures.objection(late, "put", "tom", KEY, PAYLOAD)
    assert error is not None
    assert (error.code, error.fields["why"]) == ("access_denied", "old")
    assert "'tom' is 2.0 s old, the limit is 2 s" in error.text
    assert "Set both clocks" in error.text


def test_message_sent_before_the_daemon_started_is_refused(bench: Bench) -> None:
    signature = bench.sign()
    bench.clock.now += 0.01
    bench.signatures = SignatureVerifier(bench.lab.daemon(), bench.clock)
    assert bench.why(signature) == "repeated"
    assert bench.why(bench.sign()) == "repeated", "in the moment of the start nobody can say which came first"
    bench.clock.now += 0.01
    assert bench.why(bench.sign()) == ""


def test_memory_is_bounded_and_forgotten_messages_are_refused(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pcmrs.bus.signature.REMEMBERED", 16)
    sent = [bench.sign() for _ in range(40)]
    for signature in sent[20:]:
        assert bench.why(signature) == ""
    assert {bench.why(signature) for signature in sent} == {"repeated"}
    assert len(bench.signatures._members["tom"]._taken) == 16


def test_messages_overtake_each_other(bench: Bench) -> None:
    sent = [bench.sign() for _ in range(8)]
    for signature in reversed(sent):
        assert bench.why(signature) == ""


def test_nobody_else_needs_a_signature(bench: Bench) -> None:
    assert bench.why(b"", user="local") == ""
    assert bench.why(b"", user="eve") == ""
    assert bench.why(b"", user="nobody") == "unknown"


def test_certificate_holder_signs_and_daemon_with_members_checks(lab: Lab) -> None:
    """A daemon checks signatures only with a register of members."""
    far, near, register = "tls/127.0.0.1:1", "tcp/127.0.0.1:1", tuple(read_register(lab.register))
    for name, endpoint, members, signs, checks in (
        ("tom", far, (), True, False),
        ("tom", near, (), False, False),
        ("c1", near, register, False, True),
        ("c1", near, (), False, False),
    ):
        signer, signatures = _signing(replace(lab.joined(name, endpoint), members=members))
        assert (signer is not None, signatures is not None) == (signs, checks), (name, endpoint, members)
        assert _signing(BusSettings(endpoint=endpoint, cell="c1", members=members)) == (None, None)


def test_a_key_that_cannot_be_read_signs_nothing(lab: Lab, tmp_path: Path) -> None:
    own = read_credentials(lab.folder / "tom", time.time())
    with pytest.raises(ConfigurationError, match="cannot be read"):
        CertificateSigner.read(replace(own, key=str(tmp_path / "none.key")), SystemClock())
    other = tmp_path / "other.key"
    other.touch(mode=0o600)
    for key in (Ed25519PrivateKey.generate(), generate_private_key(SECP384R1())):
        other.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
        with pytest.raises(ConfigurationError, match="not a key on P-256"):
            CertificateSigner.read(replace(own, key=str(other)), SystemClock())


@dataclass
class Cell:
    """A daemon's edge, a router in the middle, and somebody who has taken over that router and dials the daemon.

    Attributes:
        daemon: Its bus.
        router: What passes through it, as the router reads it.
        thief: A session with the router's certificate.
    """

    lab: Lab
    daemon: Bus
    router: zenoh.Session
    thief: zenoh.Session
    endpoint: str
    submitted: list[Command] = field(default_factory=list)
    refused: list[tuple[str, str]] = field(default_factory=list)
    stops: list[str] = field(default_factory=list)
    answering: asyncio.Event = field(default_factory=asyncio.Event)
    steered: asyncio.Queue[TeleopSetpoint] = field(default_factory=asyncio.Queue)

    async def submit(self, command: Command, *, arrived: float | None) -> Verdict:
        self.submitted.append(command)
        await self.answering.wait()
        return accepted(command)

    def stop(self, source: str, presses: int) -> int:
        self.stops.append(source)
        return len(self.stops)

    def absolute(self, key: str) -> str:
        return f"{self.daemon.prefix}/{key}"

    def query(self, session: zenoh.Session, key: str, payload: bytes, signature: bytes | None = None) -> bytes:
        (reply,) = session.get(self.absolute(key), payload=payload, attachment=signature, timeout=TIMEOUT)
        return bytes(reply.result.payload.to_bytes())

    @asynccontextmanager
    async def client(self, name: str) -> AsyncIterator[Client]:
        own = read_credentials(self.lab.folder / name, time.time())
        async with Client.connect(self.endpoint, "lab", "c1", credentials=own) as client:
            yield client

    async def answer(self, key: str, request: Empty) -> Snapshot:
        return replace(snapshot(1), lease=LeaseState(holder="tom"))

    def hold_back(self, monkeypatch: pytest.MonkeyPatch, late: float = FRESH_FOR + TIMEOUT) -> None:
        """Let the daemon find what comes from now on so old, s."""
        clock = SetClock()
        clock.now += late
        monkeypatch.setattr(self.daemon._verifier, "_clock", clock if late else SystemClock())

    async def counted(self, at_least: int) -> None:
        async with asyncio.timeout(TIMEOUT):
            while self.daemon.counters()["bus.ignored"] < at_least:  # noqa: ASYNC110  counted in another thread
                await asyncio.sleep(0.01)


@asynccontextmanager
async def opened(lab: Lab) -> AsyncIterator[Cell]:
    middle, direct = (f"tls/127.0.0.1:{free_port()}" for _ in range(2))
    with open_session(router_settings(lab.folder / "gate", lab.register, [middle])) as router:
        async with open_bus(replace(lab.daemon((middle,)), listen=(direct,))) as daemon:
            with await asyncio.to_thread(open_session, lab.joined("gate", direct)) as thief:
                cell = Cell(lab, daemon, router, thief, middle)
                cell.answering.set()
                edge = await CommandEdge.open(
                    daemon, cell.submit, lambda source, code, text: cell.refused.append((source, code)), cell.stop
                )
                daemon.serve("svc/snapshot", Empty, cell.answer, reading=True)
                daemon.subscribe("teleop/*", TeleopSetpoint, lambda _, setpoint: cell.steered.put_nowait(setpoint))
                try:
                    await until_carried(cell)
                    yield cell
                finally:
                    await edge.close()


async def until_carried(cell: Cell) -> None:
    """Until the router carries queries to the daemon: of a wildcard, which commands nothing."""
    key = cell.absolute("cmd/tom/*/x")

    def is_answered(session: zenoh.Session) -> bool:
        return bool(list(session.get(key)))

    async with asyncio.timeout(TIMEOUT):
        for session in (cell.router, cell.thief):
            while not await asyncio.to_thread(is_answered, session):
                pass


def setpoint(sequence: int) -> TeleopSetpoint:
    return TeleopSetpoint(sequence=sequence, sent=0.0, seen=0.0, ttl=1.0, twist=(0.0,) * 6)


async def test_hijacked_router_commands_nothing_and_a_signer_does(lab: Lab) -> None:
    async with opened(lab) as cell, cell.client("tom") as tom:
        forged = await asyncio.to_thread(cell.query, cell.thief, "cmd/tom/robot/connect", PAYLOAD)
        verdict = msgspec.json.decode(forged, type=Verdict)
        assert verdict.decision == "rejected"
        assert verdict.reason is not None
        assert (verdict.reason.code, verdict.reason.fields["why"]) == ("access_denied", "unsigned")
        assert (cell.submitted, cell.refused) == ([], [("bus:tom", "access_denied")])
        assert (await tom.call("robot.connect", id="own")).decision == "accepted"
        assert [(each.id, each.user, each.role) for each in cell.submitted] == [("own", "tom", "operator")]


async def test_overheard_command_is_not_taken_again_or_for_another_one(lab: Lab) -> None:
    overheard: list[zenoh.Sample] = []
    async with opened(lab) as cell, open_bus(lab.joined("tom", cell.endpoint)) as tom:
        cell.router.declare_subscriber(cell.absolute("cmd/**"), overheard.append)
        async with asyncio.timeout(TIMEOUT):
            for number in count():
                tom.publish("cmd/tom/robot/connect", Envelope(id=f"own{number}"))
                await asyncio.sleep(0.02)
                if overheard and cell.submitted:
                    break
        sent = overheard[0]
        assert sent.attachment is not None
        for key, payload in (
            ("cmd/tom/robot/connect", sent.payload.to_bytes()),
            ("cmd/tom/robot/disconnect", sent.payload.to_bytes()),
            ("cmd/tom/robot/connect", pack(Envelope(id="other"))),
        ):
            cell.thief.put(cell.absolute(key), payload, attachment=sent.attachment)
        async with asyncio.timeout(TIMEOUT):
            while len(cell.refused) < 3:  # noqa: ASYNC110  refused as they come
                await asyncio.sleep(0.01)
        assert set(cell.refused) == {("bus:tom", "access_denied")}
        ids = [each.id for each in cell.submitted]
        assert len(ids) == len(set(ids)), "something was taken twice"
        assert {(each.id[:3], each.operation) for each in cell.submitted} == {("own", "connect")}


def wait_blocking(condition: Callable[[], bool]) -> None:
    """Wait while the loop does nothing else, as when it is busy."""
    end = time.monotonic() + TIMEOUT
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.001)


async def test_set_points_are_signed_and_forged_ones_replace_none(lab: Lab) -> None:
    async with opened(lab) as cell, cell.client("tom") as tom:
        before = cell.daemon.counters()["bus.ignored"]
        cell.thief.put(cell.absolute("teleop/tom"), pack(setpoint(666)))
        await cell.counted(before + 1)
        async with asyncio.timeout(TIMEOUT):
            for number in count(1):
                tom.steer(setpoint(number))
                cell.thief.put(cell.absolute("teleop/tom"), pack(setpoint(666)))
                await asyncio.sleep(0.02)
                if not cell.steered.empty():
                    break
        assert cell.steered.get_nowait().sequence < 666
        replaced = cell.daemon.counters()["bus.replaced"]
        tom.steer(setpoint(333))
        wait_blocking(lambda: cell.daemon.counters()["bus.waiting"] >= 1)
        cell.thief.put(cell.absolute("teleop/tom"), pack(setpoint(666)))
        wait_blocking(
            lambda: cell.daemon.counters()["bus.waiting"] >= 2 or cell.daemon.counters()["bus.replaced"] > replaced
        )
        async with asyncio.timeout(TIMEOUT):
            while (await cell.steered.get()).sequence != 333:
                pass


@dataclass(frozen=True)
class Received:
    """A message as Zenoh's thread hands it over."""

    key_expr: str
    payload: zenoh.ZBytes
    attachment: zenoh.ZBytes | None


async def test_busy_loop_gets_newest_signed_set_point_among_forged(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    receivers: list[Callable[[Received], None]] = []
    monkeypatch.setattr("pcmrs.bus._session.declare_subscriber", lambda *given: receivers.append(given[-1]))
    bus = Bus(cast(zenoh.Session, None), bench.lab.daemon(), verifier=bench.signatures)
    taken: list[int] = []
    refused: list[str] = []
    bus.subscribe(
        "teleop/*",
        TeleopSetpoint,
        lambda _, setpoint: taken.append(setpoint.sequence),
        lambda _, error: refused.append(error.code),
    )
    (receive,) = receivers
    key = f"{bus.prefix}/teleop/tom"
    for signed in product((True, False), repeat=4):
        for number, own in enumerate(signed):
            payload = pack(setpoint(number))
            signature = zenoh.ZBytes(bench.signer.sign("put", key, payload)) if own else None
            receive(Received(key, zenoh.ZBytes(payload), signature))
        for _ in range(10):
            await asyncio.sleep(0)
        assert taken == [number for number, own in enumerate(signed) if own][-1:]
        assert set(refused) == ({"access_denied"} if not all(signed) else set())
        taken.clear()
        refused.clear()


async def test_stop_needs_no_signature(lab: Lab) -> None:
    async with opened(lab) as cell, cell.client("tom") as tom:
        for session in (cell.router, cell.thief):
            assert await asyncio.to_thread(cell.query, session, "stop/tom", b"")
        assert cell.stops == ["bus:tom"] * 2
        assert (await tom.stop()).source == "bus:tom"


async def test_late_renewal_does_not_end_the_lease(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pcmrs.client._aio._RENEWAL_PERIOD", 0.02)
    async with opened(lab) as cell, cell.client("tom") as tom, asyncio.timeout(TIMEOUT), tom.holding():
        cell.hold_back(monkeypatch)
        while not cell.refused:  # noqa: ASYNC110  refused as they come
            await asyncio.sleep(0.01)
        cell.hold_back(monkeypatch, 0.0)
        done = len(cell.submitted)
        while len(cell.submitted) < done + 2:  # noqa: ASYNC110  accepted as they come
            await asyncio.sleep(0.01)
        assert cell.submitted[-1].operation == "renew"


async def test_a_command_that_was_long_on_its_way_is_asked_again(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pcmrs.client._aio._RETRY_PERIOD", 0.02)
    async with opened(lab) as cell, cell.client("tom") as tom, asyncio.timeout(TIMEOUT), asyncio.TaskGroup() as group:
        cell.hold_back(monkeypatch)
        calling = group.create_task(tom.call("robot.connect"))
        while not cell.refused:  # noqa: ASYNC110  refused as they come
            await asyncio.sleep(0.01)
        cell.hold_back(monkeypatch, 0.0)
        assert (await calling).decision == "accepted"
        assert len(cell.submitted) == 1


async def test_refusal_after_a_broken_link_leaves_the_outcome_unknown(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The refusal does not say that nothing has happened."""
    monkeypatch.setattr("pcmrs.client._aio._RETRY_PERIOD", 0.02)
    monkeypatch.setattr("pcmrs.client._aio._TTL", 0.2)
    async with opened(lab) as cell, cell.client("tom") as tom, asyncio.timeout(TIMEOUT), asyncio.TaskGroup() as group:
        cell.answering.clear()
        calling = group.create_task(expect_unknown(tom))
        while not cell.submitted:  # noqa: ASYNC110  submitted as they come
            await asyncio.sleep(0.01)
        cell.hold_back(monkeypatch)
        for task in list(cell.daemon._tasks._running):
            task.cancel()
        await calling
        assert cell.refused


async def expect_unknown(client: Client) -> None:
    with pytest.raises(UnknownOutcomeError):
        await client.call("robot.connect")
