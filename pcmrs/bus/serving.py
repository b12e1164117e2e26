"""Answering requests: each in a task of its own, within the life of its query."""

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
from pcmrs.bus.bridge import CAPACITY, Call
from pcmrs.bus.codec import busy, is_text, pack, pack_text, reason_from, unpack
from pcmrs.bus.keys import named_in
from pcmrs.bus.seal import Kind, Seal, Taken
from pcmrs.bus.turns import WAITING, Turns
from pcmrs.errors import AccessError, PayloadError, PcmrsError, SealError

if TYPE_CHECKING:
    from pcmrs.bus.signature import Signatures

T = TypeVar("T")

Refuse = Callable[[str, PcmrsError], msgspec.Struct]
"""Makes the reply to a request that never reaches its handler, from its relative key and the error."""

ANSWERS: Final = 256
"""Requests that a process answers at the same time; one more is refused."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Service(Generic[T]):
    """One served key expression.

    Attributes:
        key: The relative key expression served.
        prefix: What stands before relative keys.
        kind: Type of the requests.
        handler: Makes the reply from relative key and request.
        refuse: Makes the reply to a malformed, excess or unsigned request; None for an error reply.
        post: Runs a call in the event loop, or returns False when too many wait.
        turns: Starts requests that only read, in turn; None for those that are started as they come.
        tasks: Owns the running answers.
        pool: Sends replies, since a link whose queue is full blocks its sender.
        seal: Of requests and replies on this key; None where they are not sealed.
        signatures: Checks requests on this key; None where they are not signed.
    """

    key: str
    prefix: str
    kind: type[T]
    handler: Callable[[str, T], Awaitable[msgspec.Struct]]
    refuse: Refuse | None
    post: Callable[[Call], bool]
    turns: Turns | None
    tasks: BackgroundTasks
    pool: Executor
    seal: Seal | None = None
    signatures: Signatures | None = None
    _taken: Taken = field(default_factory=Taken)

    def receive(self, query: zenoh.Query) -> None:
        """Takes a query in Zenoh's thread: on its way into the loop, or refused at once."""
        key = self._relative(query)
        if "*" in key:
            self._send(query, key, PayloadError(f"{key} holds a wildcard; ask on one key.", key=key))
        elif (unsealed := self._unsealed(query)) is not None:
            self._send(query, key, unsealed)
        elif self.turns is not None:
            if not self.turns.post(str(query.key_expr), partial(self._serve, query, key)):
                self._send(query, key, self._refusal(key, busy(WAITING)))
        elif not self.post(partial(self._start, query, key, self._objection(query, key))):
            self._send(query, key, self._refusal(key, busy(CAPACITY)))

    def _unsealed(self, query: zenoh.Query) -> SealError | None:
        """Why a query that must be sealed is not answered: device nodes serve their daemon and nobody else."""
        if self.seal is None:
            return None
        try:
            self.seal.check(attached_to(query), ("query",), str(query.key_expr), payload_of(query), self._taken)
        except SealError as error:
            return error
        return None

    def _objection(self, query: zenoh.Query, key: str) -> AccessError | None:
        """Why a query that must be signed is not answered. In Zenoh's thread: forged ones keep no loop busy."""
        if self.signatures is None:
            return None
        absolute, payload = str(query.key_expr), payload_of(query)
        return self.signatures.objection(attached_to(query), "query", named_in(key), absolute, payload)

    def _relative(self, query: zenoh.Query) -> str:
        """A query with wildcards, such as ``svc/*``, means the served key when that has none."""
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
            # Dropped without a reply: the asker learns that the outcome is unknown.
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
    """The bytes of a query or sample; none at all is an empty payload."""
    return received.payload.to_bytes() if received.payload is not None else b""


def attached_to(received: zenoh.Query | zenoh.Sample) -> bytes:
    """The seal or signature of a query or sample; empty when it has none."""
    return received.attachment.to_bytes() if received.attachment is not None else b""
