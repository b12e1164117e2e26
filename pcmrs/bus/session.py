"""The bus of one process: publish, subscribe, serve, request, in the event loop and never blocking it."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import msgspec
import zenoh
from zenoh import Locality, ext

from pcmrs.background import BackgroundTasks
from pcmrs.bus.asking import Sealing, ask
from pcmrs.bus.bridge import CAPACITY, Bridge
from pcmrs.bus.codec import busy, pack, unpack
from pcmrs.bus.declare import declare_publisher, declare_subscriber
from pcmrs.bus.ignored import Ignored
from pcmrs.bus.keys import cell_prefix, is_signed, named_in
from pcmrs.bus.qos import COMMANDS, REQUESTS, class_of
from pcmrs.bus.seal import Seal, Taken, is_sealed
from pcmrs.bus.serving import Refuse, Service, attached_to, payload_of
from pcmrs.bus.settings import BusSettings, open_session
from pcmrs.bus.turns import AT_ONCE, Turns
from pcmrs.clock import SystemClock
from pcmrs.errors import AccessError, PayloadError, PcmrsError, SealError
from pcmrs.messages.identity import LOCAL

if TYPE_CHECKING:
    from pcmrs.bus.signature import Signatures, Signer

T = TypeVar("T")


class Bus:
    """One process on the bus of a cell. Keys are relative to the cell, such as ``state/joints``.

    A process does not hear itself: its own messages and requests reach other processes only.
    Use `Bus.open`; all methods but `publish` belong to the event loop that opened it.
    """

    def __init__(
        self,
        session: zenoh.Session,
        settings: BusSettings,
        seal: Seal | None = None,
        signer: Signer | None = None,
        signatures: Signatures | None = None,
    ) -> None:
        self.settings = settings
        self._seal = seal
        self._signer = signer
        self._signatures = signatures
        self._replies = Taken()
        self.prefix = cell_prefix(settings.site, settings.cell)
        self._session = session
        self._loop = asyncio.get_running_loop()
        self._bridge = Bridge(self._loop)
        self._turns = Turns(self._loop)
        self._ignored = Ignored()
        self._not_sealed = 0
        self._pool = ThreadPoolExecutor(4, thread_name_prefix="pcmrs-bus")
        # A long reply to somebody who does not read it blocks its thread: commands are not answered by the same ones.
        self._reading_pool = ThreadPoolExecutor(AT_ONCE, thread_name_prefix="pcmrs-bus-read")
        self._senders: dict[str, ThreadPoolExecutor] = {}
        self._publishers: dict[str, zenoh.Publisher | ext.AdvancedPublisher] = {}
        self._declaring = threading.Lock()
        self._receivers: list[Any] = []
        self._tokens: list[zenoh.LivelinessToken] = []
        self._tasks = BackgroundTasks()

    @classmethod
    async def open(cls, settings: BusSettings, seal: Seal | None = None) -> Bus:
        """Opens the session. Who has a certificate signs with it; a daemon with a register checks signatures.

        Args:
            settings: Where and as whom.
            seal: Of daemon and device nodes, which seal what they send each other and take nothing unsealed. Others
                have none: they read such messages and can send none.

        Raises:
            BusError: The endpoint is taken (``router``) or nobody answers there (``client``).
            ConfigurationError: Certificate or key cannot be read.
            PayloadError: The site's or cell's name cannot be a part of a key.
        """
        cell_prefix(settings.site, settings.cell)
        signing = _signing(settings)
        session = await asyncio.get_running_loop().run_in_executor(None, open_session, settings)
        return cls(session, settings, seal, *signing)

    def publish(self, key: str, message: Any) -> None:
        """Sends a message to all subscribers of `key`; drops it rather than wait for the link. From any thread.

        Raises:
            PayloadError: The message holds a value that cannot be sent.
        """
        payload = pack(message)
        self._publisher(key).put(payload, attachment=self._attached("put", key, payload))

    def publish_cdr(self, key: str, payload: bytes) -> None:
        """The same for a message that is CDR already, as ROS 2 has it."""
        self._publisher(key).put(payload, encoding=zenoh.Encoding.APPLICATION_CDR)

    def subscribe(
        self,
        key: str,
        kind: type[T],
        handler: Callable[[str, T], None],
        refuse: Callable[[str, PcmrsError], object] | None = None,
    ) -> Any:
        """Calls `handler(relative key, message)` for every message on the key expression `key`.

        Of streams only the newest unread messages of a key are delivered; see `qos.DataClass`.

        Args:
            key: Relative key expression; may hold wildcards.
            kind: Type of the messages; an empty payload is one without fields.
            handler: Runs in the event loop and returns soon.
            refuse: Called in place of `handler` for a message that is malformed, not signed as it must be, or one too
                many; without it, that is counted, and logged once a second. It may run in any thread.

        Returns:
            A coroutine function without parameters that ends the subscription; closing the bus does it too.
        """
        return self.hear(key, lambda payload: unpack(payload, kind), handler, refuse)

    def hear(
        self,
        key: str,
        decode: Callable[[bytes], T],
        handler: Callable[[str, T], None],
        refuse: Callable[[str, PcmrsError], object] | None = None,
    ) -> Any:
        """`subscribe` to messages of another encoding: `decode` makes them, or raises `PayloadError`."""
        data, taken = class_of(key), Taken()
        refuse = refuse or self._ignored.take

        def deliver(sample: zenoh.Sample) -> None:
            received = self._relative(sample)
            try:
                message = decode(payload_of(sample))
            except PayloadError as error:
                refuse(received, error)
            else:
                handler(received, message)

        def receive(sample: zenoh.Sample) -> None:
            if not self._is_authentic(sample, taken):
                return
            objection = self._objection(sample)
            call: Callable[[], object] = partial(deliver, sample)
            if objection is not None:
                call = partial(refuse, self._relative(sample), objection)
            if data.newest:
                stream = (deliver, str(sample.key_expr), objection is None)  # a forged message replaces no other
                self._bridge.post_newest(stream, call, data.newest)
            elif not self._bridge.post(call, urgent=data.urgent):
                # Here, not in the loop: nobody may keep that busy with what it has no time for.
                refuse(self._relative(sample), busy(CAPACITY))

        subscriber = declare_subscriber(self._session, self._absolute(key), data, receive)
        self._receivers.append(subscriber)
        return partial(self._end, subscriber)

    def ignore(self, key: str, error: PcmrsError) -> None:
        """Counts a message that is of no use, and logs it unless another was logged just now. From any thread."""
        self._ignored.take(key, error)

    def listen(self, key: str, kind: type[T], handler: Callable[[str, T], None]) -> Any:
        """Calls `handler(relative key, message)` in Zenoh's thread, where the message is received.

        For what must not wait for the event loop, such as the moment at which a heartbeat came. `handler` returns soon.
        """
        taken = Taken()

        def take(sample: zenoh.Sample) -> None:
            if not self._is_authentic(sample, taken):
                return
            received = self._relative(sample)
            try:
                handler(received, unpack(payload_of(sample), kind))
            except PayloadError as error:
                self._ignored.take(received, error)

        subscriber = declare_subscriber(self._session, self._absolute(key), class_of(key), take)
        self._receivers.append(subscriber)
        return partial(self._end, subscriber)

    def serve(
        self,
        key: str,
        kind: type[T],
        handler: Callable[[str, T], Awaitable[msgspec.Struct]],
        refuse: Refuse | None = None,
        *,
        reading: bool = False,
    ) -> Any:
        """Answers requests on the key expression `key`, each in a task of its own.

        A request in JSON text, or without payload, is answered in JSON text. A `PcmrsError` from `handler`
        becomes an error reply, which `request` raises at the other end.

        Args:
            key: Relative key expression; may hold wildcards.
            kind: Type of the requests.
            handler: Makes the reply from relative key and request.
            refuse: Makes the reply to a request that is malformed, not signed as it must be, or one too many; without
                it, that is an error reply. It may run in any thread.
            reading: The requests only read: all such requests of this process are answered a few at a time, those of
                all keys in turn, so that they leave the loop to what acts.

        Returns:
            A coroutine function without parameters that takes no more requests; closing the bus does it too.
        """
        service = Service(
            key=key,
            prefix=self.prefix,
            kind=kind,
            handler=handler,
            refuse=refuse,
            post=self._bridge.post,
            turns=self._turns if reading else None,
            tasks=self._tasks,
            pool=self._reading_pool if reading else self._pool,
            seal=self._seal if is_sealed(key) else None,
            signatures=self._signatures if is_signed(key) else None,
        )
        queryable = self._session.declare_queryable(
            self._absolute(key), service.receive, allowed_origin=Locality.REMOTE
        )
        self._receivers.append(queryable)
        return partial(self._end, queryable)

    async def request(
        self, key: str, message: Any, reply: type[T], timeout: float, sender: str = "", *, urgent: bool = False
    ) -> T:
        """Asks the process that serves `key`, and returns its reply.

        Args:
            key: Relative key.
            message: The request.
            reply: Type of the reply.
            timeout: Seconds of the machine.
            sender: Requests of one sender leave in the order in which they are made. It has its own thread, so that
                they wait for no other sender; empty for a request whose order does not matter.
            urgent: It has a queue of the link to itself, ahead of requests that are not urgent and may block theirs.

        Raises:
            UnknownOutcomeError: Nobody answered in time, or the answering process ended before it did.
            DeviceError: It answered with an error; field ``reason`` holds its code.
            PayloadError: The request cannot be sent, or the reply is no `reply`.
        """
        pool = self._sender(sender) if sender else self._pool
        sealing = Sealing(self._seal, self._replies, self._forged) if self._seal and is_sealed(key) else None
        payload, data = pack(message), COMMANDS if urgent else REQUESTS
        attached = self._attached("query", key, payload)
        answer = await ask(self._session, pool, self._absolute(key), payload, timeout, data, attached, sealing)
        return unpack(answer, reply)

    async def look_around(self, key: str) -> None:
        """Sends a request on a key expression to everybody who serves a part of it, and waits for no reply."""
        await self._in_pool(self._session.get, self._absolute(key))

    def alive(self, component: str) -> Any:
        """Declares a liveliness token, ``alive/<component>``, that lasts as long as this session."""
        return self._token(self._absolute(f"alive/{component}"))

    def announce(self, token_of: Callable[[str, str], str]) -> Any:
        """Declares a token of a convention other than ours, made of the session's id and the cell's prefix."""
        return self._token(token_of(str(self._session.zid()), self.prefix))

    def counters(self) -> dict[str, int]:
        """Messages refused, ignored and replaced since the start, and what waits and is answered now."""
        bridge = self._bridge
        return {
            "bus.refused": bridge.refused + self._turns.refused,
            "bus.ignored": self._ignored.count,
            "bus.not_sealed": self._not_sealed,
            "bus.replaced": bridge.replaced,
            "bus.waiting": bridge.waiting + self._turns.waiting,
            "bus.answering": len(self._tasks),
        }

    async def close(self) -> None:
        """Ends running answers (their askers learn: unknown), then undeclares everything and closes."""
        self._bridge.close()
        self._turns.close()
        receivers, self._receivers = self._receivers, []
        await self._in_pool(_undeclare, receivers)
        await self._tasks.close()
        await self._in_pool(_undeclare, [*self._tokens, *self._publishers.values()])
        await self._in_pool(self._session.close)
        for sender in self._senders.values():
            sender.shutdown(cancel_futures=True)
        self._reading_pool.shutdown()
        self._pool.shutdown()

    def _sender(self, name: str) -> ThreadPoolExecutor:
        if name not in self._senders:
            self._senders[name] = ThreadPoolExecutor(1, thread_name_prefix=f"pcmrs-bus-{name}")
        return self._senders[name]

    def _publisher(self, key: str) -> zenoh.Publisher | ext.AdvancedPublisher:
        with self._declaring:
            if key not in self._publishers:
                self._publishers[key] = declare_publisher(self._session, self._absolute(key), class_of(key))
        return self._publishers[key]

    def _token(self, key: str) -> Any:
        token = self._session.liveliness().declare_token(key)
        self._tokens.append(token)
        return token

    async def _end(self, receiver: Any) -> None:
        if receiver in self._receivers:
            self._receivers.remove(receiver)
            await self._in_pool(receiver.undeclare)

    def _attached(self, kind: Literal["put", "query"], key: str, payload: bytes) -> bytes | None:
        """What proves who sends a message: the seal of daemon and nodes, or the signature of who has a certificate."""
        if self._seal is not None and is_sealed(key):
            return self._seal.put(kind, self._absolute(key), payload)
        if self._signer is not None and is_signed(key):
            return self._signer.sign(kind, self._absolute(key), payload)
        return None

    def _is_authentic(self, sample: zenoh.Sample, taken: Taken) -> bool:
        """Whether a message may be taken; one that may not is counted. In Zenoh's threads: it keeps no loop busy."""
        if self._seal is None or not is_sealed(self._relative(sample)):
            return True
        try:
            self._seal.check(attached_to(sample), ("put",), str(sample.key_expr), payload_of(sample), taken)
        except SealError as error:
            self._forged(self._relative(sample), error)
            return False
        return True

    def _objection(self, sample: zenoh.Sample) -> AccessError | None:
        """Why a message that must be signed is not taken. In Zenoh's threads: forged ones keep no loop busy."""
        if self._signatures is None or not is_signed(key := self._relative(sample)):
            return None
        absolute, payload = str(sample.key_expr), payload_of(sample)
        return self._signatures.objection(attached_to(sample), "put", named_in(key), absolute, payload)

    def _forged(self, key: str, error: SealError) -> None:
        self._not_sealed += 1
        self._ignored.take(key, error)

    def _relative(self, sample: zenoh.Sample) -> str:
        return str(sample.key_expr).removeprefix(f"{self.prefix}/")

    def _absolute(self, key: str) -> str:
        return f"{self.prefix}/{key}"

    async def _in_pool(self, work: Callable[..., object], *arguments: Any) -> None:
        await self._loop.run_in_executor(self._pool, work, *arguments)


def _signing(settings: BusSettings) -> tuple[Signer | None, Signatures | None]:
    """Signs for who is known by a certificate, and checks at a daemon that others may reach."""
    own = settings.credentials
    if own is None or (settings.user == LOCAL and not settings.members):
        return None, None
    from pcmrs.bus.signature import Signatures, Signer  # loads a library for certificates

    clock = SystemClock()
    return (
        None if settings.user == LOCAL else Signer.read(own, clock),
        Signatures(settings, clock) if settings.members else None,
    )


def _undeclare(entities: list[Any]) -> None:
    for entity in entities:
        entity.undeclare()
