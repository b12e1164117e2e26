"""The asyncio client of a running cell; the command line, the console and tests use it, too.

async with Client.connect() as cell:
    verdict = await cell.call("registration.reinit")
"""

from __future__ import annotations

import asyncio
import os
import uuid
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable, Coroutine, Mapping
from contextlib import AsyncExitStack, aclosing, asynccontextmanager, suppress
from typing import Any, TypeVar

from pcmrs.bus import DEFAULT_ENDPOINT, Bus, BusSettings, Credentials, Empty
from pcmrs.bus.codec import convert_event, unpack
from pcmrs.bus.commands import Envelope
from pcmrs.bus.keys import KeyTable, command_key
from pcmrs.bus.seal import Seal
from pcmrs.bus.settings import SECURED
from pcmrs.bus.stop import Press, Stopping
from pcmrs.clock import SystemClock
from pcmrs.errors import (
    AccessError,
    BusError,
    CommandRefusedError,
    ConfigurationError,
    DeviceError,
    PayloadError,
    PcmrsError,
    RefusalError,
    UnknownOutcomeError,
)
from pcmrs.messages import (
    STOP_NOT_NAMED,
    DeviceEvent,
    DeviceReply,
    DeviceRequest,
    DryRunRequest,
    DryRunResult,
    JournalPage,
    JournalQuery,
    NextStep,
    NextStepRequest,
    Snapshot,
    TeleopSetpoint,
    Verdict,
)
from pcmrs.messages.health import Health
from pcmrs.messages.identity import COMMANDING, LOCAL
from pcmrs.messages.setup import ProcedureDataView, Setup

Event = Snapshot | Verdict | DeviceEvent
"""Event that `Client.watch` yields."""
T = TypeVar("T")

_TTL = 5.0
"""Age after which a command that was held up on its way is refused instead of run late, s."""
_RENEWAL_PERIOD = 1.0
"""Time between two renewals of the lease, s."""
_POLL_PERIOD = 0.05
"""Time between two looks at the state while a change is awaited, s."""
_REPLY_TIME, _FAR_REPLY_TIME = 1.5, 10.0
"""Longest wait for an immediate reply, s: on this machine, and over a network that loses packets."""
_RETRY_PERIOD = 0.5
"""Time between two requests for the verdict of a command whose link broke, s."""
_OLD = "old"
"""Reason for which a command that was too long on its way is denied; see `AccessError`."""
_BACKLOG = 1024
"""Number of events that may wait for the reader of `Client.watch`."""


