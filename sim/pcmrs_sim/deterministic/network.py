"""The network of a simulated cell: endpoints that publish, request and reply, and what happens to their messages.

Messages pass as immutable structs. A *coded* network packs and unpacks each one, as the real bus does. Between two
endpoints, the messages of one channel keep their order, as those of one priority on one TCP connection do, unless
reordering is set. Stop has a separate connection. Threads send the requests (`senders`), so that two requests may leave
in another order than they were made.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Awaitable, Callable
from contextvars import copy_context
from typing import Any, NamedTuple, TypeVar, cast

import msgspec

from pcmrs.bus.bridge import ARRIVED
from pcmrs.bus.qos import class_of
from pcmrs.errors import PcmrsError, UnknownOutcomeError
from pcmrs.simulated_time.loop import OWNER, SimulatedLoop, SimulationError
from pcmrs_sim.deterministic.network_conditions import NetworkConditions
from pcmrs_sim.deterministic.senders import Senders, name_of
from pcmrs_sim.deterministic.windows import Windows

M = TypeVar("M", bound=msgspec.Struct)

LATENCY = 0.0005
"""Longest latency of a message without disturbances, s; each message takes a random part of it."""
LONGEST_OVERTAKE = 0.05
"""Longest extra delay of a message that others overtake, s."""
CANCEL_PERIOD = 0.001
"""Time after which a task that continues after its cancellation is cancelled again, s."""

CANCEL_ATTEMPTS = 1000
"""Number of cancellations after which the end of a process has failed."""

DATAGRAMS, REQUESTS, STOPS = "datagrams", str(class_of("cmd/**").priority), "stops"
"""Channels. Each keeps its order, and none waits for another. The other channels have the names of bus priorities."""

Handler = Callable[[str, Any], None]
RequestHandler = Callable[[str, Any], Awaitable[msgspec.Struct]]


class _Packet(NamedTuple):
    """Messages from one endpoint to another that were sent at one instant. They arrive together."""

    sent: float
    due: float
    target: Endpoint
    calls: list[tuple[Callable[..., None], tuple[Any, ...]]]


class Network:
    """Messages between endpoints, each of which stands for a process.

    Args:
        loop: Event loop in whose time messages travel.
        seed: Seed of delays, losses and order.
        coded: Pack and unpack each message.

    Attributes:
        conditions: Present disturbances.
        windows: Durations of hand-overs to and from threads, drawn from the seed or set by a script.
        counts: Numbers of messages that were ``lost``, ``doubled`` or ``overtaken``.
        on_request: Called with key, request and time of arrival, s, when a process takes a request. It arrives even
            while the event loop of the process is stalled, because threads receive it.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, seed: int, *, coded: bool = False) -> None:
        self.conditions = NetworkConditions()
        self.windows = Windows(loop, seed)
        self.counts = {"lost": 0, "doubled": 0, "overtaken": 0}
        self.on_request: Callable[[str, msgspec.Struct, float], None] = lambda *_: None
        self._loop = loop
        # A context without an owner: calls in it are neither stalled nor ended with a process, as those of threads.
        self._outside = copy_context()
        self._draw = random.Random(f"network {seed}")
        self._coded = coded
        self._endpoints: dict[str, Endpoint] = {}
        self._routes: dict[tuple[str, str], tuple[tuple[Endpoint, Handler, type[Any]], ...]] = {}
        self._channels: dict[str, str] = {}
        self._packets: dict[tuple[str, str, str], _Packet] = {}

    def endpoint(self, name: str) -> Endpoint:
        """Join the network under an unused name, and return the new endpoint. A crashed endpoint frees its name."""
        endpoint = self._endpoints[name] = Endpoint(self, name)
        self.forget_routes()
        return endpoint

    def leave(self, endpoint: Endpoint) -> None:
        """Remove an endpoint. Requests that others have pending there fail."""
        if self._endpoints.get(endpoint.name) is endpoint:
            del self._endpoints[endpoint.name]
        self.forget_routes()
        for other in self._endpoints.values():
            other.fail_requests_to(endpoint)

    def forget_routes(self) -> None:
        """Clear the cached routes, because endpoints or subscriptions have changed."""
        self._routes.clear()

    def publish(self, source: Endpoint, key: str, message: msgspec.Struct) -> None:
        """Send a message to all other endpoints that subscribe to its key.

        Args:
            source: Endpoint that publishes. It does not receive its own message.
            key: Key relative to the cell.
            message: The message.
        """
        route = self._routes.get((source.name, key))
        if route is None:
            route = self._routes[source.name, key] = self._find_route(source, key)
        if not route:
            return
        packed = msgspec.msgpack.encode(message) if self._coded else b""
        channel = self._channels.get(key)
        if channel is None:
            channel = self._channels[key] = _channel_of(key)
        for target, handler, kind in route:
            received = msgspec.msgpack.decode(packed, type=kind) if self._coded else message
            self.carry(source, target, handler, key, received, channel=channel)

    def server(self, key: str) -> Endpoint | None:
        """Return the endpoint that answers requests on `key`; None if there is none."""
        return next((each for each in self._endpoints.values() if each.serves(key)), None)

    def carry(
        self, source: Endpoint, target: Endpoint, call: Callable[..., None], *arguments: Any, channel: str = DATAGRAMS
    ) -> None:
        """Carry a message that may be lost, duplicated or overtaken.

        Args:
            source: Sending endpoint.
            target: Receiving endpoint.
            call: Called in the target's process each time the message arrives.
            *arguments: Arguments of the call.
            channel: Channel in which messages keep their order.
        """
        conditions, draw = self.conditions, self._draw
        if conditions.undisturbed:
            self._arrive(source, target, channel, LATENCY * draw.random(), call, arguments)
            return
        if conditions.lost(source.name, target.name, draw):
            self.counts["lost"] += 1
            return
        if draw.random() < conditions.duplicates:
            self.counts["doubled"] += 1
            self._arrive_alone(target, (LATENCY + conditions.delay + LONGEST_OVERTAKE) * draw.random(), call, arguments)
        if draw.random() < conditions.reordering:
            self.counts["overtaken"] += 1
            self._arrive_alone(target, conditions.delay + LONGEST_OVERTAKE * draw.random(), call, arguments)
            return
        self._arrive(source, target, channel, (LATENCY + conditions.delay) * draw.random(), call, arguments)

    def carry_reliably(self, source: Endpoint, target: Endpoint, call: Callable[..., None], *arguments: Any) -> None:
        """Carry a message as a connection does: late or not at all, but in order and never twice.

        Args:
            source: Sending endpoint.
            target: Receiving endpoint.
            call: Called in the target's process when the message arrives.
            *arguments: Arguments of the call.
        """
        if self.conditions.lost(source.name, target.name, self._draw):
            self.counts["lost"] += 1
            return
        delay = (LATENCY + self.conditions.delay) * self._draw.random()
        self._arrive(source, target, REQUESTS, delay, call, arguments)

    def copy(self, message: msgspec.Struct, kind: type[M]) -> M:
        """Return a message as its receiver gets it.

        Args:
            message: The message that was sent.
            kind: Type that the receiver expects.
        """
        if not self._coded:
            return message  # type: ignore[return-value]  # structs are immutable: they may be shared
        return msgspec.msgpack.decode(msgspec.msgpack.encode(message), type=kind)

    def call_from_thread(self, delay: float, call: Callable[..., None], *arguments: Any) -> None:
        """Call a function as a thread of a process does: a stalled event loop does not delay it.

        Args:
            delay: Time until the call, s. Without delay, the call is made at once.
            call: The function.
            *arguments: Arguments of the call.
        """
        if delay > 0.0:
            self._loop.call_later(delay, call, *arguments, context=self._outside)
        else:
            call(*arguments)

    def _arrive(
        self,
        source: Endpoint,
        target: Endpoint,
        channel: str,
        delay: float,
        call: Callable[..., None],
        arguments: tuple[Any, ...],
    ) -> None:
        """Schedule an arrival after `delay`, in the order of the channel. Messages of one instant stay together."""
        route, now = (source.name, target.name, channel), self._loop.time()
        packet = self._packets.get(route)
        if packet is not None and packet.sent == now and packet.target is target:
            packet.calls.append((call, arguments))
            return
        due = max(now + delay, packet.due if packet is not None else 0.0)
        packet = self._packets[route] = _Packet(now, due, target, [(call, arguments)])
        self._loop.call_at(due, target.receive, due, packet.calls, context=target.context)

    def _arrive_alone(
        self, target: Endpoint, delay: float, call: Callable[..., None], arguments: tuple[Any, ...]
    ) -> None:
        """Schedule an arrival that keeps no order."""
        due = self._loop.time() + delay
        self._loop.call_at(due, target.receive, due, [(call, arguments)], context=target.context)

    def _find_route(self, source: Endpoint, key: str) -> tuple[tuple[Endpoint, Handler, type[Any]], ...]:
        others = (each for each in self._endpoints.values() if each.name != source.name)
        return tuple((each, handler, kind) for each in others for handler, kind in each.listeners(key))


