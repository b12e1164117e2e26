"""An attacker who has taken over a router sends messages in the name of the people whom it carries."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import Literal, NamedTuple

import zenoh

from pcmrs.bus.codec import pack, unpack
from pcmrs.bus.commands import Envelope
from pcmrs.bus.settings import open_session
from pcmrs.bus.signature import CertificateSigner
from pcmrs.bus.stop import Stopping
from pcmrs.clock import SystemClock
from pcmrs.messages import Verdict
from pcmrs.messages.identity import LOCAL
from pcmrs.testing.cell import RunningCell
from pcmrs.testing.driving import PATIENCE
from pcmrs_lab.campaign.checks import expect
from pcmrs_lab.campaign.counted_session import CountedSession, counted_session
from pcmrs_lab.campaign.fault import Evidence, fault
from pcmrs_lab.campaign.faults.access import QUIET, SETPOINT, TLS, send_forbidden, unmoved
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.reachable import CARRIED, ELSEWHERE, REVOKED, ROUTER, ReachableCell, reachable_cell
from pcmrs_lab.campaign.sham import is_sham
from pcmrs_lab.campaign.tries import BUS


class WireMessage(NamedTuple):
    """Message as on the wire: absolute key, payload and signature."""

    key: str
    payload: bytes
    signature: bytes | None


@fault(
    "A34",
    how=f"{TLS}: by a session with the router's certificate, unsigned, signed by itself, changed and repeated",
    deadline=240.0,
    tries={"router": BUS},
)
async def taken_over_router(lab: Lab) -> Evidence:
    """Forged messages are refused; a command that the person has signed is accepted once, and Stop always."""
    async with reachable_cell(lab) as open_cell:
        async with unmoved(open_cell), counted_session(open_cell, ROUTER) as session:
            await _send_for_others(open_cell, session)
            arrived = await session.wait_until_arrived()
        with await asyncio.to_thread(open_session, open_cell.settings(ROUTER)) as thief:
            async with unmoved(open_cell):
                reasons = {
                    "unsigned": await _rejection_reason(thief, _command(open_cell, "lease/take_over", None)),
                    "by the router": await _rejection_reason(thief, _command(open_cell, "lease/take_over", ROUTER)),
                }
                ignored = await _forge_setpoints(open_cell, thief)
            own = _command(open_cell, "lease/acquire", CARRIED)
            control = await _request(thief, own)
            expect(control.decision == "accepted", f"The command that {CARRIED} signed was {control.decision}.")
            async with unmoved(open_cell):
                reasons["repeated"] = await _rejection_reason(thief, own)
                other = _command(open_cell, "registration/reinit", CARRIED)
                reasons["for another command"] = await _rejection_reason(thief, own._replace(key=other.key))
                reasons["changed"] = await _rejection_reason(thief, own._replace(payload=other.payload))
            control = await _request(thief, other)
            expect(control.decision == "accepted", f"The command that {CARRIED} signed was {control.decision}.")
            stopped = await _answer(thief, WireMessage(_absolute(open_cell, f"stop/{CARRIED}"), b"", None))
            expect(unpack(stopped, Stopping).source == f"bus:{CARRIED}", "Stop was not honoured.")
    expected = {
        "unsigned": "unsigned", "by the router": "certificate", "repeated": "repeated",
        "for another command": "forged", "changed": "forged",
    }  # fmt: skip
    expect(reasons == expected, f"The reasons were {reasons}.")
    return Evidence(
        "refused; Stop honoured",
        took_place={
            "answered_by_the_daemon": reasons,
            "set_points_ignored_by_the_daemon": ignored,
            "bytes_in_the_name_of_others_at_the_daemon": arrived,
        },
        control_kind="permitted",
        control={"signed_by_the_person": control.decision},
    )


async def _send_for_others(open_cell: ReachableCell, session: CountedSession) -> None:
    """Send messages in the name of users whom the router does not carry, or no longer carries. Two users sign.

    Args:
        open_cell: Cell that receives it.
        session: Session with the router's certificate.
    """
    for name in (LOCAL, "anna", REVOKED, ELSEWHERE):
        await send_forbidden(open_cell, session, name)
    for name in (REVOKED, ELSEWHERE):
        signed = _command(open_cell, "lease/take_over", name, name)
        answers = await session.ask(signed.key, signed.payload, signed.signature)
        expect(not answers, f"A command that {name} has signed was answered.")


async def _forge_setpoints(open_cell: ReachableCell, thief: zenoh.Session) -> int:
    """Put set points of the carried person: unsigned, signed by the router, genuine, and the genuine one again.

    Returns:
        Number that the daemon has ignored.

    Raises:
        Unmet: It has ignored another number than all but the genuine one.
    """
    before = await _ignored_count(open_cell.cell)

    async def put(sent: WireMessage, ignored: int) -> None:
        if not is_sham():
            await asyncio.to_thread(partial(thief.put, sent.key, sent.payload, attachment=sent.signature))
        await asyncio.sleep(QUIET)
        found = await _ignored_count(open_cell.cell) - before
        expect(found == ignored, f"Of {ignored} forged set points the daemon has ignored {found}.")

    await put(_setpoint(open_cell, None), 1)
    await put(_setpoint(open_cell, ROUTER), 2)
    genuine = _setpoint(open_cell, CARRIED)
    await put(genuine, 2)
    await put(genuine, 3)
    return 3


async def _ignored_count(cell: RunningCell) -> int:
    return (await cell.client.health()).dropped["bus.ignored"]


def _absolute(open_cell: ReachableCell, key: str) -> str:
    return f"{open_cell.cell.ready.prefix}/{key}"


def _setpoint(open_cell: ReachableCell, signer: str | None) -> WireMessage:
    """Return a set point of the carried person, with a signature."""
    return _signed(open_cell, "put", _absolute(open_cell, f"teleop/{CARRIED}"), SETPOINT, signer)


def _command(open_cell: ReachableCell, name: str, signer: str | None, user: str = CARRIED) -> WireMessage:
    """Return a command of a user, by default of the carried person, with a signature."""
    return _signed(open_cell, "query", _absolute(open_cell, f"cmd/{user}/{name}"), pack(Envelope(id=name)), signer)


def _signed(
    open_cell: ReachableCell, kind: Literal["put", "query"], key: str, payload: bytes, signer: str | None
) -> WireMessage:
    if signer is None:
        return WireMessage(key, payload, None)
    own = CertificateSigner.read(open_cell.people.credentials(signer), SystemClock())
    return WireMessage(key, payload, own.sign(kind, key, payload))


async def _rejection_reason(session: zenoh.Session, sent: WireMessage) -> str:
    """Return the reason why a command is refused; empty in a sham campaign, where it is not sent."""
    if is_sham():
        return ""
    verdict = await _request(session, sent)
    reason = verdict.reason
    expect(verdict.decision == "rejected" and reason is not None, f"{sent.key} was {verdict.decision}.")
    return "" if reason is None else str(reason.fields.get("why", reason.code))


async def _request(session: zenoh.Session, sent: WireMessage) -> Verdict:
    return unpack(await _answer(session, sent), Verdict)


async def _answer(session: zenoh.Session, sent: WireMessage) -> bytes:
    def ask() -> list[bytes]:
        replies = session.get(sent.key, payload=sent.payload, attachment=sent.signature, timeout=PATIENCE)
        return [reply.result.payload.to_bytes() for reply in replies]

    answers = await asyncio.to_thread(ask)
    expect(len(answers) == 1, f"{sent.key} had {len(answers)} answers.")
    return answers[0]
