"""The asyncio client of a running cell, as the command line, the console and tests use it.

async with Client.connect() as cell:
    verdict = await cell.call("registration.reinit")
"""

from __future__ import annotations

import asyncio
import os
import uuid
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable, Coroutine, Mapping
from contextlib import aclosing, asynccontextmanager, suppress
from typing import Any, TypeVar

from pcmrs.bus import DEFAULT_ENDPOINT, Bus, BusSettings, Credentials, Empty
from pcmrs.bus.codec import convert_event
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
    UnknownOutcomeError,
)
from pcmrs.messages import (
    DeviceEvent,
    DeviceReply,
    DeviceRequest,
    DryRunResult,
    JournalPage,
    JournalQuery,
    Question,
    Snapshot,
    TeleopSetpoint,
    Verdict,
)
from pcmrs.messages.health import Health
from pcmrs.messages.identity import LOCAL
from pcmrs.messages.setup import ProcedureDataView, Setup

Event = Snapshot | Verdict | DeviceEvent
T = TypeVar("T")

_TTL = 5.0
"""Seconds after which a command that was held up on its way is refused, not run late."""
_RENEWED = 1.0
_LOOK = 0.05
"""Between two renewals of the lease, s."""
_PATIENCE, _FAR_PATIENCE = 1.5, 10.0
"""For what a daemon decides at once, s: on this machine, and over a network that loses packets."""
_ASKED_AGAIN = 0.5
"""Between two askings for the verdict of a command whose link broke, s."""
_OLD = "old"
"""Why a command is denied that was too long on its way; see `AccessError`."""
_BACKLOG = 1024
"""Events that may wait for who watches."""


