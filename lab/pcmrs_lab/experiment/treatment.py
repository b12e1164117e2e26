"""Operations of workflows that treat: confirmation before the first motion, treatment after the last placement."""

from __future__ import annotations

from typing import Any

import msgspec

from pcmrs.client import Client
from pcmrs.errors import CommandRefusedError

CONFIRMED = {"surgeon": "simulated surgeon"}
"""Confirmation in place of the surgeon's; its name shows that in the journal."""

OperationList = tuple[tuple[str, dict[str, str]], ...]
"""Operations and their arguments, in order."""

PREPARATIONS: dict[str, OperationList] = {"femoroplasty": (("treatment.confirm_clear", CONFIRMED),)}

TREATMENTS: dict[str, OperationList] = {
    "femoroplasty": (
        ("treatment.start_drilling", CONFIRMED),
        ("treatment.confirm_drilled", CONFIRMED),
        ("treatment.check_guide", {}),
        ("treatment.start_injection", CONFIRMED),
        ("treatment.confirm_injected", CONFIRMED),
    ),
}


class Treated(msgspec.Struct, frozen=True):
    """Accepted operation, the state that it led to, and its journalled result."""

    operation: str
    state: str
    result: dict[str, Any]


async def prepare(client: Client, workflow: str) -> list[Treated]:
    """Perform the operations that a workflow requires before the robot may move; do nothing if there are none.

    Args:
        client: Client of the daemon.
        workflow: Name of the workflow.

    Returns:
        Accepted operations.

    Raises:
        CommandRefusedError: An operation was not accepted.
    """
    return await _perform(client, PREPARATIONS.get(workflow, ()))


async def treat(client: Client, workflow: str) -> list[Treated]:
    """Perform the treatment of a workflow with the tool at its place; do nothing if there is none.

    Args:
        client: Client of the daemon.
        workflow: Name of the workflow.

    Returns:
        Accepted operations.

    Raises:
        CommandRefusedError: An operation was not accepted.
    """
    return await _perform(client, TREATMENTS.get(workflow, ()))


async def _perform(client: Client, requested: OperationList) -> list[Treated]:
    done = []
    for operation, arguments in requested:
        verdict = await client.call(operation, arguments)
        if verdict.decision != "accepted":
            reason = verdict.reason.text if verdict.reason is not None else verdict.decision
            raise CommandRefusedError(f"{operation} was {verdict.decision} in {verdict.state}: {reason}")
        done.append(Treated(operation, verdict.state, verdict.result or {}))
    return done
