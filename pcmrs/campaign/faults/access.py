"""Faults of access: people and programs that reach for what is not theirs, at a cell that is open to other machines."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import msgspec
import zenoh

from pcmrs.bus.settings import BusSettings, open_session
from pcmrs.campaign.checks import check_refused, expect, shape
from pcmrs.campaign.datagrams import raw_socket
from pcmrs.campaign.driving import accept, said
from pcmrs.campaign.fault import Evidence, fault
from pcmrs.campaign.lab import Lab
from pcmrs.campaign.reachable import EXPIRED, FOREIGN, REVOKED, ReachableCell, reachable_cell
from pcmrs.campaign.samples import sample
from pcmrs.client import Client
from pcmrs.clock import SystemClock
from pcmrs.errors import BusError, ConfigurationError
from pcmrs.gateway.keys import read_key
from pcmrs.gateway.signing import Signer
from pcmrs.pki import read_credentials

TLS = "a running cell that listens for other machines, over real TLS on loopback"
SIGNED = "raw datagrams at a running cell with a peer that signs"
FORGED = 200
"""Signed commands that are tampered with, of each kind."""
LARGE = 24 * 1024 * 1024
"""Bytes of a message that is longer than any is allowed to be."""
QUIET = 1.0
"""What has no effect by then has none, s of the machine."""


@fault("O9", how=TLS)
async def two_operators(lab: Lab) -> Evidence:
    """The one who does not hold the cell is refused, and may still stop."""
    async with reachable_cell(lab) as open_cell, open_cell.client("anna") as anna, open_cell.client("bob") as bob:
        nobody = await _refused(open_cell, bob, "registration.reinit", "no_lease")
        async with anna.holding():
            await accept(anna, "registration.reinit")
            held = await _refused(open_cell, bob, "registration.reinit", "lease_held")
            await _refused(open_cell, bob, "lease.acquire", "lease_held")
            await bob.stop()
            expect((await anna.state()).latched, "Stop of who does not hold the cell was not honoured.")
        async with bob.holding():
            await accept(bob, "registration.reinit")
    return Evidence("refused; Stop honoured", {"nobody": nobody, "held": held})


@fault("A1", how=f"{SIGNED}: with the peer's name and another key, as a peer that is not known, and unsigned")
async def spoofed_source(lab: Lab) -> Evidence:
    """Whoever says to be somebody else is refused and gets no answer."""
    async with reachable_cell(lab, 'gateway.unsigned_peers=["127.0.0.2"]') as open_cell:
        key = bytes(reversed(read_key(open_cell.peer_key)))
        other = [Signer("slicer", key, lambda: 1).sign(b"img_fid_numxxxxx_4;") for _ in range(FORGED)]
        unknown = [Signer("mallory", key, lambda: 1).sign(b"img_fid_numxxxxx_4;")]
        return await _ignored(open_cell, [*other, *unknown, b"img_fid_numxxxxx_4;"])


@fault("A2", how=f"{SIGNED}: each a second time, in reverse order")
async def replayed(lab: Lab) -> Evidence:
    """What the peer has sent is refused when somebody sends it again."""
    async with reachable_cell(lab) as open_cell:
        signer = open_cell.signer()
        sent = [signer.sign(b"stop_visualizexx_#%d;" % number) for number in range(20)]
        async with raw_socket(open_cell.cell.ready.links["planner"]) as raw:
            for datagram in sent:
                raw.send(datagram)
            async with asyncio.timeout(10.0):
                answers = [await raw.answers.get() for _ in sent]
        expect(all(b"_accepted_" in answer for answer in answers), f"The peer itself was answered {answers[0]!r}.")
        return await _ignored(open_cell, [*reversed(sent)] * 5)


@fault("A3", how=f"{SIGNED}: with any bit flipped")
async def flipped_bit(lab: Lab) -> Evidence:
    """A signed command of which any bit was changed is refused."""
    async with reachable_cell(lab) as open_cell:
        signer = open_cell.signer()
        datagram = signer.sign(b"img_fid_numxxxxx_4;")
        flipped = [
            bytes(byte ^ (1 << bit % 8) if place == bit // 8 else byte for place, byte in enumerate(datagram))
            for bit in range(8 * len(datagram))
        ]
        return await _ignored(open_cell, flipped)


@fault("A9", how=f"{SIGNED}: {FORGED} of every kind of garbage, and of forged commands")
async def unauthenticated(lab: Lab) -> Evidence:
    """Nobody learns from an answer that there is somebody."""
    async with reachable_cell(lab, 'gateway.unsigned_peers=["127.0.0.2"]') as open_cell:
        garbage = [lab.random.randbytes(lab.random.randrange(1, 200)) for _ in range(FORGED)]
        forged = [b"stop_now_xxxxxxx;|slicer|%d|%s" % (n, b"0" * 32) for n in range(FORGED)]
        return await _ignored(open_cell, [*garbage, *forged, *(b"stop_now_xxxxxxx_#%d;" % n for n in range(FORGED))])


@fault("A11", how=f"{TLS}: without certificate, with one of another authority, an expired and a revoked one")
async def no_certificate(lab: Lab) -> Evidence:
    """Nobody without a certificate that counts gets in."""
    async with reachable_cell(lab) as open_cell:
        for name in (None, FOREIGN, EXPIRED):
            expect(not await _let_in(open_cell.settings(name)), f"{name or 'Nobody'} was let in.")
        expect(await _let_in(open_cell.settings("anna")), "Not even anna is let in.")
        async with unmoved(open_cell):
            with open_session(open_cell.settings(REVOKED)) as session:
                await _try_everything(open_cell, session, REVOKED)
    return Evidence("refused", {"revoked": "connected, and nothing that it sent had an effect"})


@fault("A12", how=f"{TLS}: every role sends what is another's, under its own name and others'")
async def wrong_role(lab: Lab) -> Evidence:
    """What is not a role's is dropped; what a role may not ask for is refused with the reason."""
    async with reachable_cell(lab) as open_cell, open_cell.client("anna") as anna, anna.holding():
        async with unmoved(open_cell):
            for name, others in (("eve", ("eve", "anna", "local")), ("slicer", ("anna", "local")), ("tom", ("anna",))):
                with open_session(open_cell.settings(name)) as session:
                    for other in others:
                        await _try_everything(open_cell, session, other)
        async with open_cell.client("slicer") as slicer:
            planner = await _refused(open_cell, slicer, "robot.connect", "role_not_allowed")
        await accept(anna, "robot.connect")
    return Evidence("dropped; a planner's motion refused", {"planner": planner})


