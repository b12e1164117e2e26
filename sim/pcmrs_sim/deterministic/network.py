"""The network of a simulated cell: endpoints that publish, ask and answer, and what happens to messages in between.

Messages pass as the immutable structs that they are; a network that is told to packs and unpacks each one, as the real
bus does. Between two endpoints those of one channel keep their order, as those of one priority on one TCP connection
do, unless reordering is asked for; Stop has a connection of its own. Requests are sent by threads (`senders`), and so
not in the order in which they were asked for.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Awaitable, Callable
from contextvars import copy_context
from typing import Any, NamedTuple, TypeVar, cast

import msgspec

from pcmrs.bus.qos import class_of
from pcmrs.errors import PcmrsError, UnknownOutcomeError
from pcmrs.simulated_time.loop import OWNER, SimulatedLoop, SimulationError
from pcmrs_sim.deterministic.network_conditions import NetworkConditions
from pcmrs_sim.deterministic.senders import Senders, name_of
from pcmrs_sim.deterministic.windows import Windows

M = TypeVar("M", bound=msgspec.Struct)

LATENCY = 0.0005
"""Of a message when nothing is wrong: a part of this, s."""
OVERTAKEN = 0.05
"""A message that is overtaken comes so much later at most, s."""
ENDING = 0.001
"""A task that goes on although it was cancelled is cancelled again after this, s."""

ATTEMPTS = 1000
"""So often."""

DATAGRAMS, REQUESTS, STOPS = "datagrams", str(class_of("cmd/**").priority), "stops"
"""Channels: each keeps its order, and none waits for another. Others bear the names of the bus's priorities."""

Handler = Callable[[str, Any], None]
Answer = Callable[[str, Any], Awaitable[msgspec.Struct]]


class _Packet(NamedTuple):
    """What is on its way from one endpoint to another, sent at one moment."""

    sent: float
    due: float
    target: Endpoint
    calls: list[tuple[Callable[..., None], tuple[Any, ...]]]


