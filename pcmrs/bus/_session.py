"""The bus of one process: publish, subscribe, serve and request in the event loop, without blocking it."""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TYPE_CHECKING, Any, Final, Literal, TypeVar

import msgspec
import zenoh
from zenoh import Locality, ext

from pcmrs.background import BackgroundTasks
from pcmrs.bus._round_robin import AT_ONCE, RoundRobin
from pcmrs.bus.bridge import CAPACITY, Bridge
from pcmrs.bus.codec import busy, pack, pack_text, unpack
from pcmrs.bus.declare import declare_publisher, declare_subscriber
from pcmrs.bus.handshake import RUN, Handshake, answer_questions
from pcmrs.bus.keys import TEXT_COPIES, cell_prefix, is_signed, named_in
from pcmrs.bus.qos import COMMANDS, REQUESTS, class_of
from pcmrs.bus.requests import ReplyCheck, send_query
from pcmrs.bus.seal import ReplayWindow, Seal, is_sealed
from pcmrs.bus.serving import Refuse, Service, attached_to, payload_of
from pcmrs.bus.settings import BusSettings, open_session
from pcmrs.clock import SystemClock
from pcmrs.errors import AccessError, PayloadError, PcmrsError, SealError
from pcmrs.messages.clipping import LONGEST_TEXT, shortened
from pcmrs.messages.identity import LOCAL

if TYPE_CHECKING:
    from pcmrs.bus.signature import CertificateSigner, SignatureVerifier

T = TypeVar("T")

LOG_PERIOD: Final = 1.0
"""Shortest time between two log lines about ignored messages, s."""

_log = logging.getLogger(__name__)


