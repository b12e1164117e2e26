"""The serving side of a query: each request is answered in its own task, within the lifetime of its query."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from concurrent.futures import Executor
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Final, Generic, TypeVar

import msgspec
import zenoh

from pcmrs.background import BackgroundTasks
from pcmrs.bus._round_robin import WAITING, RoundRobin
from pcmrs.bus.bridge import CAPACITY, BridgedCall
from pcmrs.bus.codec import busy, is_text, pack, pack_text, reason_from, unpack
from pcmrs.bus.keys import named_in
from pcmrs.bus.seal import Kind, ReplayWindow, Seal
from pcmrs.errors import AccessError, PayloadError, PcmrsError, SealError

if TYPE_CHECKING:
    from pcmrs.bus.signature import SignatureVerifier

T = TypeVar("T")

Refuse = Callable[[str, PcmrsError], msgspec.Struct]
"""Returns the reply to a request that never reaches its handler, from its relative key and the error."""

ANSWERS: Final = 256
"""Number of requests that a process answers at the same time; one more is refused."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Service(Generic[T]):
    """One served key expression.

    Attributes:
        key: Relative key expression that is served.
        prefix: Prefix of relative keys.
        kind: Type of the requests.
        handler: Returns the reply from relative key and request.
        refuse: Returns the reply to a malformed, excess or unsigned request; None for an error reply.
        post: Runs a call in the event loop, or returns False if too many wait.
        turns: Starts requests that only read, in turn; None to start each request as it arrives.
        tasks: Owner of the running answers.
        pool: Threads that send replies, because a link with a full queue blocks its sender.
        seal: Seal of requests and replies on this key; None where they are not sealed.
        ask_run: Asks the daemon for its run, then calls a function; returns False if too many wait. None where requests
            are not sealed.
        verifier: Verifier of requests on this key; None where they are not signed.
    """

    key: str
    prefix: str
    kind: type[T]
    handler: Callable[[str, T], Awaitable[msgspec.Struct]]
    refuse: Refuse | None
    post: Callable[[BridgedCall], bool]
    turns: RoundRobin | None
    tasks: BackgroundTasks
    pool: Executor
    seal: Seal | None = None
    ask_run: Callable[[BridgedCall], bool] | None = None
    verifier: SignatureVerifier | None = None
    _taken: ReplayWindow = field(default_factory=ReplayWindow)

    def receive(self, query: zenoh.Query, *, asked: bool = False) -> None:
        """Take a query in Zenoh's thread: hand it over to the loop, or refuse it at once.

        The first request of a daemon that was restarted waits until its run is confirmed.

        Args:
            query: The query.
            asked: True if the daemon was asked for its run since the query arrived.
        """
        key = self._relative(query)
        if "*" in key:
            self._send(query, key, PayloadError(f"{key} holds a wildcard; send the request on one key.", key=key))
        elif (unsealed := self._unsealed(query)) is not None:
            again = partial(self.receive, query, asked=True)
            if asked or unsealed.fields["why"] != "other_run" or self.ask_run is None or not self.ask_run(again):
                self._send(query, key, unsealed)
        elif self.turns is not None:
            if not self.turns.post(str(query.key_expr), partial(self._serve, query, key)):
                self._send(query, key, self._refusal(key, busy(WAITING)))
        elif not self.post(partial(self._start, query, key, self._objection(query, key))):
            self._send(query, key, self._refusal(key, busy(CAPACITY)))

    def _unsealed(self, query: zenoh.Query) -> SealError | None:
        """Return why a query that must be sealed is not answered: device nodes serve only their daemon."""
        if self.seal is None:
            return None
        try:
            self.seal.check(attached_to(query), ("query",), str(query.key_expr), payload_of(query), self._taken)
        except SealError as error:
            return error
        return None

    def _objection(self, query: zenoh.Query, key: str) -> AccessError | None:
        """Return why a query that must be signed is not answered.

        Runs in Zenoh's thread, so that forged queries do not load the event loop.
        """
        if self.verifier is None:
            return None
        absolute, payload = str(query.key_expr), payload_of(query)
        return self.verifier.objection(attached_to(query), "query", named_in(key), absolute, payload)

    def _relative(self, query: zenoh.Query) -> str:
        """Return the relative key of a query; one with wildcards, such as ``svc/*``, means the served key."""
        return str(query.key_expr).removeprefix(f"{self.prefix}/") if "*" in self.key else self.key

    def _start(self, query: zenoh.Query, key: str, objection: AccessError | None) -> None:
        error = objection or (busy(ANSWERS) if len(self.tasks) >= ANSWERS else None)
        if error is None:
            self._serve(query, key)
        else:
            self.pool.submit(self._send, query, key, self._refusal(key, error))

    def _serve(self, query: zenoh.Query, key: str) -> asyncio.Task[None]:
        return self.tasks.spawn(self._answer(query, key))

    async def _answer(self, query: zenoh.Query, key: str) -> None:
        try:
            reply = await self._reply(payload_of(query), key)
        except asyncio.CancelledError:
            # Dropped without a reply: to the sender of the request the outcome is unknown.
            with query:
                raise
        await asyncio.get_running_loop().run_in_executor(self.pool, self._send, query, key, reply)

    async def _reply(self, payload: bytes, key: str) -> msgspec.Struct | PcmrsError:
        try:
            message = unpack(payload, self.kind)
        except PayloadError as error:
            return self._refusal(key, error)
        try:
            return await self.handler(key, message)
        except PcmrsError as error:
            return error
        except Exception as error:
            _log.exception("The handler of %s failed", key)
            return PcmrsError(f"{key} failed with {type(error).__name__}: {error}. See the log of its process.")

    def _refusal(self, key: str, error: PcmrsError) -> msgspec.Struct | PcmrsError:
        return error if self.refuse is None else self.refuse(key, error)

    def _send(self, query: zenoh.Query, key: str, reply: msgspec.Struct | PcmrsError) -> None:
        encode = pack_text if is_text(payload_of(query)) else pack
        with query:
            try:
                if not isinstance(reply, PcmrsError):
                    self._put(query, key, "reply", encode(reply))
                    return
            except PayloadError as error:
                _log.exception("The reply of %s cannot be sent", key)
                reply = error
            if self.seal is not None and not isinstance(reply, SealError):
                self._put(query, key, "error", encode(reason_from(reply)))  # an error reply can carry no seal
            else:
                query.reply_err(encode(reason_from(reply)))

    def _put(self, query: zenoh.Query, key: str, kind: Kind, payload: bytes) -> None:
        absolute, sealed = f"{self.prefix}/{key}", None
        if self.seal is not None:
            sealed = self.seal.put(kind, absolute, payload, attached_to(query))
        query.reply(absolute, payload, attachment=sealed)


def payload_of(received: zenoh.Query | zenoh.Sample) -> bytes:
    """Return the payload of a query or sample; empty if there is none."""
    return received.payload.to_bytes() if received.payload is not None else b""


def attached_to(received: zenoh.Query | zenoh.Sample) -> bytes:
    """Return the seal or signature of a query or sample; empty if there is none."""
    return received.attachment.to_bytes() if received.attachment is not None else b""
