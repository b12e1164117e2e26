"""Faults of access: people and programs attempt what they may not, at a cell that other machines can reach."""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import msgspec
import zenoh

from pcmrs.bus.codec import MAX_BYTES, pack, unpack
from pcmrs.bus.settings import BusSettings, open_session
from pcmrs.client import Client
from pcmrs.clock import SystemClock
from pcmrs.errors import BusError, ConfigurationError
from pcmrs.gateway.signing import Signer, read_key
from pcmrs.messages import TeleopSetpoint, Verdict
from pcmrs.messages.teleop import AT_REST
from pcmrs.pki import read_credentials
from pcmrs.testing.cell import RunningCell
from pcmrs.testing.driving import PATIENCE, accept, reason_text, until
from pcmrs_lab.campaign.checks import check_refused, expect, shape
from pcmrs_lab.campaign.counted_session import CountedSession, counted_session, counting_endpoint
from pcmrs_lab.campaign.datagrams import raw_socket, refusals_after, send_accepted
from pcmrs_lab.campaign.fault import Evidence, fault
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.reachable import (
    DAEMON,
    DEVICE,
    ELSEWHERE,
    EXPIRED,
    FOREIGN,
    INVALID,
    PEER,
    REVOKED,
    ReachableCell,
    attacker_of,
    reachable_cell,
)
from pcmrs_lab.campaign.samples import sample
from pcmrs_lab.campaign.sham import inject_unless_sham, is_sham
from pcmrs_lab.campaign.tries import ADMIN, BUS, COMMANDS, DELAYED, FILES, LOCAL_ACCOUNT, UNKNOWN, WILDCARDS, record
from pcmrs_lab.campaign.waiting import until_true
from pcmrs_lab.campaign.without_guard import without_guards

TLS = "a running cell that listens for other machines, over real TLS on loopback"
SIGNED = "raw datagrams at a running cell with a peer that signs"
FORGED = 200
"""Number of tampered signed commands of each kind."""
LARGE = 24 * 1024 * 1024
"""Size of a message above the permitted size, bytes."""
ENORMOUS = b"{}".ljust(LARGE)
"""A command that would be accepted, if it were not so long."""
REINIT_OF_BOB = "cmd/bob/registration/reinit"
KEPT = 4.0
"""Time after which a connection that is still open counts as kept, s of the machine; the daemon waits longer for its
first message."""
QUIET = 1.0
"""Time within which every effect shows, s of the machine."""
AT_ONCE = 64
"""Number of datagrams that are sent without waiting: more might not fit into the socket's buffer."""
SWITCHES = ("access_control/enabled", "access_control/default_permission", "adminspace/enabled")
"""Keys of Zenoh's configuration that would open a cell."""
SETPOINT = pack(TeleopSetpoint(sequence=1, sent=0.0, seen=0.0, ttl=1.0, twist=AT_REST))


@fault("O9", how=TLS)
async def two_operators(lab: Lab) -> Evidence:
    """An operator who does not hold the cell is refused, and may still stop it."""
    async with reachable_cell(lab) as open_cell, open_cell.client("anna") as anna, open_cell.client("bob") as bob:
        row = open_cell.cell.last_row()
        nobody = await _check_refused(open_cell, bob, "registration.reinit", "no_lease")
        async with anna.holding():
            await accept(anna, "registration.reinit")
            other = anna if is_sham() else bob
            held = await _check_refused(open_cell, other, "registration.reinit", "lease_held")
            await _check_refused(open_cell, other, "lease.acquire", "lease_held")
            await bob.stop()
            expect((await anna.state()).latched, "Stop was not honoured for an operator who does not hold the cell.")
        async with bob.holding():
            control = await accept(bob, "registration.reinit")
        rows = [each for each in open_cell.cell.rows(row) if each.source == "bus:bob"]
    return Evidence(
        "refused; Stop honoured",
        took_place={
            "rejected_in_the_journal": sum(each.verdict.decision == "rejected" for each in rows if each.verdict)
        },
        control_kind="permitted",
        control={"with_the_lease": control.decision},
        details={"nobody": nobody, "held": held},
    )


