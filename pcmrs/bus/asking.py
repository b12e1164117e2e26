"""One request and its reply, or the knowledge that there is none."""

from __future__ import annotations

import asyncio
from concurrent.futures import Executor
from functools import partial

import zenoh

from pcmrs.bus.qos import DataClass
from pcmrs.bus.reasons import error_from
from pcmrs.errors import PcmrsError, UnknownOutcomeError


async def ask(
    session: zenoh.Session, pool: Executor, key: str, payload: bytes, timeout: float, data: DataClass
) -> bytes:
    """Sends a query and returns the payload of its first reply.

    A caller that is cancelled before the query was sent recalls it; afterwards nobody can.

    Args:
        session: Through which to ask.
        pool: Sends the query, since a link whose queue is full blocks its sender; one with a single thread keeps the
            order of its queries.
        key: Absolute key.
        payload: The request.
        timeout: Seconds of the machine.
        data: In which of the link's queues it waits.

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
        loop.call_soon_threadsafe(settle, _outcome(reply))

    def on_end() -> None:
        loop.call_soon_threadsafe(settle, _silence(key, timeout))

    send = partial(
        session.get,
        key,
        zenoh.handlers.Callback(on_reply, on_end, indirect=False),
        timeout=timeout,
        payload=payload,
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


def _silence(key: str, timeout: float) -> UnknownOutcomeError:
    return UnknownOutcomeError(
        f"Nobody answered on {key} within {timeout:g} s, or the answering process ended first: "
        "it may have happened or not. Look at the state before asking again. "
        "(From elsewhere, what your role may not ask for is dropped on the way.)",
        key=key,
        timeout=timeout,
    )
