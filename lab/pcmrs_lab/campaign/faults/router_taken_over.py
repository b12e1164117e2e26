"""Somebody who has taken over a router speaks for the people whom it carries."""

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
    """A command as it is on the wire: absolute key, payload and signature."""

    key: str
    payload: bytes
    signature: bytes | None


@fault(
    "A34", how=f"{TLS}: by a session with the router's certificate, unsigned, signed by itself, changed and repeated"
)
async def taken_over_router(lab: Lab) -> Evidence:
    """All of it is refused; what the person has signed is taken from the same session, once, and Stop always."""
    async with reachable_cell(lab) as open_cell:
        with await asyncio.to_thread(open_session, open_cell.settings(ROUTER)) as thief:
            async with unmoved(open_cell):
                why = {
                    "unsigned": await _why(thief, _command(open_cell, "lease/take_over", None)),
                    "by the router": await _why(thief, _command(open_cell, "lease/take_over", ROUTER)),
                }
            own = _command(open_cell, "lease/acquire", CARRIED)
            control = await _asked(thief, own)
            expect(control.decision == "accepted", f"What {CARRIED} has signed was {control.decision}.")
            async with unmoved(open_cell):
                why["repeated"] = await _why(thief, own)
                other = _command(open_cell, "registration/reinit", CARRIED)
                why["for another command"] = await _why(thief, own._replace(key=other.key))
                why["changed"] = await _why(thief, own._replace(payload=other.payload))
            control = await _asked(thief, other)
            expect(control.decision == "accepted", f"What {CARRIED} has signed was {control.decision}.")
            stopped = await _answer(thief, WireCommand(_absolute(open_cell, f"stop/{CARRIED}"), b"", None))
            expect(unpack(stopped, Stopping).source == f"bus:{CARRIED}", "Stop was not honoured.")
    expected = {
        "unsigned": "unsigned", "by the router": "certificate", "repeated": "repeated",
        "for another command": "forged", "changed": "forged",
    }  # fmt: skip
    expect(why == expected, f"It was refused otherwise: {why}.")
    return Evidence(
        "refused; Stop honoured",
        took_place={"answered_by_the_daemon": why},
        control={"signed_by_the_person": control.decision},
    )


def _absolute(open_cell: ReachableCell, key: str) -> str:
    return f"{open_cell.cell.ready.prefix}/{key}"


def _command(open_cell: ReachableCell, name: str, signer: str | None) -> WireCommand:
    """A command of the carried person, signed by somebody."""
    key, payload, clock = _absolute(open_cell, f"cmd/{CARRIED}/{name}"), pack(Envelope(id=name)), SystemClock()
    if signer is None:
        return WireCommand(key, payload, None)
    return WireCommand(
        key, payload, CertificateSigner.read(open_cell.people.credentials(signer), clock).sign("query", key, payload)
    )


async def _why(session: zenoh.Session, sent: WireCommand) -> str:
    """Why a command is refused; nothing in a sham campaign, where it is not sent."""
    if is_sham():
        return ""
    verdict = await _asked(session, sent)
    reason = verdict.reason
    expect(verdict.decision == "rejected" and reason is not None, f"{sent.key} was {verdict.decision}.")
    return "" if reason is None else str(reason.fields.get("why", reason.code))


async def _asked(session: zenoh.Session, sent: WireCommand) -> Verdict:
    return unpack(await _answer(session, sent), Verdict)


async def _answer(session: zenoh.Session, sent: WireCommand) -> bytes:
    def ask() -> list[bytes]:
        replies = session.get(sent.key, payload=sent.payload, attachment=sent.signature, timeout=PATIENCE)
        return [reply.result.payload.to_bytes() for reply in replies]

    answers = await asyncio.to_thread(ask)
    expect(len(answers) == 1, f"{sent.key} had {len(answers)} answers.")
    return answers[0]