@fault(
    "A1",
    how=f"{SIGNED}: with the peer's name and another key, as an unknown peer, and unsigned",
    tries={UNKNOWN: ["UDP"]},
)
async def spoofed_source(lab: Lab) -> Evidence:
    """A sender under a false name is refused and gets no answer."""
    async with reachable_cell(lab, 'gateway.unsigned_peers=["127.0.0.2"]') as open_cell:
        key = bytes(reversed(read_key(open_cell.peer_key)))
        other = [Signer(PEER, key, lambda: 1).sign(b"img_fid_numxxxxx_4;") for _ in range(FORGED)]
        unknown = [Signer("mallory", key, lambda: 1).sign(b"img_fid_numxxxxx_4;")]
        forged = [*other, *unknown, b"img_fid_numxxxxx_4;"]
        return await _check_ignored(open_cell, forged, control=open_cell.signer().sign(b"img_fid_numxxxxx_4_#1;"))


@fault("A2", how=f"{SIGNED}: each a second time, in reverse order", tries={DELAYED: ["UDP"]})
async def replayed(lab: Lab) -> Evidence:
    """A command of the peer is refused when another program sends it again."""
    async with reachable_cell(lab) as open_cell:
        signer = open_cell.signer()
        sent = [signer.sign(b"stop_visualizexx_#%d;" % number) for number in range(20)]
        async with raw_socket(open_cell.cell.ready.links["planner"]) as raw:
            for datagram in sent:
                raw.send(datagram)
            async with asyncio.timeout(10.0):
                answers = [await raw.answers.get() for _ in sent]
        expect(all(b"_accepted_" in answer for answer in answers), f"The peer itself was answered {answers[0]!r}.")
        control = signer.sign(b"stop_visualizexx_#21;")
        evidence = await _check_ignored(open_cell, [*reversed(sent)] * 5, control=control, by=DELAYED)
        return replace(evidence, control={**evidence.control, "the_first_time": len(answers)})