@fault("A14", how=f"{TLS}: a message of {LARGE // 2**20} MiB, of somebody who may send")
async def enormous_message(lab: Lab) -> Evidence:
    """A message that is too long is not taken, and nobody else is kept waiting."""
    async with reachable_cell(lab) as open_cell, open_cell.client("anna") as anna:
        before = sample(open_cell.cell.process.pid).memory
        with open_session(open_cell.settings("bob")) as session:
            for _ in range(4):
                session.put(f"pcmrs/lab/{open_cell.cell.name}/cmd/bob/registration/reinit", bytes(LARGE))
            async with unmoved(open_cell):
                await asyncio.sleep(QUIET)
        grown = sample(open_cell.cell.process.pid).memory - before
        expect(grown < 4 * LARGE, f"The daemon has grown by {grown / 2**20:.0f} MiB.")
        async with anna.holding():
            await accept(anna, "registration.reinit")
    return Evidence("not taken; others are served", {"grown_mib": round(grown / 2**20, 1)})


@fault("A15", how=f"{TLS}: on keys with wildcards, of an operator and a viewer")
async def wildcards(lab: Lab) -> Evidence:
    """Nobody sends to all at once."""
    async with reachable_cell(lab) as open_cell, unmoved(open_cell):
        keys = ("**", "pcmrs/**", "pcmrs/*/*/**", "pcmrs/lab/*/cmd/**", "pcmrs/lab/*/stop/*", "pcmrs/lab/*/dev/*/cmd")
        for name in ("anna", "eve"):
            with open_session(open_cell.settings(name)) as session:
                for key in keys:
                    session.put(key, b"{}")
                    session.delete(key)
                await asyncio.sleep(QUIET)
    return Evidence("denied", {"keys": len(keys)})


@fault("A17", how="real key files that others may read: of the daemon, of a peer, and of the journal")
async def readable_key(lab: Lab) -> Evidence:
    """The daemon does not start with a secret that is none, and says which."""
    said_so = {}
    async with reachable_cell(lab) as open_cell:
        settings = open_cell.cell.settings
        keys = [open_cell.people.folder / "daemon1" / "daemon1.key", open_cell.peer_key]
        keys.append(open_cell.cell.folder / "journal.key")
    for key in keys:
        key.chmod(0o644)
        status, errors = await lab.ending(*settings, folder=open_cell.cell.folder)
        expect(status in (2, 4) and str(key) in errors and "0644" in errors, f"Exit status {status}: {errors[-300:]}")
        said_so[key.name] = status
        key.chmod(0o600)
    return Evidence("the daemon does not start, and names the file", {"status": said_so})


