"""The requesting side of a query: one request, and its reply or the error that none came."""

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
from pcmrs.bus.seal import Kind, ReplayWindow, Seal
from pcmrs.bus.serving import attached_to, payload_of
from pcmrs.errors import PcmrsError, SealError, UnknownOutcomeError

_TIMEOUT: Final = b"Timeout"
"""Payload of the error with which Zenoh itself ends a query at its limit."""
TO_ALL_SERVERS: Final[dict[str, Any]] = {
    # By default Zenoh sends a query to one server of the key and merges replies on one key into the last one.
    "target": zenoh.QueryTarget.ALL,
    "consolidation": zenoh.ConsolidationMode.NONE,
}
"""Options of a query that goes to every process that serves its key, and whose replies all arrive."""


@dataclass(frozen=True, slots=True)
class ReplyCheck:
    """Check of the replies to sealed queries of one process.

    Attributes:
        seal: Seal that daemon and device nodes share.
        taken: Replies that were accepted before; a repeated one is rejected.
        on_forged: Called in Zenoh's thread with the absolute key and the error of a reply that is rejected.
    """

    seal: Seal
    taken: ReplayWindow
    on_forged: Callable[[str, SealError], object]


async def send_query(
    session: zenoh.Session,
    pool: Executor,
    key: str,
    payload: bytes,
    timeout: float,
    data: DataClass,
    attachment: bytes | None = None,
    check: ReplyCheck | None = None,
) -> bytes:
    """Send a query and return the payload of its first reply.

    A sealed query goes to every process that serves the key, and only a sealed reply counts. So another process that
    serves the same key can neither keep the query from the device nor answer in its place.

    Cancelling the caller recalls the query only while it has not been sent.

    Args:
        session: Session that sends the query.
        pool: Threads that send it, because a link with a full queue blocks its sender. A pool with one thread keeps
            the order of its queries.
        key: Absolute key.
        payload: Encoded request.
        timeout: Longest wait for the reply, s of the machine.
        data: Class of data: selects the queue of the link.
        attachment: Seal or signature of the query; None for a query that needs none.
        check: Check of the reply; None for a query that is not sealed.

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
        if reply.err is not None and reply.err.payload.to_bytes() == _TIMEOUT:
            return  # of the bus itself; `on_end` follows
        try:
            outcome = _outcome(reply) if check is None else _checked_outcome(reply, check, key, attachment)
        except SealError as error:
            if check is not None:
                check.on_forged(key, error)
        else:
            loop.call_soon_threadsafe(settle, outcome)

    def on_end() -> None:
        loop.call_soon_threadsafe(settle, _no_reply(key, timeout))

    send = partial(
        session.get,
        key,
        zenoh.handlers.Callback(on_reply, on_end, indirect=False),
        timeout=timeout,
        payload=payload,
        attachment=attachment,
        **({} if check is None else TO_ALL_SERVERS),
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


def _checked_outcome(reply: zenoh.Reply, check: ReplyCheck, key: str, query: bytes | None) -> bytes | PcmrsError:
    """Return the outcome in a sealed reply. Raises `SealError`."""
    result = reply.result
    if not isinstance(result, zenoh.Sample):
        raise SealError(f"{key}: an error reply carries no seal and is rejected.", why="unsealed")
    payload = payload_of(result)
    kinds: tuple[Kind, ...] = ("reply", "error")
    kind = check.seal.check(attached_to(result), kinds, str(result.key_expr), payload, check.taken, query or b"")
    return payload if kind == "reply" else error_from(payload)


def _no_reply(key: str, timeout: float) -> UnknownOutcomeError:
    return UnknownOutcomeError(
        f"No process answered on {key} within {timeout:g} s, or the answering process ended first: "
        "the request may or may not have been carried out. Look at the state before you ask again. "
        "(Over a network, requests that your role may not send are dropped on the way.)",
        key=key,
        timeout=timeout,
    )