class Client:
    """A connection to the daemon of one cell. Use `Client.connect`.

    Attributes:
        missed: Events that `watch` has dropped, the oldest first, since whoever watches took them too slowly.
    """

    def __init__(self, bus: Bus, user: str) -> None:
        self.missed = 0
        self._bus = bus
        self._user = user
        self._clock = SystemClock()
        self._is_far = bus.settings.endpoint.startswith(SECURED)
        self._patience = _FAR_PATIENCE if self._is_far else _PATIENCE

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
            endpoint: Where the daemon's bus listens, or a router that it dials; by default that of the environment,
                ``PCMRS_ENDPOINT``, or else of a daemon on this machine.
            site: First name of the cell; by default ``PCMRS_SITE``, or else ``lab``.
            cell: Second name of the cell; by default ``PCMRS_CELL``, or else ``cell1``.
            user: Who asks; the daemon journals it as ``bus:<user>``. With credentials it is their name.
            credentials: For an endpoint on another machine.
            device_key: Key that daemon and device nodes share (``access.device_key``): needed by `request_device` for
                all devices but the simulated scene.

        Raises:
            BusError: No daemon of this cell answers there, or it does not let us in.
            ConfigurationError: An endpoint on another machine, and no credentials.
        """
        settings = BusSettings(
            endpoint=endpoint or os.environ.get("PCMRS_ENDPOINT", DEFAULT_ENDPOINT),
            site=site or os.environ.get("PCMRS_SITE", "lab"),
            cell=cell or os.environ.get("PCMRS_CELL", "cell1"),
            credentials=credentials,
        )
        bus = await Bus.open(settings, Seal(device_key) if device_key else None)
        try:
            client = cls(bus, user if settings.user == LOCAL else settings.user)
            await client._greet()
            yield client
        finally:
            await bus.close()

    async def call(
        self,
        name: str,
        arguments: Mapping[str, Any] | None = None,
        *,
        id: str | None = None,
        timeout: float = 600.0,
    ) -> Verdict:
        """Ask for an operation and wait for its outcome.

        Over a network a link that breaks meanwhile is not the end: for some seconds the daemon is asked again by the
        command's id, which begins nothing twice. So it is when the command was too long on its way.

        Args:
            name: ``branch.operation``.
            arguments: Of the operation.
            id: Of the command; give the same one again to learn the verdict of an earlier call.
            timeout: Seconds; a daemon that ends is noticed at once, one that hangs within a second.

        Raises:
            UnknownOutcomeError: The daemon fell silent before it answered.
            PayloadError: The name is no ``branch.operation``, or an argument cannot be sent.
        """
        key, envelope = self._command(name, arguments, id)
        end = self._clock.monotonic() + timeout
        unknown: UnknownOutcomeError | None = None
        while True:
            try:
                left = max(end - self._clock.monotonic(), _ASKED_AGAIN)
                verdict = await self._bus.request(key, envelope, Verdict, left)
                denied = _denied(verdict)
                if not denied or (unknown is None and denied != _OLD):
                    return verdict
                # It says nothing of what was asked before; asked again, the command may be quick enough.
                patience = _TTL
            except UnknownOutcomeError as error:
                if not self._is_far:
                    raise
                unknown, patience = error, _FAR_PATIENCE
            end = min(end, self._clock.monotonic() + patience)
            if self._clock.monotonic() >= end:
                if unknown is not None:
                    raise unknown
                return verdict
            await self._clock.sleep(_ASKED_AGAIN)

    def _command(self, name: str, arguments: Mapping[str, Any] | None, id: str | None) -> tuple[str, Envelope]:
        branch, dot, operation = name.partition(".")
        if not dot:
            raise PayloadError(f"'{name}' is no operation: write branch.operation.", name=name)
        envelope = Envelope(
            id=id or uuid.uuid4().hex, sent=self._clock.wall(), ttl=_TTL, arguments=dict(arguments or {})
        )
        return command_key(self._user, branch, operation), envelope

    async def state(self, timeout: float | None = None) -> Snapshot:
        """The present state of all branches.

        Raises:
            UnknownOutcomeError: The daemon did not answer within `timeout` (s); over a network None is longer.
        """
        return await self._bus.request("svc/snapshot", Empty(), Snapshot, timeout or self._patience)

    async def until(self, condition: Callable[[Snapshot], bool], timeout: float = 60.0) -> Snapshot:
        """The first state, from the present one on, of which the condition holds.

        Raises:
            TimeoutError: There was none within `timeout` (s).
        """
        async with asyncio.timeout(timeout), aclosing(self.watch()) as events:
            while True:
                event = await anext(events)
                if isinstance(event, Snapshot) and condition(event):
                    return event

    async def keys(self, timeout: float | None = None) -> KeyTable:
        """Everything that can be published and subscribed, with payloads.

        Raises:
            UnknownOutcomeError: The daemon did not answer within `timeout` (s).
        """
        return await self._bus.request("svc/keys", Empty(), KeyTable, timeout or self._patience)

    async def health(self, timeout: float | None = None) -> Health:
        """How the daemon is, and why it is not well.

        Raises:
            UnknownOutcomeError: The daemon did not answer within `timeout` (s).
        """
        return await self._bus.request("svc/health", Empty(), Health, timeout or self._patience)

    async def setup(self, timeout: float | None = None) -> Setup:
        """How the cell is set up, and what we may do there.

        Raises:
            UnknownOutcomeError: The daemon did not answer within `timeout` (s).
        """
        return await self._bus.request(f"svc/setup/{self._user}", Empty(), Setup, timeout or self._patience)

    async def gathered(self, timeout: float | None = None) -> ProcedureDataView:
        """Landmarks, digitization, registration and plan so far.

        Raises:
            UnknownOutcomeError: The daemon did not answer within `timeout` (s).
        """
        return await self._bus.request("svc/data", Empty(), ProcedureDataView, timeout or self._patience)

    async def check(self, name: str, arguments: Mapping[str, Any], timeout: float | None = None) -> DryRunResult:
        """What would be said to a command now, without giving it: see `call` for its arguments.

        Raises:
            UnknownOutcomeError: The daemon did not answer within `timeout` (s).
        """
        branch, _, operation = name.partition(".")
        question = Question(branch=branch, operation=operation, arguments=dict(arguments))
        return await self._bus.request(f"svc/check/{self._user}", question, DryRunResult, timeout or self._patience)

    async def journal(self, query: JournalQuery, timeout: float | None = None) -> JournalPage:
        """Rows of the journal; operators and viewers may ask.

        Raises:
            UnknownOutcomeError: The daemon did not answer within `timeout` (s).
        """
        return await self._bus.request("svc/journal", query, JournalPage, timeout or self._patience)

    async def stop(self, timeout: float | None = None) -> Stopping:
        """Stop every motion: sent to all listeners at once, and return when the daemon has begun.

        Whether the robot stands is not known then; see `standstill`.

        Raises:
            UnknownOutcomeError: The daemon did not answer within `timeout` (s).
        """
        key = f"stop/{self._user}"
        press = Press(id=uuid.uuid4().hex)
        self._bus.publish(key, press)
        return await self._bus.request(key, press, Stopping, timeout or self._patience, urgent=True)

    async def standstill(self, number: int, timeout: float = 2.0) -> bool:
        """Wait for the robot's standstill after Stop `number`, or a newer one.

        Args:
            number: See `stop`.
            timeout: s.

        Returns:
            Whether it was confirmed in that time.

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
            await self._clock.sleep(_LOOK)

    async def acknowledge(self, operation: str | None = None) -> Verdict:
        """Acknowledge the newest Stop, by its number, as soon as nothing is pending that it has to wait for.

        Args:
            operation: Of the workflow, that releases the latch; by default the first that does.

        Raises:
            ConfigurationError: The workflow has no such operation, since the latch bars nothing in it.
            UnknownOutcomeError: The daemon did not answer in time.
        """
        end = self._clock.monotonic() + self._patience
        while (shown := await self.state()).stop.pending and self._clock.monotonic() < end:
            await self._clock.sleep(_LOOK)
        if operation is None and not shown.release:
            text = f"In {shown.blueprint.id} the latch of Stop bars nothing: there is nothing to release."
            raise ConfigurationError(text, workflow=shown.blueprint.id)
        return await self.call(operation or shown.release[0], {"stop": shown.stop.number})

    @property
    def user(self) -> str:
        """Who asks, as the daemon knows us."""
        return self._user

    def steer(self, setpoint: TeleopSetpoint) -> None:
        """Send a set point of a teleoperator; it counts while this user has engaged the clutch."""
        self._bus.publish(f"teleop/{self._user}", setpoint)

    @asynccontextmanager
    async def holding(self, *, over: bool = False) -> AsyncIterator[None]:
        """Hold the cell's lease for the length of the ``async with`` block.

        Args:
            over: Take it over from whoever holds it, which waits until they confirm; on site it does not.

        Raises:
            CommandRefusedError: Somebody else holds it, or it was lost meanwhile: then the block is cancelled.
            UnknownOutcomeError: The daemon did not answer at the beginning.
        """
        await self.lease("take_over" if over else "acquire")
        try:
            while not self._holds(await self.state()):
                await self._clock.sleep(_RENEWED)
            async with _cancelled_with(self._renew()):
                yield
        finally:
            with suppress(CommandRefusedError, UnknownOutcomeError):  # it was lost, or the daemon has ended
                await self.lease("release")

    def _holds(self, snapshot: Snapshot) -> bool:
        return snapshot.lease is not None and snapshot.lease.holder == self._user

    async def _renew(self) -> None:
        while True:
            await self._clock.sleep(_RENEWED)
            try:
                await self.lease("renew")
            except UnknownOutcomeError:
                continue  # a line that is slow now may be quick enough before the lease lapses
            except CommandRefusedError as error:
                if _denied(error.fields["verdict"]) != _OLD:
                    raise

    async def lease(self, operation: str) -> None:
        """Ask for ``acquire``, ``take_over``, ``renew`` or ``release``; see `holding`.

        Raises:
            CommandRefusedError: It was not accepted.
            UnknownOutcomeError: The daemon did not answer in time.
        """
        key, envelope = self._command(f"lease.{operation}", None, None)
        verdict = await self._bus.request(key, envelope, Verdict, self._patience)
        if verdict.decision != "accepted":
            text = verdict.reason.text if verdict.reason is not None else f"The lease was {verdict.decision}."
            raise CommandRefusedError(text, verdict=verdict)

    async def watch(self) -> AsyncGenerator[Event, None]:
        """Yield the last snapshot, then snapshots, verdicts and device events as they come; never ends."""
        events: asyncio.Queue[Event] = asyncio.Queue(_BACKLOG)

        def take(event: Event) -> None:
            if events.full():
                events.get_nowait()
                self.missed += 1
            events.put_nowait(event)

        ends = (
            self._bus.subscribe("state/fsm", Snapshot, lambda _, snapshot: take(snapshot)),
            self._bus.subscribe("state/event", dict, lambda _, fields: take(convert_event(fields))),
        )
        try:
            while True:
                yield await events.get()
        finally:
            for end in ends:
                await end()

    def listen(self, key: str, kind: type[T], handler: Callable[[T], None]) -> Callable[[], Awaitable[None]]:
        """Call `handler` with what comes on a stream from now on.

        Args:
            key: Of the stream or of several, such as ``state/joints`` or ``state/pose/*``.
            kind: Type of its messages.
            handler: Runs in the event loop and returns soon.

        Returns:
            Ends that; the end of the connection does, too.
        """
        end: Callable[[], Awaitable[None]] = self._bus.subscribe(key, kind, lambda _, message: handler(message))
        return end

    async def request_device(
        self, device: str, method: str, arguments: Mapping[str, Any] | None = None, timeout: float = 5.0
    ) -> Any:
        """Call a method of a device node, past the daemon; for the devices of a simulation.

        Nodes answer only who has the key that they share with the daemon (see `connect`); the simulated scene answers
        everybody.

        Raises:
            UnknownOutcomeError: The node did not answer within `timeout` (s).
            DeviceError: It answered with a failure; field ``reason`` holds its code.
        """
        request = DeviceRequest(method=method, arguments=dict(arguments or {}))
        reply = await self._bus.request(f"dev/{device}/cmd", request, DeviceReply, timeout)
        if reply.failure is not None:
            raise DeviceError(reply.failure.text, reason=reply.failure.code, values=reply.failure.fields)
        return reply.result

    async def _greet(self) -> None:
        try:
            await self.state()
        except UnknownOutcomeError as error:
            settings = self._bus.settings
            raise BusError(
                f"At {settings.endpoint} no daemon of cell {self._bus.prefix} answers {settings.user}: check site and "
                "cell, wait until it has started, or have yourself a role in this cell.",
                endpoint=settings.endpoint,
                cell=self._bus.prefix,
            ) from error


def _denied(verdict: Verdict) -> str:
    """Why a command was not taken as ours; empty where it was."""
    reason = verdict.reason
    return "" if reason is None or reason.code != AccessError.code else str(reason.fields.get("why"))


@asynccontextmanager
async def _cancelled_with(beside: Coroutine[Any, Any, None]) -> AsyncIterator[None]:
    """Run beside the block what only ends by an error; the first error, of either, is raised by itself."""
    try:
        async with asyncio.TaskGroup() as group:
            task = group.create_task(beside)
            yield
            task.cancel()
    except BaseExceptionGroup as errors:
        raise errors.exceptions[0] from None
