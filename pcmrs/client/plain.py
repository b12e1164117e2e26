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
from pcmrs.client.aio import Client, Event
from pcmrs.messages import DryRunResult, JournalPage, JournalQuery, Snapshot, Verdict
from pcmrs.messages.health import Health
from pcmrs.messages.identity import LOCAL
from pcmrs.messages.setup import ProcedureDataView, Setup

if TYPE_CHECKING:
    from anyio.from_thread import BlockingPortal

T = TypeVar("T")


class PlainClient:
    """What `Client` does, with functions that return when it is done. Use `PlainClient.connect`.

    An event loop of its own works for it in a thread; functions may be called from any thread but that one.
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
        """Connect for the length of the ``with`` block; see `Client.connect`."""
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
        """Ask for an operation and wait for its outcome; see `Client.call`."""
        return self._portal.call(partial(self._client.call, name, arguments, id=id, timeout=timeout))

    def check(self, name: str, arguments: Mapping[str, Any] | None = None) -> DryRunResult:
        """What would be said to an operation now; see `Client.check`."""
        return self._portal.call(partial(self._client.check, name, arguments or {}))

    def stop(self) -> None:
        """Stop every motion; see `Client.stop`."""
        self._portal.call(self._client.stop)

    def state(self) -> Snapshot:
        """The present state of all branches; see `Client.state`."""
        return self._portal.call(self._client.state)

    def until(self, condition: Callable[[Snapshot], bool], timeout: float = 60.0) -> Snapshot:
        """The first state of which the condition holds; see `Client.until`."""
        return self._portal.call(self._client.until, condition, timeout)

    def keys(self) -> KeyTable:
        """Everything that can be published and subscribed; see `Client.keys`."""
        return self._portal.call(self._client.keys)

    def health(self) -> Health:
        """How the daemon is; see `Client.health`."""
        return self._portal.call(self._client.health)

    def setup(self) -> Setup:
        """How the cell is set up; see `Client.setup`."""
        return self._portal.call(self._client.setup)

    def gathered(self) -> ProcedureDataView:
        """Landmarks, digitization, registration and plan so far; see `Client.gathered`."""
        return self._portal.call(self._client.gathered)

    def journal(self, query: JournalQuery) -> JournalPage:
        """Rows of the journal; see `Client.journal`."""
        return self._portal.call(partial(self._client.journal, query))

    @contextmanager
    def holding(self, *, over: bool = False) -> Iterator[None]:
        """Hold the cell's lease for the length of the ``with`` block; see `Client.holding`."""
        with self._portal.wrap_async_context_manager(self._client.holding(over=over)):
            yield

    def watch(self) -> Iterator[Event]:
        """Yield the last snapshot, then snapshots, verdicts and device events as they come; see `Client.watch`."""
        events = self._client.watch()
        try:
            while True:
                yield self._portal.call(anext, events)
        finally:
            self._portal.call(events.aclose)

    def listen(self, key: str, kind: type[T], handler: Callable[[T], None]) -> Callable[[], None]:
        """Call `handler`, in a thread of the client, with what comes on a stream; see `Client.listen`.

        Returns:
            Ends that; the end of the connection does, too.
        """
        end = self._portal.call(self._client.listen, key, kind, handler)
        return partial(self._portal.call, end)
