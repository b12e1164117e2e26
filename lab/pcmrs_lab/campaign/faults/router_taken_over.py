"""An attacker who has taken over a router sends messages in the name of the people whom it carries."""

from __future__ import annotations

import asyncio
from typing import NamedTuple

import zenoh

from pcmrs.bus.codec import pack, unpack
from pcmrs.bus.commands import Envelope
from pcmrs.bus.settings import open_session
from pcmrs.bus.signature import CertificateSigner
from pcmrs.bus.stop import Stopping
from pcmrs.clock import SystemClock
from pcmrs.messages import Verdict
from pcmrs.testing.driving import PATIENCE
from pcmrs_lab.campaign.checks import expect
from pcmrs_lab.campaign.fault import Evidence, fault
from pcmrs_lab.campaign.faults.access import TLS, unmoved
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.reachable import CARRIED, ROUTER, ReachableCell, reachable_cell
from pcmrs_lab.campaign.sham import is_sham


class WireCommand(NamedTuple):
    """Command as on the wire: absolute key, payload and signature."""

    key: str
    payload: bytes
    signature: bytes | None


@fault(
    "A34", how=f"{TLS}: by a session with the router's certificate, unsigned, signed by itself, changed and repeated"
)
async def taken_over_router(lab: Lab) -> Evidence:
    """Forged commands are refused; one that the person has signed is accepted once, and Stop always."""
    async with reachable_cell(lab) as open_cell:
        with await asyncio.to_thread(open_session, open_cell.settings(ROUTER)) as thief:
            async with unmoved(open_cell):
                reasons = {
                    "unsigned": await _rejection_reason(thief, _command(open_cell, "lease/take_over", None)),
                    "by the router": await _rejection_reason(thief, _command(open_cell, "lease/take_over", ROUTER)),
                }
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
            stopped = await _answer(thief, WireCommand(_absolute(open_cell, f"stop/{CARRIED}"), b"", None))
            expect(unpack(stopped, Stopping).source == f"bus:{CARRIED}", "Stop was not honoured.")
    expected = {
        "unsigned": "unsigned", "by the router": "certificate", "repeated": "repeated",
        "for another command": "forged", "changed": "forged",
    }  # fmt: skip
    expect(reasons == expected, f"The reasons were {reasons}.")
    return Evidence(
        "refused; Stop honoured",
        took_place={"answered_by_the_daemon": reasons},
        control_kind="permitted",
        control={"signed_by_the_person": control.decision},
    )


def _absolute(open_cell: ReachableCell, key: str) -> str:
    return f"{open_cell.cell.ready.prefix}/{key}"


def _command(open_cell: ReachableCell, name: str, signer: str | None) -> WireCommand:
    """Return a command of the carried person, with somebody's signature."""
    key, payload, clock = _absolute(open_cell, f"cmd/{CARRIED}/{name}"), pack(Envelope(id=name)), SystemClock()
    if signer is None:
        return WireCommand(key, payload, None)
    return WireCommand(
        key, payload, CertificateSigner.read(open_cell.people.credentials(signer), clock).sign("query", key, payload)
    )


async def _rejection_reason(session: zenoh.Session, sent: WireCommand) -> str:
    """Return the reason why a command is refused; empty in a sham campaign, where it is not sent."""
    if is_sham():
        return ""
    verdict = await _request(session, sent)
    reason = verdict.reason
    expect(verdict.decision == "rejected" and reason is not None, f"{sent.key} was {verdict.decision}.")
    return "" if reason is None else str(reason.fields.get("why", reason.code))


async def _request(session: zenoh.Session, sent: WireCommand) -> Verdict:
    return unpack(await _answer(session, sent), Verdict)


async def _answer(session: zenoh.Session, sent: WireCommand) -> bytes:
    def ask() -> list[bytes]:
        replies = session.get(sent.key, payload=sent.payload, attachment=sent.signature, timeout=PATIENCE)
        return [reply.result.payload.to_bytes() for reply in replies]

    answers = await asyncio.to_thread(ask)
    expect(len(answers) == 1, f"{sent.key} had {len(answers)} answers.")
    return answers[0]
