"""What workflows that treat ask for: a word before the first motion, and the treatment after the last placement."""

from __future__ import annotations

from typing import Any

import msgspec

from pcmrs.client import Client
from pcmrs.errors import CommandRefusedError

CONFIRMED = {"surgeon": "simulated surgeon"}
"""Stands for the surgeon's own confirmation, and says so in the journal."""

Asked = tuple[tuple[str, dict[str, str]], ...]
"""Operations and their arguments, in order."""

PREPARATIONS: dict[str, Asked] = {"femoroplasty": (("treatment.confirm_clear", CONFIRMED),)}

TREATMENTS: dict[str, Asked] = {
    "femoroplasty": (
        ("treatment.start_drilling", CONFIRMED),
        ("treatment.confirm_drilled", CONFIRMED),
        ("treatment.check_guide", {}),
        ("treatment.start_injection", CONFIRMED),
        ("treatment.confirm_injected", CONFIRMED),
    ),
}


class Treated(msgspec.Struct, frozen=True):
    """One accepted operation, the state it led to, and what it has on record."""

    operation: str
    state: str
    result: dict[str, Any]


async def prepare(client: Client, workflow: str) -> list[Treated]:
    """Says what the workflow must hear before the robot may move; where it need not hear anything, does nothing.

    Raises:
        CommandRefusedError: An operation was not accepted.
    """
    return await _ask(client, PREPARATIONS.get(workflow, ()))


async def treat(client: Client, workflow: str) -> list[Treated]:
    """Treats with the tool where it is, as the workflow has it; where it has nothing, does nothing.

    Raises:
        CommandRefusedError: An operation was not accepted.
    """
    return await _ask(client, TREATMENTS.get(workflow, ()))


async def _ask(client: Client, asked: Asked) -> list[Treated]:
    done = []
    for operation, arguments in asked:
        verdict = await client.call(operation, arguments)
        if verdict.decision != "accepted":
            reason = verdict.reason.text if verdict.reason is not None else verdict.decision
            raise CommandRefusedError(f"{operation} was {verdict.decision} in {verdict.state}: {reason}")
        done.append(Treated(operation, verdict.state, verdict.result or {}))
    return done