class Network:
    """Carries messages between endpoints, each of which stands for a process.

    Args:
        loop: In whose time it carries them.
        seed: Of delays, losses and order.
        coded: Whether every message is packed and unpacked.

    Attributes:
        conditions: What is wrong now.
        windows: How long what is in the hands of threads takes; a part of it is drawn, or told by a script.
        counts: How many messages were lost, doubled or overtaken, by those names.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, seed: int, *, coded: bool = False) -> None:
        self.conditions = NetworkConditions()
        self.windows = Windows(loop, seed)
        self.counts = {"lost": 0, "doubled": 0, "overtaken": 0}
        self._loop = loop
        self._outside = copy_context()
        self._draw = random.Random(f"network {seed}")
        self._coded = coded
        self._endpoints: dict[str, Endpoint] = {}
        self._routes: dict[tuple[str, str], tuple[tuple[Endpoint, Handler, type[Any]], ...]] = {}
        self._channels: dict[str, str] = {}
        self._packets: dict[tuple[str, str, str], _Packet] = {}

    def endpoint(self, name: str) -> Endpoint:
        """Joins the network under a name that nobody has; an endpoint that has crashed leaves its name free."""
        endpoint = self._endpoints[name] = Endpoint(self, name)
        self.forget_routes()
        return endpoint

    def leave(self, endpoint: Endpoint) -> None:
        """An endpoint is gone: nothing of what is on its way to it arrives."""
        if self._endpoints.get(endpoint.name) is endpoint:
            del self._endpoints[endpoint.name]
        self.forget_routes()
        for other in self._endpoints.values():
            other.lose(endpoint)

    def forget_routes(self) -> None:
        """Somebody listens who did not before, or no more."""
        self._routes.clear()

    def publish(self, source: Endpoint, key: str, message: msgspec.Struct) -> None:
        """Sends a message to everybody else who listens to `key`."""
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
            heard = msgspec.msgpack.decode(packed, type=kind) if self._coded else message
            self.carry(source, target, handler, key, heard, channel=channel)

    def server(self, key: str) -> Endpoint | None:
        """Who answers requests on `key`."""
        return next((each for each in self._endpoints.values() if each.service(key) is not None), None)

    def carry(
        self, source: Endpoint, target: Endpoint, call: Callable[..., None], *what: Any, channel: str = DATAGRAMS
    ) -> None:
        """Has `target` called with `what` when the message arrives, if it does: once, twice or out of order."""
        conditions, draw = self.conditions, self._draw
        if conditions.fine:
            self._arrive(source, target, channel, LATENCY * draw.random(), call, what)
            return
        if conditions.lost(source.name, target.name, draw):
            self.counts["lost"] += 1
            return
        if draw.random() < conditions.duplicates:
            self.counts["doubled"] += 1
            self._later(target, (LATENCY + conditions.delay + OVERTAKEN) * draw.random(), call, what)
        if draw.random() < conditions.reordering:
            self.counts["overtaken"] += 1
            self._later(target, conditions.delay + OVERTAKEN * draw.random(), call, what)
            return
        self._arrive(source, target, channel, (LATENCY + conditions.delay) * draw.random(), call, what)

    def carry_reliably(self, source: Endpoint, target: Endpoint, call: Callable[..., None], *what: Any) -> None:
        """As a connection does it: late or not at all, but in order and never twice."""
        if self.conditions.lost(source.name, target.name, self._draw):
            self.counts["lost"] += 1
            return
        self._arrive(source, target, REQUESTS, (LATENCY + self.conditions.delay) * self._draw.random(), call, what)

    def copy(self, message: msgspec.Struct, kind: type[M]) -> M:
        """The message as the other side has it."""
        if not self._coded:
            return message  # type: ignore[return-value]  # structs are immutable: they may be shared
        return msgspec.msgpack.decode(msgspec.msgpack.encode(message), type=kind)

    def by_thread(self, delay: float, call: Callable[..., None], *what: Any) -> None:
        """Has a thread of a process call something after `delay` s; a loop that is held up does not hold it up."""
        if delay > 0.0:
            self._loop.call_later(delay, call, *what, context=self._outside)
        else:
            call(*what)

    def _arrive(
        self,
        source: Endpoint,
        target: Endpoint,
        channel: str,
        delay: float,
        call: Callable[..., None],
        what: tuple[Any, ...],
    ) -> None:
        """After `delay`, but not before what the channel took earlier; what is sent at one moment goes together."""
        pair, now = (source.name, target.name, channel), self._loop.time()
        packet = self._packets.get(pair)
        if packet is not None and packet.sent == now and packet.target is target:
            packet.calls.append((call, what))
            return
        due = max(now + delay, packet.due if packet is not None else 0.0)
        packet = self._packets[pair] = _Packet(now, due, target, [(call, what)])
        self._loop.call_at(due, target.receive, packet.calls, context=target.context)

    def _later(self, target: Endpoint, delay: float, call: Callable[..., None], what: tuple[Any, ...]) -> None:
        self._loop.call_later(delay, target.receive, [(call, what)], context=target.context)

    def _find_route(self, source: Endpoint, key: str) -> tuple[tuple[Endpoint, Handler, type[Any]], ...]:
        others = (each for each in self._endpoints.values() if each.name != source.name)
        return tuple((each, handler, kind) for each in others for handler, kind in each.listeners(key))


class Endpoint:
    """One process on the network; implements `pcmrs.devices.link.Link`. A process does not hear itself.

    Attributes:
        name: Of the process.
        context: In which its tasks run: what they start ends with the process, too.
        prefix: Of its keys, for who shows it.
        alive_tokens: What it has declared itself to be.
    """

    prefix = "pcmrs/lab/simulated"

    def __init__(self, network: Network, name: str) -> None:
        self.name = name
        self.alive_tokens: list[str] = []
        self._network = network
        self._listeners: dict[str, list[tuple[Handler, type[Any]]]] = {}
        self._services: dict[str, tuple[type[Any], Answer]] = {}
        self._tasks: dict[asyncio.Task[Any], None] = {}
        self.context = copy_context()
        self.context.run(OWNER.set, self._tasks)
        self._asked: dict[asyncio.Future[Any], Endpoint] = {}
        self._senders = Senders(network.windows)
        self._gone = False

    def publish(self, key: str, message: msgspec.Struct) -> None:
        if not self._gone:
            self._network.publish(self, key, message)

    def subscribe(self, key: str, kind: type[M], handler: Callable[[str, M], None]) -> None:
        self._listeners.setdefault(key, []).append((handler, kind))
        self._network.forget_routes()

    def listen(self, key: str, kind: type[M], handler: Callable[[str, M], None]) -> None:
        self.subscribe(key, kind, handler)

    def serve(self, key: str, kind: type[M], handler: Callable[[str, M], Awaitable[msgspec.Struct]]) -> None:
        self._services[key] = (kind, handler)

    def end(self, *keys: str) -> None:
        """Takes no more messages and requests on keys."""
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
        urgent: bool = False,  # noqa: ARG002  # here no queue of the link is ever full
    ) -> M:
        server = self._network.server(key)
        if server is None or self._gone:
            raise UnknownOutcomeError(f"Nobody answers on {key}.", key=key)
        answered: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        self._asked[answered] = server
        kind, _ = server._services[_pattern(server._services, key)]
        delay = self._senders.delay(name_of(key, message), asyncio.get_running_loop().time(), sender)
        # Whoever asked may be cancelled: what a thread has taken is sent all the same.
        self._network.by_thread(delay, self._send_request, server, key, self._network.copy(message, kind), answered)
        try:
            async with asyncio.timeout(timeout):
                answer = await answered
        except TimeoutError:
            raise UnknownOutcomeError(f"Nobody answered on {key} within {timeout:g} s.", key=key) from None
        finally:
            del self._asked[answered]
        if isinstance(answer, PcmrsError):
            raise answer
        return self._network.copy(answer, reply)

    def _send_request(self, server: Endpoint, key: str, message: msgspec.Struct, answered: asyncio.Future[Any]) -> None:
        if not self._gone:
            self._network.carry_reliably(self, server, server._serve, key, message, self, answered)

    def alive(self, component: str) -> None:
        self.alive_tokens.append(component)

    def send(self, target: Endpoint, call: Callable[..., None], *what: Any) -> None:
        """A datagram: may be lost, doubled or overtaken."""
        if not self._gone:
            self._network.carry(self, target, call, *what)

    def spawn(self, work: Any) -> asyncio.Task[None]:
        """Runs `work` as a task that ends with this process."""
        return asyncio.get_running_loop().create_task(work, context=self.context.copy())

    def hold_up(self, seconds: float) -> None:
        """The process's loop does nothing for so long, s; its threads go on."""
        cast(SimulatedLoop, asyncio.get_running_loop()).hold_up(self._tasks, seconds)

    def receive(self, calls: list[tuple[Callable[..., None], tuple[Any, ...]]]) -> None:
        """Messages have arrived."""
        for call, what in calls:
            if self._gone:
                return
            call(*what)

    def leave(self) -> None:
        """The process is gone: it hears and answers nothing; who waits for its answer learns that at once."""
        self._gone = True
        self._network.leave(self)
        for task in tuple(self._tasks):
            task.cancel()

    async def ended(self) -> None:
        """Returns when nothing of the process runs any more, after `leave`.

        Raises:
            SimulationError: Something goes on although it is cancelled again and again.
        """
        for _ in range(ATTEMPTS):
            if not self._tasks:
                return
            for task in tuple(self._tasks):
                task.cancel()
            await asyncio.wait(tuple(self._tasks), timeout=ENDING)
        raise SimulationError(f"{self.name} cannot be ended: {', '.join(map(str, self._tasks))}.")

    def listeners(self, key: str) -> list[tuple[Handler, type[Any]]]:
        """Who listens to `key` here."""
        return [each for pattern, all_ in self._listeners.items() if _matches(pattern, key) for each in all_]

    def service(self, key: str) -> str | None:
        """Under which key it answers requests on `key`; None where it does not."""
        return _pattern(self._services, key) if any(_matches(each, key) for each in self._services) else None

    def _serve(self, key: str, message: msgspec.Struct, asker: Endpoint, answered: asyncio.Future[Any]) -> None:
        _, handler = self._services[_pattern(self._services, key)]
        self.spawn(self._answer(handler, key, message, asker, answered))

    async def _answer(
        self, handler: Answer, key: str, message: msgspec.Struct, asker: Endpoint, answered: asyncio.Future[Any]
    ) -> None:
        answer: msgspec.Struct | PcmrsError
        try:
            answer = await handler(key, message)
        except PcmrsError as error:
            answer = error
        delay = self._network.windows.open(f"reply:{name_of(key, message)}")
        self._network.by_thread(delay, self._send_reply, asker, answered, answer)

    def _send_reply(self, asker: Endpoint, answered: asyncio.Future[Any], answer: msgspec.Struct | PcmrsError) -> None:
        if not self._gone:
            self._network.carry_reliably(self, asker, _settle, answered, answer)

    def lose(self, server: Endpoint) -> None:
        """Who asked a process that is gone learns that at once."""
        for answered, asked in tuple(self._asked.items()):
            if asked is server and not answered.done():
                answered.set_result(
                    UnknownOutcomeError("Who was asked has ended before it answered.", name=server.name)
                )


def _channel_of(key: str) -> str:
    return STOPS if key.startswith("stop/") else str(class_of(key).priority)


def _settle(answered: asyncio.Future[Any], answer: Any) -> None:
    if not answered.done():
        answered.set_result(answer)


def _pattern(services: dict[str, Any], key: str) -> str:
    return key if key in services else next(each for each in services if _matches(each, key))


def _matches(pattern: str, key: str) -> bool:
    """Whether a key expression with ``*`` for one level holds a key."""
    if pattern == key:
        return True
    if "*" not in pattern:
        return False
    wanted, given = pattern.split("/"), key.split("/")
    return len(wanted) == len(given) and all(one in ("*", other) for one, other in zip(wanted, given, strict=True))