@fault("A3", how=f"{SIGNED}: with any bit flipped", tries={UNKNOWN: ["UDP"]})
async def flipped_bit(lab: Lab) -> Evidence:
    """A signed command with one changed bit is refused."""
    async with reachable_cell(lab) as open_cell:
        datagram = open_cell.signer().sign(b"img_fid_numxxxxx_4_#1;")
        flipped = [
            bytes(byte ^ (1 << bit % 8) if place == bit // 8 else byte for place, byte in enumerate(datagram))
            for bit in range(8 * len(datagram))
        ]
        return await _check_ignored(open_cell, flipped, control=datagram)


@fault("A9", how=f"{SIGNED}: {FORGED} of every kind of garbage, and of forged commands", tries={UNKNOWN: ["UDP"]})
async def unauthenticated(lab: Lab) -> Evidence:
    """An unauthenticated sender gets no answer that would show that a daemon listens."""
    async with reachable_cell(lab, 'gateway.unsigned_peers=["127.0.0.2"]') as open_cell:
        garbage = [lab.random.randbytes(lab.random.randrange(1, 200)) for _ in range(FORGED)]
        forged = [f"stop_now_xxxxxxx;|{PEER}|{n}|{'0' * 32}".encode() for n in range(FORGED)]
        unsigned = [b"stop_now_xxxxxxx_#%d;" % n for n in range(FORGED)]
        control = open_cell.signer().sign(b"stop_now_xxxxxxx_#1;")
        return await _check_ignored(open_cell, [*garbage, *forged, *unsigned], control=control)


@fault(
    "A11",
    how=f"{TLS}: without certificate, with one of another authority, and with an expired one",
    tries={"unknown client": ["TLS port"], INVALID: ["TLS port"]},
)
async def no_certificate(lab: Lab) -> Evidence:
    """No client without a valid certificate is admitted."""
    async with reachable_cell(lab) as open_cell:
        alert = await _connection_end(open_cell, with_certificate=is_sham())
        expect("CERTIFICATE_REQUIRED" in alert, f"Without a certificate a connection was ended by {alert!r}.")
        alone = await _connection_end(open_cell, with_certificate=True)
        expect(not alone, f"With a certificate, too, a connection was ended by {alone!r}.")
        rejected: dict[str, object] = {"alert_to_nobody": alert}
        for name in (FOREIGN, EXPIRED):
            used = "anna" if is_sham() else name
            async with counting_endpoint(open_cell) as (endpoint, impairment):
                settings = msgspec.structs.replace(open_cell.settings(used), endpoint=endpoint)
                expect(not await _is_admitted(settings), f"{used} was admitted.")
            rejected[f"bytes_of_{name}_at_the_daemon"] = impairment.passed["towards"]
            record(attacker_of(name), "TLS port")
        expect(await _is_admitted(open_cell.settings("anna")), "anna was not admitted either.")
    return Evidence(
        "refused",
        took_place=rejected,
        control_kind="permitted",
        control={"let_in": "anna", "kept_with_a_certificate": not alone},
    )


@fault(
    "A11",
    how=f"{TLS}: with a certificate that was revoked, and with one for another cell",
    tries={INVALID: BUS, "user of another cell": BUS},
)
async def certificate_that_does_not_count(lab: Lab) -> Evidence:
    """Such a client is connected, but nothing that it sends has an effect, not even Stop."""
    arrived = {}
    async with reachable_cell(lab) as open_cell:
        async with unmoved(open_cell):
            for name in (REVOKED, ELSEWHERE):
                async with counted_session(open_cell, name) as session:
                    await send_forbidden(open_cell, session, name)
                    arrived[name] = await session.wait_until_arrived()
        async with open_cell.client("anna") as anna, anna.holding():
            control = await _accepted_from(open_cell, "anna")
            await anna.stop()
            expect((await anna.state()).latched, "Stop was not honoured for anna either.")
    return Evidence(
        "connected, and nothing that it sent had an effect",
        took_place={f"bytes_of_{name}_at_the_daemon": count for name, count in arrived.items()},
        control_kind="permitted",
        control={"the_same_command_by_anna": control, "stopped_by_anna": True},
    )


@fault(
    "A12",
    how=f"{TLS}: every role sends messages of other roles, under its own name and others'",
    deadline=240.0,
    tries=dict.fromkeys(("viewer", "planner", "teleoperator", "operator", "device", "daemon"), BUS),
)
async def wrong_role(lab: Lab) -> Evidence:
    """A message of another role is dropped; an operation that a role may not request is refused with the reason."""
    others = {"eve": ("anna", "local"), "slicer": ("anna", "local"), "tom": ("anna",), "bob": ("anna",)}
    others |= {DEVICE: ("anna",), DAEMON: ("anna",)}
    async with reachable_cell(lab) as open_cell, open_cell.client("anna") as anna, anna.holding():
        arrived = {}
        async with unmoved(open_cell):
            for name, used in others.items():
                async with counted_session(open_cell, name) as session:
                    if name == "eve":
                        await send_forbidden(open_cell, session, name, is_own=True)
                    for other in used:
                        await send_forbidden(open_cell, session, other)
                    arrived[name] = await session.wait_until_arrived()
        async with open_cell.client("slicer") as slicer:
            planner = await _check_refused(open_cell, slicer, "robot.connect", "role_not_allowed")
        control = await _accepted_from(open_cell, "anna")
        await anna.stop()
        expect((await anna.state()).latched, "Stop was not honoured for anna either.")
    return Evidence(
        "dropped; a planner's motion refused",
        took_place={f"bytes_of_{name}_at_the_daemon": count for name, count in arrived.items()},
        control_kind="permitted",
        control={"the_same_command_by_anna": control, "stopped_by_anna": True},
        details={"planner": planner},
    )


@fault(
    "A14",
    how=f"{TLS}: a message of {LARGE // 2**20} MiB, from a user who may send",
    tries={"operator": [COMMANDS]},
)
async def enormous_message(lab: Lab) -> Evidence:
    """A message that is too long is not accepted, and other clients are not delayed."""
    async with reachable_cell(lab) as open_cell, open_cell.client("anna") as anna:
        before = sample(open_cell.cell.process.pid).memory
        async with unmoved(open_cell), counted_session(open_cell, "bob") as session:
            for _ in range(4):
                await session.put(f"pcmrs/lab/{open_cell.cell.name}/{REINIT_OF_BOB}", ENORMOUS)
            arrived = await session.wait_until_arrived(most=MAX_BYTES)
        grown = sample(open_cell.cell.process.pid).memory - before
        expect(grown < 4 * LARGE, f"The daemon has grown by {grown / 2**20:.0f} MiB.")
        async with anna.holding():
            await accept(anna, "registration.reinit")
        async with open_cell.client("bob") as bob, bob.holding():
            short = await _accepted_from(open_cell, "bob", "registration/reinit")
    unlimited = without_guards("messages_of_any_size", "a_payload_of_any_length")
    async with reachable_cell(lab, prefix=unlimited) as open_cell, open_cell.client("bob") as bob, bob.holding():
        row = open_cell.cell.last_row()
        with await asyncio.to_thread(open_session, open_cell.settings("bob")) as session:
            key = f"pcmrs/lab/{open_cell.cell.name}/{REINIT_OF_BOB}"
            await asyncio.to_thread(session.put, key, ENORMOUS, congestion_control=zenoh.CongestionControl.BLOCK)
            control = await _decision_on(open_cell, row, "reinit")
    return Evidence(
        "not taken; others are served",
        took_place={"bytes_at_the_daemon": arrived},
        control_kind="mutant",
        control={"the_same_message_without_the_guards": control, "a_short_one_of_the_same_user": short},
        details={"grown_mib": round(grown / 2**20, 1)},
    )


@fault(
    "A15",
    how=f"{TLS}: on keys with wildcards, of an operator and a viewer",
    tries={"operator": [WILDCARDS], "viewer": [WILDCARDS]},
)
async def wildcards(lab: Lab) -> Evidence:
    """A put to many keys at once is denied."""
    arrived = {}
    async with reachable_cell(lab) as open_cell:
        keys = ("**", "pcmrs/**", "pcmrs/*/*/**", "pcmrs/lab/*/cmd/**", "pcmrs/lab/*/stop/*", "pcmrs/lab/*/dev/*/cmd")
        async with unmoved(open_cell):
            for name in ("anna", "eve"):
                async with counted_session(open_cell, name) as session:
                    for key in keys:
                        await session.put(key, b"{}")
                        await session.delete(key)
                    arrived[name] = await session.wait_until_arrived()
        async with open_cell.client("anna") as anna, anna.holding():
            control = await _accepted_from(open_cell, "anna")
    async with reachable_cell(lab, prefix=without_guards("everybody_may_use_every_key")) as open_cell:
        with await asyncio.to_thread(open_session, open_cell.settings("eve")) as session:
            await asyncio.to_thread(session.put, "pcmrs/lab/*/stop/*", b"{}")
            stopped = (await until(open_cell.cell.client, lambda shown: shown.latched)).latched
    return Evidence(
        "denied",
        took_place={f"bytes_of_{name}_at_the_daemon": count for name, count in arrived.items()},
        control_kind="mutant",
        control={"stopped_by_a_wildcard_without_the_guard": stopped, "a_key_without_wildcards": control},
        details={"keys": len(keys)},
    )


@fault(
    "A17",
    how="real key files that others may read: of the daemon, of a peer, and of the journal",
    tries={LOCAL_ACCOUNT: [FILES]},
)
async def readable_key(lab: Lab) -> Evidence:
    """The daemon does not start with a secret that others can read, and names the file."""
    statuses = {}
    async with reachable_cell(lab) as open_cell:
        settings = open_cell.cell.settings
        keys = [open_cell.people.folder / "daemon1" / "daemon1.key", open_cell.peer_key]
        keys.append(open_cell.cell.folder / "journal.key")
    modes = {}
    for key in keys:
        inject_unless_sham(partial(key.chmod, 0o644))
        record(LOCAL_ACCOUNT, FILES)
        modes[key.name] = f"{key.stat().st_mode & 0o777:04o}"
        status, errors = await lab.start_refused(*settings, folder=open_cell.cell.folder)
        expect(status in (2, 4) and str(key) in errors and "0644" in errors, f"Exit status {status}: {errors[-300:]}")
        statuses[key.name] = status
        key.chmod(0o600)
    async with lab.daemon(*settings, folder=open_cell.cell.folder) as cell:
        started = await cell.client.state()
    return Evidence(
        "the daemon does not start, and names the file",
        took_place={"modes": modes},
        control_kind="permitted",
        control={"with_0600": f"starts, robot {started.branches['robot']}"},
        details={"status": statuses},
    )


@fault(
    "A18",
    how=f"{TLS}: on the keys of Zenoh's own configuration, of an operator, a viewer and a planner",
    deadline=180.0,
    tries={"operator": [ADMIN], "viewer": [ADMIN, *BUS], "planner": [ADMIN]},
)
async def administration(lab: Lab) -> Evidence:
    """The access control cannot be changed through the router's own keys."""
    arrived, replies, routers = {}, list[str](), list[str]()
    async with reachable_cell(lab) as open_cell:
        async with unmoved(open_cell):
            for name in ("anna", "eve", "slicer"):
                async with counted_session(open_cell, name) as session:
                    routers = [str(each) for each in session.zenoh.info.routers_zid()]
                    for router in (*routers, "*"):
                        for path in SWITCHES:
                            await session.put(f"@/{router}/router/config/{path}", b"false")
                            await session.delete(f"@/{router}/router/config/{path}")
                    arrived[name] = await session.wait_until_arrived()
                    replies = await asyncio.to_thread(_administration, session.zenoh)
                answers = [each for each in replies if each in routers]  # the others are the session itself
                expect(not answers, f"The daemon's admin space answered {name} {len(answers)} times.")
            async with counted_session(open_cell, "eve") as session:
                await send_forbidden(open_cell, session, "anna")
                arrived["eve afterwards"] = await session.wait_until_arrived()
        async with open_cell.client("anna") as anna, anna.holding():
            control = await _accepted_from(open_cell, "anna")
    administrable = without_guards("everybody_may_use_every_key", "the_administration_may_be_changed")
    async with reachable_cell(lab, prefix=administrable) as open_cell:
        with await asyncio.to_thread(open_session, open_cell.settings("anna")) as session:
            open_routers = {str(each) for each in session.info.routers_zid()}
            open_to_all = await asyncio.to_thread(_administration, session)
    answering = sum(each in open_routers for each in open_to_all)
    expect(answering > 0, "Without the guard, too, the daemon's admin space did not answer.")
    return Evidence(
        "denied; access control holds",
        took_place={f"bytes_of_{name}_at_the_daemon": count for name, count in arrived.items()},
        control_kind="mutant",
        control={"answers_of_the_daemon_without_the_guard": answering, "the_command_of_eve_by_anna": control},
        details={"routers": len(routers), "its_own_administration_answers": len(replies)},
    )


def _administration(session: zenoh.Session) -> list[str]:
    """Return the id of the router or client of each answer about its administration."""
    replies = session.get("@/**", timeout=QUIET)
    return [str(reply.ok.key_expr).split("/")[1] for reply in replies if reply.ok is not None]


@fault("C6", how=f"{TLS}: of a user, and of the daemon itself")
async def expired_certificate(lab: Lab) -> Evidence:
    """A user with an expired certificate gets the reason; a client that hides it is not admitted."""
    now = SystemClock().wall()
    async with reachable_cell(lab) as open_cell:
        reason = _refusal_text(open_cell.people.folder / EXPIRED, now)
        expect("has expired on" in reason, f"The reason is: {reason}")
        used = "anna" if is_sham() else EXPIRED
        expect(not await _is_admitted(open_cell.settings(used)), "A user with an expired certificate was admitted.")
        expect(
            await _is_admitted(open_cell.settings("anna")), "anna was not admitted, although her certificate is valid."
        )
        authority, folder = open_cell.people.authority, open_cell.people.folder
        settings = [each for each in open_cell.cell.settings if not each.startswith("access.identity")]
        place = open_cell.cell.folder
    hosts, cells = ("127.0.0.1",), ("lab/*",)
    authority.issue("daemon", "daemon2", now - 10 * 86400.0, days=7.0, hosts=hosts, cells=cells, into=folder)
    status, errors = await lab.start_refused(*settings, f"access.identity={folder / 'daemon2'}")
    expect(status == 4 and "daemon2.pem has expired on" in errors, f"Exit status {status}: {errors[-300:]}")
    async with lab.daemon(*settings, f"access.identity={folder / 'daemon1'}", folder=place) as cell:
        started = await cell.client.state()
    return Evidence(
        "refused with the reason",
        took_place={"user": reason, "daemon": errors.strip().splitlines()[-1]},
        control_kind="permitted",
        control={"let_in": "anna", "daemon_with_one_that_counts": f"starts, robot {started.branches['robot']}"},
        details={"status": status},
    )


async def _decision_on(open_cell: ReachableCell, row: int, operation: str) -> str:
    """Wait for the decision on an operation that a later row has, and return it."""

    def decisions() -> list[str]:
        rows = open_cell.cell.rows(row)
        return [each.verdict.decision for each in rows if each.operation == operation and each.verdict is not None]

    await until_true(lambda: decisions() != [], f"Without the guards, too, {operation} was not decided on")
    return decisions()[0]


async def _check_refused(open_cell: ReachableCell, client: Client, name: str, code: str) -> str:
    """Check response R to a user's command, and return the text of the refusal."""
    before, row = await open_cell.cell.client.state(), open_cell.cell.last_row()
    verdict = await client.call(name)
    await check_refused(open_cell.cell, verdict, before, row, [code])
    return reason_text(verdict)


async def _check_ignored(
    open_cell: ReachableCell, datagrams: list[bytes], *, control: bytes, by: str = UNKNOWN
) -> Evidence:
    """Check that no datagram is answered or changes anything, and all are journalled; `control` is accepted."""
    cell = open_cell.cell
    before, row = await cell.client.state(), cell.last_row()
    async with raw_socket(cell.ready.links["planner"]) as raw:
        for count, datagram in enumerate(datagrams, 1):
            raw.attack(datagram)
            record(by, "UDP")
            if count % AT_ONCE == 0 or count == len(datagrams):
                await _until_refused(cell, row, count)
        await asyncio.sleep(QUIET)
        answered = raw.answers.qsize()
    expect(answered == 0, f"{answered} datagrams were answered.")
    expect(shape(await cell.client.state()) == shape(before), "The state has changed.")
    reports = [each for each in cell.rows(row) if each.operation == "refused"]
    reasons = sorted({(each.result or {})["fields"]["reason"] for each in reports})
    refused_ones = refusals_after(cell, row)
    answer = await send_accepted(cell, control)
    return Evidence(
        "refused, not answered, reported in the journal",
        took_place={"refused_in_the_journal": refused_ones},
        control_kind="permitted",
        control={"signed_by_the_peer": answer},
        details={"sent": len(datagrams), "reasons": reasons},
    )


async def _until_refused(cell: RunningCell, row: int, count: int) -> None:
    await until_true(lambda: refusals_after(cell, row) >= count, f"The journal does not have {count} refusals")


async def _is_admitted(settings: BusSettings) -> bool:
    """Return whether a session is opened."""
    try:
        session = await asyncio.to_thread(open_session, settings)
    except BusError:
        return False
    await asyncio.to_thread(session.close)
    return True


async def _connection_end(open_cell: ReachableCell, *, with_certificate: bool) -> str:
    """Return why the daemon ends a bare TLS connection; empty if it does not.

    Zenoh's own client never dials without a certificate.
    """
    own = open_cell.people.credentials("anna")
    context = ssl.create_default_context(cafile=own.authority)
    if with_certificate:
        context.load_cert_chain(own.certificate, own.key)
    reader, writer = await asyncio.open_connection(*open_cell.address, ssl=context)
    try:
        async with asyncio.timeout(KEPT):
            return "nothing but its end" if not await reader.read(1) else ""
    except TimeoutError:
        return ""
    except ssl.SSLError as error:
        return error.reason or str(error)
    finally:
        writer.close()


async def send_forbidden(open_cell: ReachableCell, session: CountedSession, name: str, *, is_own: bool = False) -> None:
    """Send commands, device calls, scene events, false poses and states; under another's name also Stop and set points.

    Args:
        open_cell: Cell that receives them.
        session: Session of somebody who may send none of them.
        name: Name in the keys.
        is_own: True if that is the name of the session, which may press Stop under it.
    """
    prefix = f"pcmrs/lab/{open_cell.cell.name}"
    hold = msgspec.json.encode({"method": "hold", "arguments": {}})
    requests = {f"cmd/{name}/robot/connect": b"{}", f"cmd/{name}/lease/take_over": b"{}", "dev/robot/cmd": hold}
    puts = {"state/fsm": b"{}", "state/pose/coil": b"{}", "dev/robot/beat": b"{}", f"scene/{name}": b"{}"}
    if not is_own:
        check = msgspec.json.encode({"branch": "robot", "operation": "connect"})
        requests |= {f"stop/{name}": b"", f"svc/setup/{name}": b"", f"svc/check/{name}": check}
        puts[f"teleop/{name}"] = SETPOINT
    for key, payload in (requests | puts).items():
        await session.put(f"{prefix}/{key}", payload)
    for key, payload in requests.items():
        expect(not await session.ask(f"{prefix}/{key}", payload), f"{key} was answered.")


async def _accepted_from(open_cell: ReachableCell, name: str, command: str = "robot/connect") -> str:
    """Send the same command as a user who holds the cell, as a control, and return the decision."""
    key = f"pcmrs/lab/{open_cell.cell.name}/cmd/{name}/{command}"

    def ask() -> list[bytes]:
        with open_session(open_cell.settings(name)) as session:
            replies = list(session.get(key, payload=b"{}", timeout=PATIENCE))
            return [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]

    answers = await asyncio.to_thread(ask)
    expect(len(answers) == 1, f"{key} had {len(answers)} answers.")
    verdict = unpack(answers[0], Verdict)
    expect(verdict.decision == "accepted", f"{key} by a permitted user was {verdict.decision}: {reason_text(verdict)}.")
    return verdict.decision


@asynccontextmanager
async def unmoved(open_cell: ReachableCell) -> AsyncIterator[None]:
    """Check that the context leaves the state of the cell unchanged, and no decision in its journal."""
    cell = open_cell.cell
    before, row = await cell.client.state(), cell.last_row()
    yield
    await asyncio.sleep(QUIET)
    expect(shape(await cell.client.state()) == shape(before), "The state has changed.")
    decided = [each for each in cell.rows(row) if each.kind in ("intent", "outcome")]
    expect(not decided, f"{len(decided)} commands reached the dispatcher.")


def _refusal_text(folder: Path, now: float) -> str:
    try:
        read_credentials(folder, now)
    except ConfigurationError as error:
        return error.text
    return "nothing"