class Endpoint:
    """One process on the network; implements `pcmrs.devices.link.Link`. It does not receive its own messages.

    Args:
        network: Network that it has joined.
        name: Name of the process.

    Attributes:
        name: Name of the process.
        context: Context in which its tasks run. Tasks that they start inherit it, and so end with the process.
        prefix: Prefix of its keys, for display.
        alive_tokens: Components whose liveliness it has declared.
        gone: The process has ended.
    """

    prefix = "pcmrs/lab/simulated"

    def __init__(self, network: Network, name: str) -> None:
        self.name = name
        self.alive_tokens: list[str] = []
        self._network = network
        self._listeners: dict[str, list[tuple[Handler, type[Any]]]] = {}
        self._services: dict[str, tuple[type[Any], RequestHandler]] = {}
        self._tasks: dict[asyncio.Task[Any], None] = {}
        self.context = copy_context()
        self.context.run(OWNER.set, self._tasks)
        self._pending_requests: dict[asyncio.Future[Any], Endpoint] = {}
        self._senders = Senders(network.windows)
        self.gone = False

    def publish(self, key: str, message: msgspec.Struct) -> None:
        if not self.gone:
            self._network.publish(self, key, message)

    def subscribe(self, key: str, kind: type[M], handler: Callable[[str, M], None]) -> None:
        self._listeners.setdefault(key, []).append((handler, kind))
        self._network.forget_routes()

    def listen(self, key: str, kind: type[M], handler: Callable[[str, M], None]) -> None:
        self.subscribe(key, kind, handler)

    def when_lost(self, handler: Callable[[str], None]) -> None:
        """Do nothing: no queue of the simulated network is bounded, and none of its events is malformed."""

    def serve(self, key: str, kind: type[M], handler: Callable[[str, M], Awaitable[msgspec.Struct]]) -> None:
        self._services[key] = (kind, handler)

    def end(self, *keys: str) -> None:
        """Stop taking messages and requests on keys."""
        for key in keys:
            self._listeners.pop(key, None)
            self._services.pop(key, None)
        self._network.forget_routes()

    async def request(
        self,
        key: str,
        message: msgspec.Struct,
        reply: type[M],
        timeout: float,
        sender: str = "",
        *,
        urgent: bool = False,  # noqa: ARG002  # no queue of this link is ever full
    ) -> M:
        server = self._network.server(key)
        if server is None or self.gone:
            raise UnknownOutcomeError(f"Nobody answers on {key}.", key=key)
        replied: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        self._pending_requests[replied] = server
        kind, _ = server.service(key)
        delay = self._senders.delay(name_of(key, message), asyncio.get_running_loop().time(), sender)
        # The thread sends what it has taken, even if the requester is cancelled meanwhile.
        copied = self._network.copy(message, kind)
        self._network.call_from_thread(delay, self._send_request, server, key, copied, replied)
        try:
            async with asyncio.timeout(timeout):
                answer = await replied
        except TimeoutError:
            raise UnknownOutcomeError(f"Nobody answered on {key} within {timeout:g} s.", key=key) from None
        finally:
            del self._pending_requests[replied]
        if isinstance(answer, PcmrsError):
            raise answer
        return self._network.copy(answer, reply)

    def _send_request(self, server: Endpoint, key: str, message: msgspec.Struct, replied: asyncio.Future[Any]) -> None:
        if not self.gone:
            self._network.carry_reliably(self, server, server._serve, key, message, self, replied)

    def alive(self, component: str) -> None:
        self.alive_tokens.append(component)

    def send(self, target: Endpoint, call: Callable[..., None], *arguments: Any) -> None:
        """Send a datagram, which may be lost, duplicated or overtaken.

        Args:
            target: Receiving endpoint.
            call: Called in the target's process when the datagram arrives.
            *arguments: Arguments of the call.
        """
        if not self.gone:
            self._network.carry(self, target, call, *arguments)

    def spawn(self, work: Any) -> asyncio.Task[None]:
        """Run a coroutine as a task that ends with this process."""
        # Each task needs its own copy, because a context cannot be entered twice at once.
        return asyncio.get_running_loop().create_task(work, context=self.context.copy())

    def hold_up(self, seconds: float) -> None:
        """Stall the process's event loop for a time, s. Its threads continue."""
        cast(SimulatedLoop, asyncio.get_running_loop()).hold_up(self._tasks, seconds)

    def receive(self, arrived: float, calls: list[tuple[Callable[..., None], tuple[Any, ...]]]) -> None:
        """Process messages that have arrived together.

        Args:
            arrived: Time of their arrival, s: earlier than now if the event loop was stalled.
            calls: Function and arguments of each message.
        """
        ARRIVED.set(arrived)  # as the bridge of the real bus does
        for call, arguments in calls:
            if self.gone:
                return
            call(*arguments)

    def leave(self) -> None:
        """End the process at once: it receives and answers nothing more, and requests to it fail."""
        self.gone = True
        self._network.leave(self)
        for task in tuple(self._tasks):
            task.cancel()

    async def ended(self) -> None:
        """Return when all tasks of the process have ended, after `leave`.

        Raises:
            SimulationError: A task continues after many cancellations.
        """
        for _ in range(CANCEL_ATTEMPTS):
            if not self._tasks:
                return
            for task in tuple(self._tasks):
                task.cancel()
            await asyncio.wait(tuple(self._tasks), timeout=CANCEL_PERIOD)
        raise SimulationError(f"{self.name} cannot be ended: {', '.join(map(str, self._tasks))}.")

    def listeners(self, key: str) -> list[tuple[Handler, type[Any]]]:
        """Return the handlers of messages on `key`, each with the type of message that it expects."""
        return [each for pattern, all_ in self._listeners.items() if _matches(pattern, key) for each in all_]

    def serves(self, key: str) -> bool:
        """Return true if this process answers requests on `key`."""
        return any(_matches(each, key) for each in self._services)

    def service(self, key: str) -> tuple[type[Any], RequestHandler]:
        """Return the type of the requests that this process answers on `key`, and the handler.

        Raises:
            UnknownOutcomeError: It answers none.
        """
        if not self.serves(key):
            raise UnknownOutcomeError(f"Nobody answers on {key}.", key=key)
        return self._services[_pattern(self._services, key)]

    def _serve(self, key: str, message: msgspec.Struct, requester: Endpoint, replied: asyncio.Future[Any]) -> None:
        try:
            _, handler = self.service(key)
        except UnknownOutcomeError as error:  # it was ended while the request was on its way
            self._send_reply(requester, replied, error)
            return
        self._network.on_request(key, message, ARRIVED.get())
        self.spawn(self._answer(handler, key, message, requester, replied))

    async def _answer(
        self,
        handler: RequestHandler,
        key: str,
        message: msgspec.Struct,
        requester: Endpoint,
        replied: asyncio.Future[Any],
    ) -> None:
        answer: msgspec.Struct | PcmrsError
        try:
            answer = await handler(key, message)
        except PcmrsError as error:
            answer = error
        delay = self._network.windows.open(f"reply:{name_of(key, message)}")
        self._network.call_from_thread(delay, self._send_reply, requester, replied, answer)

    def _send_reply(
        self, requester: Endpoint, replied: asyncio.Future[Any], answer: msgspec.Struct | PcmrsError
    ) -> None:
        if not self.gone:
            self._network.carry_reliably(self, requester, _resolve, replied, answer)

    def fail_requests_to(self, server: Endpoint) -> None:
        """Fail the pending requests to a process that has ended."""
        for replied, asked in tuple(self._pending_requests.items()):
            if asked is server and not replied.done():
                text = f"The process {server.name} has ended before it answered."
                replied.set_result(UnknownOutcomeError(text, name=server.name))


def _channel_of(key: str) -> str:
    return STOPS if key.startswith("stop/") else str(class_of(key).priority)


def _resolve(replied: asyncio.Future[Any], answer: Any) -> None:
    if not replied.done():
        replied.set_result(answer)


def _pattern(services: dict[str, Any], key: str) -> str:
    return key if key in services else next(each for each in services if _matches(each, key))


def _matches(pattern: str, key: str) -> bool:
    """Return true if a key expression, with ``*`` for one level, matches a key."""
    if pattern == key:
        return True
    if "*" not in pattern:
        return False
    wanted, given = pattern.split("/"), key.split("/")
    return len(wanted) == len(given) and all(one in ("*", other) for one, other in zip(wanted, given, strict=True))
