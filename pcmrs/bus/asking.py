"""One request and its reply, or the knowledge that there is none."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import zenoh

from pcmrs.bus.codec import error_from
from pcmrs.bus.qos import DataClass
from pcmrs.bus.seal import Kind, Seal, Taken
from pcmrs.bus.serving import attached_to, payload_of
from pcmrs.errors import PcmrsError, SealError, UnknownOutcomeError

_TO_EVERYBODY: Final[dict[str, Any]] = {
    # By default a query goes to one of those who serve the key, and replies on one key are merged into the last one.
    "target": zenoh.QueryTarget.ALL,
    "consolidation": zenoh.ConsolidationMode.NONE,
}


@dataclass(frozen=True, slots=True)
class Sealing:
    """How replies to the sealed queries of a process are checked.

    Attributes:
        seal: Of daemon and device nodes.
        taken: Replies so far.
        forged: Called in Zenoh's thread with the key and the error of a reply that is not taken.
    """

    seal: Seal
    taken: Taken
    forged: Callable[[str, SealError], object]


async def ask(
    session: zenoh.Session,
    pool: Executor,
    key: str,
    payload: bytes,
    timeout: float,
    data: DataClass,
    attachment: bytes | None = None,
    sealing: Sealing | None = None,
) -> bytes:
    """Sends a query and returns the payload of its first reply.

    A sealed query goes to everybody who serves the key, and only a sealed reply counts: who else serves it can neither
    keep the query from the device nor answer in its place.

    A caller that is cancelled before the query was sent recalls it; afterwards nobody can.

    Args:
        session: Through which to ask.
        pool: Sends the query, since a link whose queue is full blocks its sender; one with a single thread keeps the
            order of its queries.
        key: Absolute key.
        payload: The request.
        timeout: Seconds of the machine.
        data: In which of the link's queues it waits.
        attachment: Seal or signature of the query; None for a query that needs none.
        sealing: For a query that is sealed.

    Raises:
        UnknownOutcomeError: The query ended without a reply.
        DeviceError: The reply is an error.
    """
    loop = asyncio.get_running_loop()
    answered: asyncio.Future[bytes | PcmrsError] = loop.create_future()

    def settle(outcome: bytes | PcmrsError) -> None:
        if not answered.done():
            answered.set_result(outcome)

    def on_reply(reply: zenoh.Reply) -> None:
        try:
            outcome = _outcome(reply) if sealing is None else _authentic(reply, sealing, key, attachment)
        except SealError as error:
            if sealing is not None:
                sealing.forged(key, error)
        else:
            loop.call_soon_threadsafe(settle, outcome)

    def on_end() -> None:
        loop.call_soon_threadsafe(settle, _silence(key, timeout))

    send = partial(
        session.get,
        key,
        zenoh.handlers.Callback(on_reply, on_end, indirect=False),
        timeout=timeout,
        payload=payload,
        attachment=attachment,
        **({} if sealing is None else _TO_EVERYBODY),
        congestion_control=zenoh.CongestionControl.BLOCK,
        priority=data.priority,
        express=data.express,
    )
    await loop.run_in_executor(pool, send)
    outcome = await answered
    if isinstance(outcome, PcmrsError):
        raise outcome
    return outcome


def _outcome(reply: zenoh.Reply) -> bytes | PcmrsError:
    result = reply.result
    payload = result.payload.to_bytes()
    return payload if isinstance(result, zenoh.Sample) else error_from(payload)


def _authentic(reply: zenoh.Reply, sealing: Sealing, key: str, query: bytes | None) -> bytes | PcmrsError:
    """The outcome that a sealed reply tells. Raises `SealError`."""
    result = reply.result
    if not isinstance(result, zenoh.Sample):
        raise SealError(f"{key}: an error reply carries no seal and is not taken.", why="unsealed")
    payload = payload_of(result)
    answers: tuple[Kind, ...] = ("reply", "error")
    kind = sealing.seal.check(attached_to(result), answers, str(result.key_expr), payload, sealing.taken, query or b"")
    return payload if kind == "reply" else error_from(payload)


def _silence(key: str, timeout: float) -> UnknownOutcomeError:
    return UnknownOutcomeError(
        f"Nobody answered on {key} within {timeout:g} s, or the answering process ended first: "
        "it may have happened or not. Look at the state before asking again. "
        "(From elsewhere, what your role may not ask for is dropped on the way.)",
        key=key,
        timeout=timeout,
    )