class Bus:
    """One process on the bus of a cell. Keys are relative to the cell, such as ``state/joints``.

    A process does not receive its own messages and requests: they reach other processes only. Use `Bus.open`. Call all
    methods but `publish` in the event loop that opened it.
    """

    def __init__(
        self,
        session: zenoh.Session,
        settings: BusSettings,
        seal: Seal | None = None,
        signer: CertificateSigner | None = None,
        verifier: SignatureVerifier | None = None,
    ) -> None:
        self.settings = settings
        self._seal = seal
        self._signer = signer
        self._verifier = verifier
        self._replies = ReplayWindow()
        self.prefix = cell_prefix(settings.site, settings.cell)
        self._session = session
        self._loop = asyncio.get_running_loop()
        self._bridge = Bridge(self._loop)
        self._turns = RoundRobin(self._loop)
        self._ignored = _IgnoredMessages()
        self._lost = _LostEvents(self._loop)
        self._not_sealed = 0
        self._pool = ThreadPoolExecutor(4, thread_name_prefix="pcmrs-bus")
        # A long reply to a client that does not read it blocks its thread, so commands are answered by other threads.
        self._reading_pool = ThreadPoolExecutor(AT_ONCE, thread_name_prefix="pcmrs-bus-read")
        self._senders: dict[str, ThreadPoolExecutor] = {}
        self._publishers: dict[str, zenoh.Publisher | ext.AdvancedPublisher] = {}
        self._declaring = threading.Lock()
        self._receivers: list[Any] = []
        self._tokens: list[zenoh.LivelinessToken] = []
        self._tasks = BackgroundTasks()
        self._handshake: Handshake | None = None
        if seal is not None and seal.is_daemon:
            self._receivers.append(answer_questions(session, self._absolute(RUN), seal, self._pool, self._on_forged))
        elif seal is not None:
            self._handshake = Handshake(session, self._absolute(RUN), seal, self._pool, self._on_forged)

    @classmethod
    async def open(cls, settings: BusSettings, seal: Seal | None = None) -> Bus:
        """Open the session. A process with a certificate signs with it; a daemon with a register checks signatures.

        Args:
            settings: Endpoint, cell and identity.
            seal: Seal of daemon and device nodes, which seal their messages to each other and accept no others. None
                for all other processes: they can read such messages and cannot send any.

        Raises:
            BusError: The endpoint is in use (``router``) or no router answers there (``client``).
            ConfigurationError: Certificate or key cannot be read.
            PayloadError: The name of site or cell cannot be a part of a key.
        """
        cell_prefix(settings.site, settings.cell)
        signing = _signing(settings)
        session = await asyncio.get_running_loop().run_in_executor(None, open_session, settings)
        bus = cls(session, settings, seal, *signing)
        await bus._confirm_run()
        return bus

    def publish(self, key: str, message: Any) -> None:
        """Send a message to all subscribers of a key, and drop it rather than wait for the link. From any thread.

        Of a key that has a copy in JSON text (`TEXT_COPIES`), the copy is sent as well while somebody subscribes to it.

        Args:
            key: Relative key.
            message: Message of the type that the key table names.

        Raises:
            PayloadError: The message holds a value that cannot be sent.
        """
        payload = pack(message)
        self._publisher(key).put(payload, attachment=self._attached("put", key, payload))
        if key in TEXT_COPIES:
            copies: Any = self._publisher(TEXT_COPIES[key])  # Zenoh's stubs call its matching status a bool
            if copies.matching_status.matching:
                copies.put(pack_text(message), encoding=zenoh.Encoding.APPLICATION_JSON)

    def publish_cdr(self, key: str, payload: bytes) -> None:
        """Send a message that is encoded as CDR, the encoding of ROS 2; see `publish`.

        Args:
            key: Relative key.
            payload: Message as CDR.
        """
        self._publisher(key).put(payload, encoding=zenoh.Encoding.APPLICATION_CDR)

    def subscribe(
        self,
        key: str,
        kind: type[T],
        handler: Callable[[str, T], None],
        refuse: Callable[[str, PcmrsError], object] | None = None,
    ) -> Any:
        """Call `handler(relative key, message)` for every message on the key expression `key`.

        Of a stream, only the newest unread messages of each key are delivered; see `qos.DataClass`.

        Args:
            key: Relative key expression; may hold wildcards.
            kind: Type of the messages; an empty payload is a message without fields.
            handler: Called in the event loop; must return soon.
            refuse: Called instead of `handler` for a message that is malformed, lacks a valid signature, or is one too
                many. Without it, such messages are counted, and logged once a second. It may run in any thread.

        Returns:
            A coroutine function without parameters that ends the subscription. Closing the bus ends it, too.
        """
        return self.subscribe_encoded(key, lambda payload: unpack(payload, kind), handler, refuse)

    def subscribe_encoded(
        self,
        key: str,
        decode: Callable[[bytes], T],
        handler: Callable[[str, T], None],
        refuse: Callable[[str, PcmrsError], object] | None = None,
    ) -> Any:
        """Subscribe to messages of another encoding; see `subscribe`.

        Args:
            key: Relative key expression; may hold wildcards.
            decode: Returns the message from its payload, or raises `PayloadError`.
            handler: Called in the event loop with relative key and message; must return soon.
            refuse: Called instead of `handler` for a message that is rejected.

        Returns:
            A coroutine function without parameters that ends the subscription.
        """
        data, taken = class_of(key), ReplayWindow()
        refuse = refuse or self.ignore

        def deliver(received: str, payload: bytes) -> None:
            try:
                message = decode(payload)
            except PayloadError as error:
                refuse(received, error)
                if data.urgent and self._seal is not None and is_sealed(received):
                    self._lost.add(received)  # of a node that has the key: nobody else can cause a Stop by garbage
            else:
                handler(received, message)

        def receive(sample: zenoh.Sample) -> None:
            received, payload = self._relative(sample), payload_of(sample)
            if not self._is_authentic(sample, received, payload, taken):
                return
            objection = self._objection(sample, received, payload)
            call: Callable[[], object] = partial(deliver, received, payload)
            if objection is not None:
                call = partial(refuse, received, objection)
            if data.newest:
                stream = (deliver, received, objection is None)  # a forged message replaces no other
                self._bridge.post_newest(stream, call, data.newest)
            elif not self._bridge.post(call, urgent=data.urgent):
                # In this thread: the loop is busy, and refusals must not load it further.
                refuse(received, busy(CAPACITY))
                if data.urgent:
                    self._lost.add(received)

        subscriber = declare_subscriber(self._session, self._absolute(key), data, receive)
        self._receivers.append(subscriber)
        return partial(self._end, subscriber)

    def ignore(self, key: str, error: PcmrsError) -> None:
        """Count a message that cannot be used, and log it at most once a second. From any thread.

        Args:
            key: Relative key on which it arrived.
            error: Reason why it cannot be used.
        """
        self._ignored.add(key, error)

    def when_lost(self, handler: Callable[[str], None]) -> None:
        """Call `handler(relative key)` in the event loop for events that found their queue full, or are malformed.

        A malformed event counts only if its seal shows that a process with the key has sent it.

        Several lost events of one key are one call, until it is made.

        Args:
            handler: Called with the relative key.
        """
        self._lost.handler = handler

    def listen(self, key: str, kind: type[T], handler: Callable[[str, T], None]) -> Any:
        """Call `handler(relative key, message)` in Zenoh's thread, where the message is received.

        For data that must not wait for the event loop, such as the arrival time of a heartbeat.

        Args:
            key: Relative key expression; may hold wildcards.
            kind: Type of the messages.
            handler: Called in Zenoh's thread; must return soon.

        Returns:
            A coroutine function without parameters that ends the subscription.
        """
        taken = ReplayWindow()

        def take(sample: zenoh.Sample) -> None:
            received, payload = self._relative(sample), payload_of(sample)
            if not self._is_authentic(sample, received, payload, taken):
                return
            try:
                handler(received, unpack(payload, kind))
            except PayloadError as error:
                self.ignore(received, error)

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
        """Answer requests on the key expression `key`, each in its own task.

        A request in JSON text, or without payload, is answered in JSON text. A `PcmrsError` from `handler` becomes an
        error reply, which `request` raises at the other end.

        Args:
            key: Relative key expression; may hold wildcards.
            kind: Type of the requests.
            handler: Returns the reply from relative key and request.
            refuse: Returns the reply to a request that is malformed, lacks a valid signature, or is one too many.
                Without it, the reply is an error. It may run in any thread.
            reading: True if the requests only read. All such requests of this process are answered a few at a time, in
                turn over their keys, so that the loop keeps time for commands.

        Returns:
            A coroutine function without parameters that ends the service. Closing the bus ends it, too.
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
            ask_run=self._handshake.begin if self._handshake is not None else None,
            verifier=self._verifier if is_signed(key) else None,
        )
        queryable = self._session.declare_queryable(
            self._absolute(key), service.receive, allowed_origin=Locality.REMOTE
        )
        self._receivers.append(queryable)
        return partial(self._end, queryable)

    async def request(
        self, key: str, message: Any, reply: type[T], timeout: float, sender: str = "", *, urgent: bool = False
    ) -> T:
        """Send a request to the process that serves a key, and return its reply.

        Args:
            key: Relative key.
            message: The request.
            reply: Type of the reply.
            timeout: Longest wait for the reply, s of the machine.
            sender: Name of the sender. Its requests are sent in their order by its own thread, so that they never wait
                for another sender. Empty for a request whose order does not matter.
            urgent: True for a request with its own queue of the link, ahead of other requests, which may block theirs.

        Raises:
            UnknownOutcomeError: No reply came in time, or the answering process ended first.
            DeviceError: The reply is an error; field ``reason`` holds its code.
            PayloadError: The request cannot be sent, or the reply is not of type `reply`.
        """
        pool = self._sender(sender) if sender else self._pool
        check = ReplyCheck(self._seal, self._replies, self._on_forged) if self._seal and is_sealed(key) else None
        payload, data = pack(message), COMMANDS if urgent else REQUESTS
        attached = self._attached("query", key, payload)
        answer = await send_query(self._session, pool, self._absolute(key), payload, timeout, data, attached, check)
        return unpack(answer, reply)

    async def probe(self, key: str) -> None:
        """Send a request to every process that serves a part of a key expression, without waiting for replies."""
        await self._in_pool(self._session.get, self._absolute(key))

    def alive(self, component: str) -> Any:
        """Declare the liveliness token ``alive/<component>`` for the lifetime of this session."""
        return self._token(self._absolute(f"alive/{component}"))

    def announce(self, token_of: Callable[[str, str], str]) -> Any:
        """Declare a liveliness token of another convention; `token_of` returns it from session id and cell prefix."""
        return self._token(token_of(str(self._session.zid()), self.prefix))

    def counters(self) -> dict[str, int]:
        """Return counts by name: messages refused, ignored and replaced so far, and running calls and answers."""
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
        """Cancel running answers, whose outcomes are unknown to the clients, undeclare everything and close."""
        self._lost.handler = _ignore_lost  # what arrives from now on is refused, and no danger any more
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

    async def _confirm_run(self) -> None:
        """Ask the daemon for its run, so that its first messages are accepted."""
        if self._handshake is None or self._seal is None:
            return
        try:
            await self._handshake.ended()
        except asyncio.CancelledError:
            await self.close()
            raise
        if not self._seal.is_confirmed:
            _log.warning(
                "The daemon of %s does not answer with our key; its messages are not accepted before it does. "
                "Compare access.device_key on both sides.",
                self.prefix,
            )
        self._tasks.spawn(self._handshake.repeat())

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
        """Return the proof of a message's sender: the seal of daemon and nodes, or a signature by certificate."""
        if self._seal is not None and is_sealed(key):
            return self._seal.put(kind, self._absolute(key), payload)
        if self._signer is not None and is_signed(key):
            return self._signer.sign(kind, self._absolute(key), payload)
        return None

    def _is_authentic(self, sample: zenoh.Sample, key: str, payload: bytes, taken: ReplayWindow) -> bool:
        """Return False for a message without a valid seal, and count it.

        Runs in Zenoh's threads, so that forged messages do not load the event loop.
        """
        if self._seal is None or not is_sealed(key):
            return True
        seal = attached_to(sample)
        try:
            self._seal.check(seal, ("put",), str(sample.key_expr), payload, taken)
        except SealError as error:
            self._on_forged(key, error)
            if error.fields["why"] == "other_run" and self._handshake is not None:
                self._handshake.begin()
            return False
        if self._seal.is_daemon and key.startswith("daemon/"):
            self._seal.count(seal)
        return True

    def _objection(self, sample: zenoh.Sample, key: str, payload: bytes) -> AccessError | None:
        """Return why a message that must be signed is rejected; None for a valid one.

        Runs in Zenoh's threads, so that forged messages do not load the event loop.
        """
        if self._verifier is None or not is_signed(key):
            return None
        return self._verifier.objection(attached_to(sample), "put", named_in(key), str(sample.key_expr), payload)

    def _on_forged(self, key: str, error: SealError) -> None:
        self._not_sealed += 1
        self.ignore(key, error)

    def _relative(self, sample: zenoh.Sample) -> str:
        return str(sample.key_expr).removeprefix(f"{self.prefix}/")

    def _absolute(self, key: str) -> str:
        return f"{self.prefix}/{key}"

    async def _in_pool(self, work: Callable[..., object], *arguments: Any) -> None:
        await self._loop.run_in_executor(self._pool, work, *arguments)


