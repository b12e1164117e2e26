"""The client of a running cell for programs without asyncio: scripts, notebooks, other event loops.

with PlainClient.connect() as cell:
    verdict = cell.call("registration.reinit")
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

from pcmrs.bus import Credentials
from pcmrs.bus.keys import KeyTable
from pcmrs.client._aio import Client, Event
from pcmrs.messages import DryRunResult, JournalPage, JournalQuery, NextStep, Snapshot, Verdict
from pcmrs.messages.health import Health
from pcmrs.messages.identity import LOCAL
from pcmrs.messages.setup import ProcedureDataView, Setup

if TYPE_CHECKING:
    from anyio.from_thread import BlockingPortal

T = TypeVar("T")


class PlainClient:
    """`Client` with blocking functions. Use `PlainClient.connect`.

    Its own event loop runs in a thread; call its functions from any thread but that one.

    Args:
        portal: Portal to the event loop.
        client: Client in that loop, connected.
    """

    def __init__(self, portal: BlockingPortal, client: Client) -> None:
        self._portal = portal
        self._client = client

    @classmethod
    @contextmanager
    def connect(
        cls,
        endpoint: str | None = None,
        site: str | None = None,
        cell: str | None = None,
        user: str = LOCAL,
        credentials: Credentials | None = None,
    ) -> Iterator[PlainClient]:
        """Connect for the length of the ``with`` block; see `Client.connect`.

        Args:
            endpoint: Endpoint of the daemon's bus or of a router.
            site: First part of the cell's name.
            cell: Second part of the cell's name.
            user: Name of the user.
            credentials: Identity, needed for an endpoint on another machine.
        """
        from anyio.from_thread import start_blocking_portal  # not needed with asyncio

        connected = Client.connect(endpoint, site, cell, user, credentials)
        with start_blocking_portal() as portal, portal.wrap_async_context_manager(connected) as client:
            yield cls(portal, client)

    def call(
        self,
        name: str,
        arguments: Mapping[str, Any] | None = None,
        *,
        id: str | None = None,
        timeout: float = 600.0,
    ) -> Verdict:
        """Send a command and wait for its outcome; see `Client.call`.

        Args:
            name: Name of the operation, ``branch.operation``.
            arguments: Arguments of the operation by name.
            id: Id of the command; use the same one again to get the verdict of an earlier call.
            timeout: Longest wait for the outcome, s.
        """
        return self._portal.call(partial(self._client.call, name, arguments, id=id, timeout=timeout))

    def check(self, name: str, arguments: Mapping[str, Any] | None = None) -> DryRunResult:
        """Return the verdict that a command would get now; see `Client.check`.

        Args:
            name: Name of the operation, ``branch.operation``.
            arguments: Arguments of the operation by name.
        """
        return self._portal.call(partial(self._client.check, name, arguments or {}))

    def next_step(self, operation: str = "") -> NextStep:
        """Return the way on from the present states; see `Client.next_step`.

        Args:
            operation: Operation to reach, ``branch.operation``; empty for the next stage of the procedure.
        """
        return self._portal.call(self._client.next_step, operation)

    def stop(self) -> None:
        """Stop every motion; see `Client.stop`."""
        self._portal.call(self._client.stop)

    def state(self) -> Snapshot:
        """Return the present state of all branches; see `Client.state`."""
        return self._portal.call(self._client.state)

    def until(self, condition: Callable[[Snapshot], bool], timeout: float = 60.0) -> Snapshot:
        """Wait for the first state that fulfils a condition, and return it; see `Client.until`.

        Args:
            condition: Returns True for a state that fulfils it; called in the client's thread.
            timeout: Longest wait, s.
        """
        return self._portal.call(self._client.until, condition, timeout)

    def keys(self) -> KeyTable:
        """Return the table of all bus keys; see `Client.keys`."""
        return self._portal.call(self._client.keys)

    def health(self) -> Health:
        """Return the health of the daemon; see `Client.health`."""
        return self._portal.call(self._client.health)

    def setup(self) -> Setup:
        """Return the setup of the cell; see `Client.setup`."""
        return self._portal.call(self._client.setup)

    def gathered(self) -> ProcedureDataView:
        """Return landmarks, digitization, registration and plan so far; see `Client.gathered`."""
        return self._portal.call(self._client.gathered)

    def journal(self, query: JournalQuery) -> JournalPage:
        """Return rows of the journal; see `Client.journal`."""
        return self._portal.call(partial(self._client.journal, query))

    @contextmanager
    def holding(self, *, over: bool = False) -> Iterator[None]:
        """Hold the cell's lease for the length of the ``with`` block; see `Client.holding`."""
        with self._portal.wrap_async_context_manager(self._client.holding(over=over)):
            yield

    def watch(self) -> Iterator[Event]:
        """Yield the last snapshot, then snapshots, verdicts and device events as they arrive; see `Client.watch`."""
        events = self._client.watch()
        try:
            while True:
                yield self._portal.call(anext, events)
        finally:
            self._portal.call(events.aclose)

    def listen(self, key: str, kind: type[T], handler: Callable[[T], None]) -> Callable[[], None]:
        """Call `handler`, in the client's thread, with each message on a stream; see `Client.listen`.

        Args:
            key: Key of the stream or of several, such as ``state/joints`` or ``state/pose/*``.
            kind: Type of its messages.
            handler: Called with each message; must return soon.

        Returns:
            A function that ends the subscription. The end of the connection ends it, too.
        """
        end = self._portal.call(self._client.listen, key, kind, handler)
        return partial(self._portal.call, end)