@fault("A18", how=f"{TLS}: on the keys of Zenoh's own configuration")
async def administration(lab: Lab) -> Evidence:
    """Nobody changes the access control through the router's own keys."""
    async with reachable_cell(lab) as open_cell, unmoved(open_cell):
        with open_session(open_cell.settings("anna")) as session:
            routers = [str(each) for each in session.info.routers_zid()]
            for router in (*routers, "*"):
                for path in ("access_control/enabled", "access_control/default_permission", "adminspace/enabled"):
                    session.put(f"@/{router}/router/config/{path}", b"false")
                    session.delete(f"@/{router}/router/config/{path}")
            replies = [reply.ok for reply in session.get("@/**", timeout=QUIET) if reply.ok is not None]
        answers = [each for each in replies if str(each.key_expr).split("/")[1] in routers]  # others are its own
        expect(not answers, f"The administration answers: {len(answers)} times.")
        with open_session(open_cell.settings("eve")) as session:
            await _try_everything(open_cell, session, "anna")
    return Evidence("denied; access control holds", {"routers": len(routers)})


@fault("C6", how=f"{TLS}: of a user, and of the daemon itself")
async def expired_certificate(lab: Lab) -> Evidence:
    """Whoever has it is told; whoever hides that is not let in."""
    now = SystemClock().wall()
    async with reachable_cell(lab) as open_cell:
        reason = _why_not(open_cell.people.folder / EXPIRED, now)
        expect("has expired on" in reason, f"It is said: {reason}")
        expect(not await _let_in(open_cell.settings(EXPIRED)), "Somebody whose certificate has expired was let in.")
        authority, folder = open_cell.people.authority, open_cell.people.folder
        settings = [each for each in open_cell.cell.settings if not each.startswith("access.identity")]
    authority.issue("daemon", "daemon2", now - 10 * 86400.0, days=7.0, hosts=("127.0.0.1",), into=folder)
    status, errors = await lab.ending(*settings, f"access.identity={folder / 'daemon2'}")
    expect(status == 4 and "daemon2.pem has expired on" in errors, f"Exit status {status}: {errors[-300:]}")
    return Evidence("refused, and why is said", {"user": reason, "status": status})


async def _refused(open_cell: ReachableCell, client: Client, name: str, code: str) -> str:
    """Response R to somebody's command; returns what was said."""
    before, row = await open_cell.cell.client.state(), open_cell.cell.last_row()
    verdict = await client.call(name)
    await check_refused(open_cell.cell, verdict, before, row, [code])
    return said(verdict)


async def _ignored(open_cell: ReachableCell, datagrams: list[bytes]) -> Evidence:
    """None of the datagrams is answered or changes anything, and the journal tells of them."""
    cell = open_cell.cell
    before, row = await cell.client.state(), cell.last_row()
    async with raw_socket(cell.ready.links["planner"]) as raw:
        for datagram in datagrams:
            raw.send(datagram)
            await asyncio.sleep(0)
        await asyncio.sleep(QUIET)
        answered = raw.answers.qsize()
    expect(answered == 0, f"{answered} were answered.")
    expect(shape(await cell.client.state()) == shape(before), "The state has changed.")
    told = [each for each in cell.rows(row) if each.operation == "refused"]
    expect(bool(told), "The journal does not tell of any.")
    reasons = sorted({(each.result or {})["fields"]["reason"] for each in told})
    return Evidence("refused, not answered, told in the journal", {"sent": len(datagrams), "reasons": reasons})


async def _let_in(settings: BusSettings) -> bool:
    """Whether a session is opened."""
    try:
        session = await asyncio.to_thread(open_session, settings)
    except BusError:
        return False
    await asyncio.to_thread(session.close)
    return True


async def _try_everything(open_cell: ReachableCell, session: zenoh.Session, name: str) -> None:
    """Commands, calls of devices, false poses and states, and Stop, as if one were somebody else."""
    prefix = f"pcmrs/lab/{open_cell.cell.name}"
    hold = msgspec.json.encode({"method": "hold", "arguments": {}})
    for key, payload in (
        (f"cmd/{name}/robot/connect", b"{}"),
        (f"cmd/{name}/lease/take_over", b"{}"),
        ("dev/robot/cmd", hold),
        ("state/fsm", b"{}"),
        ("state/pose/coil", b"{}"),
        ("dev/robot/beat", b"{}"),
    ):
        session.put(f"{prefix}/{key}", payload)
        replies: Any = session.get(f"{prefix}/{key}", payload=payload, timeout=QUIET / 2)
        answers = [reply for reply in await asyncio.to_thread(list, replies) if reply.ok is not None]
        expect(not answers, f"{key} was answered.")


@asynccontextmanager
async def unmoved(open_cell: ReachableCell) -> AsyncIterator[None]:
    """The state of the cell is at the end what it was, and its journal has no decision of anybody's."""
    cell = open_cell.cell
    before, row = await cell.client.state(), cell.last_row()
    yield
    await asyncio.sleep(QUIET)
    expect(shape(await cell.client.state()) == shape(before), "The state has changed.")
    decided = [each for each in cell.rows(row) if each.kind in ("intent", "outcome")]
    expect(not decided, f"{len(decided)} commands got to the dispatcher.")


def _why_not(folder: Path, now: float) -> str:
    try:
        read_credentials(folder, now)
    except ConfigurationError as error:
        return error.text
    return "nothing"