def _signing(settings: BusSettings) -> tuple[CertificateSigner | None, SignatureVerifier | None]:
    """Return the signer of a process with a certificate, and the verifier of a daemon with a register."""
    own = settings.credentials
    if own is None or (settings.user == LOCAL and not settings.members):
        return None, None
    from pcmrs.bus.signature import (  # here, because it loads a library for certificates
        CertificateSigner,
        SignatureVerifier,
    )

    clock = SystemClock()
    return (
        None if settings.user == LOCAL else CertificateSigner.read(own, clock),
        SignatureVerifier(settings, clock) if settings.members else None,
    )


def _undeclare(entities: list[Any]) -> None:
    for entity in entities:
        entity.undeclare()


def _ignore_lost(_key: str) -> None:
    pass


class _LostEvents:
    """Events that were dropped: too many were waiting, or what a process with the key has sent cannot be read.

    Args:
        loop: Event loop in which the handler is called.

    Attributes:
        handler: Called with the key of lost events.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.handler: Callable[[str], None] = _ignore_lost
        self._loop = loop
        self._lock = threading.Lock()
        self._keys: set[str] = set()

    def add(self, key: str) -> None:
        """Report that an event is lost. From any thread."""
        with self._lock:
            if not self._keys:
                self._loop.call_soon_threadsafe(self._report)
            self._keys.add(key)

    def _report(self) -> None:
        with self._lock:
            keys, self._keys = self._keys, set()
        for key in sorted(keys):
            self.handler(key)


class _IgnoredMessages:
    """Messages that could not be used: counted, but logged rarely, so that no sender can fill the log.

    Attributes:
        count: Number of messages since the start.
    """

    def __init__(self) -> None:
        self.count = 0
        self._logged = 0
        self._clock = SystemClock()
        self._next_log = self._clock.monotonic()

    def add(self, key: str, error: PcmrsError) -> None:
        """Count a message, and log it unless another was logged within `LOG_PERIOD`. From any thread."""
        self.count += 1
        now = self._clock.monotonic()
        if now >= self._next_log:
            unlogged, self._logged, self._next_log = self.count - self._logged - 1, self.count, now + LOG_PERIOD
            others = f" ({unlogged} more since the last line)" if unlogged else ""
            shown = shortened(key, LONGEST_TEXT), shortened(error.text, LONGEST_TEXT)
            _log.warning("Ignored a message on %s: %s%s", *shown, others)