class Client:
    """A connection to the daemon of one cell. Use `Client.connect`.

    It has two sessions on the bus: one for Stop, which subscribes to nothing, and one for all else.

    Args:
        bus: Session of the bus, open.
        stopping: Another one, which Stop alone uses.
        user: Name of the user.

    Attributes:
        missed: Number of events that `watch` has dropped, the oldest first, because its reader was too slow.
        greeting: Snapshot with which the daemon answered the connection.
    """

    greeting: Snapshot

    def __init__(self, bus: Bus, stopping: Bus, user: str) -> None:
        self.missed = 0
        self._bus = bus
        # Zenoh delivers a session's messages one after another: behind a flooded subscription, Stop gets no answer.
        self._stopping = stopping
        self._user = user
        self._clock = SystemClock()
        self._is_far = bus.settings.endpoint.startswith(SECURED)
        self._patience = _FAR_REPLY_TIME if self._is_far else _REPLY_TIME

    @classmethod
    @asynccontextmanager
    async def connect(
        cls,
        endpoint: str | None = None,
        site: str | None = None,
        cell: str | None = None,
        user: str = LOCAL,
        credentials: Credentials | None = None,
        device_key: bytes = b"",
    ) -> AsyncIterator[Client]:
        """Connect for the length of the ``async with`` block.

        Args:
            endpoint: Endpoint of the daemon's bus, or of a router that the daemon connects to; by default
                ``PCMRS_ENDPOINT`` in the environment, or else that of a daemon on this machine.
            site: First part of the cell's name; by default ``PCMRS_SITE``, or else ``lab``.
            cell: Second part of the cell's name; by default ``PCMRS_CELL``, or else ``cell1``.
            user: Name of the user; the daemon journals it as ``bus:<user>``. With credentials it is their name.
            credentials: Identity, needed for an endpoint on another machine.
            device_key: Key that daemon and device nodes share (``access.device_key``): `request_device` needs it for
                all devices but the simulated scene.

        Raises:
            BusError: No daemon of this cell answers there, or it refuses the connection.
            ConfigurationError: The endpoint is on another machine and there are no credentials.
        """
        settings = BusSettings(
            endpoint=endpoint or os.environ.get("PCMRS_ENDPOINT", DEFAULT_ENDPOINT),
            site=site or os.environ.get("PCMRS_SITE", "lab"),
            cell=cell or os.environ.get("PCMRS_CELL", "cell1"),
            credentials=credentials,
        )
        async with AsyncExitStack() as stack:
            bus = await stack.enter_async_context(_opened(settings, Seal(device_key) if device_key else None))
            try:
                stopping = await stack.enter_async_context(_opened(settings))
            except BusError:  # such as at the limit of connections: Stop then shares the first one
                stopping = bus
            client = cls(bus, stopping, user if settings.user == LOCAL else settings.user)
            client.greeting = await client._greet()
            yield client

    async def call(
        self,
        name: str,
        arguments: Mapping[str, Any] | None = None,
        *,
        id: str | None = None,
        timeout: float = 600.0,
    ) -> Verdict:
        """Send a command and wait for its outcome.

        If the link breaks over a network, or if the command was too long on its way, the command is sent again with the
        same id for some seconds, which never runs it twice.

        Args:
            name: Name of the operation, ``branch.operation``.
            arguments: Arguments of the operation by name.
            id: Id of the command; use the same one again to get the verdict of an earlier call.
            timeout: Longest wait for the outcome, s. The end of the daemon is detected at once, a hang within 1 s.

        Raises:
            UnknownOutcomeError: The daemon became silent before it answered. Over a network, an error or a rejection on
                the way of a repetition changes nothing about that: the first attempt may have run.
            PayloadError: The name is not a ``branch.operation``, or an argument cannot be sent.
            DeviceError: The daemon answered the first attempt with an error.
            AccessError: The role of this user may send no commands: the bus drops them, without an answer.
        """
        key, envelope = self._command(name, arguments, id)
        end = self._clock.monotonic() + timeout
        unknown: PcmrsError | None = None
        while True:
            try:
                left = max(end - self._clock.monotonic(), _RETRY_PERIOD)
                verdict = await self._bus.request(key, envelope, Verdict, left)
                # Without an id it was rejected before the dispatcher, which alone knows about an earlier attempt.
                if verdict.id or (unknown is None and _denial(verdict) != _OLD):
                    return verdict
                patience = _TTL  # the next attempt may be fast enough
            except PcmrsError as error:
                is_unknown = isinstance(error, UnknownOutcomeError)
                if unknown is None:
                    if not (is_unknown and self._is_far):
                        raise
                    await self._check_role(end - self._clock.monotonic())
                # An error reply to a repetition does not tell the outcome of an earlier attempt either.
                unknown, patience = error if is_unknown else unknown, _FAR_REPLY_TIME
            end = min(end, self._clock.monotonic() + patience)
            if self._clock.monotonic() >= end:
                if unknown is not None:
                    raise unknown
                return verdict
            await self._clock.sleep(_RETRY_PERIOD)

    async def _check_role(self, left: float) -> None:
        """Refuse a user whose commands the bus drops.

        A daemon that does not answer, or answers with an error, leaves the question open: the command may have run.

        Args:
            left: Time that is left for the command, s.
        """
        if left <= 0.0:
            return
        try:
            role = (await self.setup(min(self._patience, left))).role
        except PcmrsError:
            return
        if role not in COMMANDING:
            text = f"{self._user} is a {role} here, and sends no commands: {', '.join(COMMANDING)} do."
            raise AccessError(text, user=self._user, role=role, why="role")

    def _command(self, name: str, arguments: Mapping[str, Any] | None, id: str | None) -> tuple[str, Envelope]:
        branch, dot, operation = name.partition(".")
        if not dot:
            raise PayloadError(f"'{name}' is not an operation: write branch.operation.", name=name)
        envelope = Envelope(
            id=id or uuid.uuid4().hex, sent=self._clock.wall(), ttl=_TTL, arguments=dict(arguments or {})
        )
        return command_key(self._user, branch, operation), envelope

    async def state(self, timeout: float | None = None) -> Snapshot:
        """Return the present state of all branches.

        Raises:
            UnknownOutcomeError: The daemon did not answer within `timeout` (s); the default is longer over a network.
        """
        return await self._bus.request("svc/snapshot", Empty(), Snapshot, timeout or self._patience)

    async def until(self, condition: Callable[[Snapshot], bool], timeout: float = 60.0) -> Snapshot:
        """Wait for the first state, from the present one on, that fulfils a condition, and return it.

        Args:
            condition: Returns True for a state that fulfils it.
            timeout: Longest wait, s.

        Raises:
            TimeoutError: No state fulfilled it in time.
        """
        async with asyncio.timeout(timeout), aclosing(self.watch()) as events:
            while True:
                event = await anext(events)
                if isinstance(event, Snapshot) and condition(event):
                    return event

    async def keys(self, timeout: float | None = None) -> KeyTable:
        """Return the table of all bus keys, with their payloads.

        Raises:
            UnknownOutcomeError: The daemon did not answer within `timeout` (s).
        """
        return await self._bus.request("svc/keys", Empty(), KeyTable, timeout or self._patience)

    async def health(self, timeout: float | None = None) -> Health:
        """Return the health of the daemon, with the reasons if it is not healthy.

        Raises:
            UnknownOutcomeError: The daemon did not answer within `timeout` (s).
        """
        return await self._bus.request("svc/health", Empty(), Health, timeout or self._patience)

    async def setup(self, timeout: float | None = None) -> Setup:
        """Return the setup of the cell, and the role of this user.

        Raises:
            UnknownOutcomeError: The daemon did not answer within `timeout` (s).
        """
        return await self._bus.request(f"svc/setup/{self._user}", Empty(), Setup, timeout or self._patience)

    async def gathered(self, timeout: float | None = None) -> ProcedureDataView:
        """Return landmarks, digitization, registration and plan so far.

        Raises:
            UnknownOutcomeError: The daemon did not answer within `timeout` (s).
        """
        return await self._bus.request("svc/data", Empty(), ProcedureDataView, timeout or self._patience)

    async def check(self, name: str, arguments: Mapping[str, Any], timeout: float | None = None) -> DryRunResult:
        """Return the verdict that a command would get now, without sending it.

        Args:
            name: Name of the operation, ``branch.operation``.
            arguments: Arguments of the operation by name.
            timeout: Longest wait for the answer, s; the default is longer over a network.

        Raises:
            UnknownOutcomeError: The daemon did not answer in time.
        """
        branch, _, operation = name.partition(".")
        question = DryRunRequest(branch=branch, operation=operation, arguments=dict(arguments))
        return await self._bus.request(f"svc/check/{self._user}", question, DryRunResult, timeout or self._patience)

    async def next_step(self, operation: str = "", timeout: float | None = None) -> NextStep:
        """Return the way on from the present states, as the verified workflow allows it.

        Args:
            operation: Operation to reach, ``branch.operation``; empty for the next stage of the procedure.
            timeout: Longest wait for the answer, s; the default is longer over a network.

        Raises:
            UnknownOutcomeError: The daemon did not answer in time.
        """
        question = NextStepRequest(operation=operation)
        return await self._bus.request("svc/next", question, NextStep, timeout or self._patience)

    async def journal(self, query: JournalQuery, timeout: float | None = None) -> JournalPage:
        """Return rows of the journal; operators and viewers may read it.

        Args:
            query: Range of rows.
            timeout: Longest wait for the answer, s; the default is longer over a network.

        Raises:
            UnknownOutcomeError: The daemon did not answer in time.
        """
        return await self._bus.request("svc/journal", query, JournalPage, timeout or self._patience)

    async def stop(self, timeout: float | None = None) -> Stopping:
        """Stop every motion: send Stop to all listeners at once, and return when the daemon has started to stop.

        The robot may still move then; see `standstill`.

        Raises:
            UnknownOutcomeError: The daemon did not answer within `timeout` (s).
        """
        key = f"stop/{self._user}"
        press = Press(id=uuid.uuid4().hex)
        self._bus.publish(key, press)  # too, in case that only the connection of the other session is lost
        self._stopping.publish(key, press)
        return await self._stopping.request(key, press, Stopping, timeout or self._patience, urgent=True)

    async def standstill(self, number: int, timeout: float = 2.0) -> bool:
        """Wait for the robot's standstill after Stop `number`, or a newer one.

        Args:
            number: Number of the Stop, as `stop` returns it.
            timeout: Longest wait, s.

        Returns:
            True if standstill was confirmed in that time.

        Raises:
            UnknownOutcomeError: The daemon does not answer.
        """
        end = self._clock.monotonic() + timeout
        while True:
            stop = (await self.state()).stop
            if stop.number >= number and stop.confirmed:
                return True
            if self._clock.monotonic() >= end:
                return False
            await self._clock.sleep(_POLL_PERIOD)

    async def acknowledge(self, operation: str | None = None, *, stop: int | None = None) -> Verdict:
        """Acknowledge a Stop as soon as its pending conditions are met.

        Name the Stop that the person has seen: the number of `Client.stop`, or ``stop.number`` of the snapshot that you
        have shown. A newer one is not acknowledged.

        Args:
            operation: Operation of the workflow that releases the latch; by default the first one.
            stop: Number of the Stop. Only the user ``local`` may leave it out, and only if the newest Stop is not
                younger than 1 s.

        Raises:
            ConfigurationError: The workflow has no such operation, because the latch blocks nothing in it.
            RefusalError: The Stop must be named.
            UnknownOutcomeError: The daemon did not answer in time.
        """
        if stop is None and self._user != LOCAL:
            text = f"{self._user} has not named the Stop to acknowledge, which only {LOCAL} may do: show the snapshot, "
            text += "then acknowledge with stop = the number in its field stop.number."
            raise RefusalError(STOP_NOT_NAMED, text, user=self._user)
        end = self._clock.monotonic() + self._patience
        while (shown := await self.state()).stop.pending and self._clock.monotonic() < end:
            await self._clock.sleep(_POLL_PERIOD)
        if operation is None and not shown.release:
            text = f"In {shown.blueprint.id} the latch of Stop blocks nothing: there is nothing to release."
            raise ConfigurationError(text, workflow=shown.blueprint.id)
        return await self.call(operation or shown.release[0], {} if stop is None else {"stop": stop})

    @property
    def user(self) -> str:
        """Name of the user, as the daemon knows it."""
        return self._user

    def steer(self, setpoint: TeleopSetpoint) -> None:
        """Send a set point of a teleoperator; it counts while this user has engaged the clutch."""
        self._bus.publish(f"teleop/{self._user}", setpoint)

    @asynccontextmanager
    async def holding(self, *, over: bool = False) -> AsyncIterator[None]:
        """Hold the cell's lease for the length of the ``async with`` block.

        Args:
            over: True to take it over from its holder. This waits until the holder confirms; on site it does not wait.

        Raises:
            CommandRefusedError: Another user holds it, or it was lost meanwhile: then the block is cancelled.
            UnknownOutcomeError: The daemon did not answer at the beginning.
        """
        await self.lease("take_over" if over else "acquire")
        try:
            while not self._holds(await self.state()):
                await self._clock.sleep(_RENEWAL_PERIOD)
            async with _beside(self._renew()):
                yield
        finally:
            with suppress(CommandRefusedError, UnknownOutcomeError):  # it was lost, or the daemon has ended
                await self.lease("release")

    def _holds(self, snapshot: Snapshot) -> bool:
        return snapshot.lease is not None and snapshot.lease.holder == self._user

    async def _renew(self) -> None:
        while True:
            await self._clock.sleep(_RENEWAL_PERIOD)
            try:
                await self.lease("renew")
            except UnknownOutcomeError:
                continue  # a slow link may recover before the lease expires
            except CommandRefusedError as error:
                if _denial(error.fields["verdict"]) != _OLD:
                    raise

    async def lease(self, operation: str) -> None:
        """Send ``acquire``, ``take_over``, ``renew`` or ``release`` for the lease; see `holding`.

        Raises:
            CommandRefusedError: The command was not accepted.
            UnknownOutcomeError: The daemon did not answer in time.
        """
        key, envelope = self._command(f"lease.{operation}", None, None)
        verdict = await self._bus.request(key, envelope, Verdict, self._patience)
        if verdict.decision != "accepted":
            text = verdict.reason.text if verdict.reason is not None else f"The lease was {verdict.decision}."
            raise CommandRefusedError(text, verdict=verdict)

    async def watch(self) -> AsyncGenerator[Event, None]:
        """Yield the last snapshot, then snapshots, verdicts and device events as they arrive; never ends."""
        events: asyncio.Queue[Event] = asyncio.Queue(_BACKLOG)

        def take(event: Event) -> None:
            if events.full():
                events.get_nowait()
                self.missed += 1
            events.put_nowait(event)

        ends = (
            self._bus.subscribe("state/fsm", Snapshot, lambda _, snapshot: take(snapshot)),
            self._bus.subscribe_encoded(
                "state/event", lambda payload: convert_event(unpack(payload, dict)), lambda _, event: take(event)
            ),
        )
        try:
            while True:
                yield await events.get()
        finally:
            for end in ends:
                await end()

    def listen(self, key: str, kind: type[T], handler: Callable[[T], None]) -> Callable[[], Awaitable[None]]:
        """Call `handler` with each message on a stream from now on.

        Args:
            key: Key of the stream or of several, such as ``state/joints`` or ``state/pose/*``.
            kind: Type of its messages.
            handler: Called in the event loop; must return soon.

        Returns:
            A function that ends the subscription. The end of the connection ends it, too.
        """
        end: Callable[[], Awaitable[None]] = self._bus.subscribe(key, kind, lambda _, message: handler(message))
        return end

    async def request_device(
        self, device: str, method: str, arguments: Mapping[str, Any] | None = None, timeout: float = 5.0
    ) -> Any:
        """Call a method of a device node, bypassing the daemon; for the devices of a simulation.

        Nodes answer only processes with the key that they share with the daemon (see `connect`); the simulated scene
        answers every process.

        Args:
            device: Name of the device.
            method: Name of a method of its protocol.
            arguments: Arguments of the method by name.
            timeout: Longest wait for the answer, s.

        Raises:
            UnknownOutcomeError: The node did not answer in time.
            DeviceError: The node answered with a failure; field ``reason`` holds its code.
        """
        request = DeviceRequest(method=method, arguments=dict(arguments or {}))
        reply = await self._bus.request(f"dev/{device}/cmd", request, DeviceReply, timeout)
        if reply.failure is not None:
            raise DeviceError(reply.failure.text, reason=reply.failure.code, values=reply.failure.fields)
        return reply.result

    async def _greet(self) -> Snapshot:
        try:
            return await self.state()
        except UnknownOutcomeError as error:
            settings = self._bus.settings
            raise BusError(
                f"At {settings.endpoint} no daemon of cell {self._bus.prefix} answers {settings.user}: check site and "
                "cell, wait until it has started, or get a role in this cell.",
                endpoint=settings.endpoint,
                cell=self._bus.prefix,
            ) from error


@asynccontextmanager
async def _opened(settings: BusSettings, seal: Seal | None = None) -> AsyncIterator[Bus]:
    """Open a session for the length of the context; see `Bus.open`."""
    bus = await Bus.open(settings, seal)
    try:
        yield bus
    finally:
        await bus.close()


def _denial(verdict: Verdict) -> str:
    """Return why access was denied to a command; empty if it was not."""
    reason = verdict.reason
    return "" if reason is None or reason.code != AccessError.code else str(reason.fields.get("why"))


@asynccontextmanager
async def _beside(beside: Coroutine[Any, Any, None]) -> AsyncIterator[None]:
    """Run a coroutine that ends only by an error beside the block; raise the first error of either by itself."""
    try:
        async with asyncio.TaskGroup() as group:
            task = group.create_task(beside)
            yield
            task.cancel()
    except BaseExceptionGroup as errors:
        raise errors.exceptions[0] from None
