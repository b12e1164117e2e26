"""State of the cell for all open pages: one client of the bus, which reconnects when the daemon is gone."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager, AsyncExitStack, aclosing, suppress

from pcmrs.client import Client, Event
from pcmrs.clock import SystemClock
from pcmrs.console._cell_view_model import CellViewModel
from pcmrs.console._history import JOURNAL_READERS, History
from pcmrs.errors import CommandRefusedError, PcmrsError, UnknownOutcomeError
from pcmrs.messages import BodyPose, Epoch, JointState, Snapshot
from pcmrs.messages.setup import Setup

RECONNECT_PERIOD = 1.0
"""Period of attempts to reach the daemon, s."""
CHECK_PERIOD = 2.0
"""Period of checks that the daemon still answers, s."""
RENEW_PERIOD = 1.0
"""Period of renewals of the lease, s."""
Dial = Callable[[], AbstractAsyncContextManager[Client]]


class LiveFeed(CellViewModel):
    """Newest state of the cell, as it arrives.

    Args:
        dial: Connects to the daemon.

    Attributes:
        client: Client of the daemon; None while it cannot be reached.
        trouble: Reason why it cannot be reached.
        setup: Setup of the cell, from the last time it was reached.
        history: The part of the journal that has been read.
    """

    def __init__(self, dial: Dial) -> None:
        super().__init__()
        self._dial = dial
        self._clock = SystemClock()
        self._renewed = asyncio.Event()
        self._holds = False
        self._pages: set[str] = set()
        self._opened = asyncio.Event()
        self.client: Client | None = None
        self.trouble = "The daemon has not been reached yet."
        self.setup: Setup | None = None
        self.history = History()

    @property
    def now(self) -> float:
        return self._clock.monotonic()

    async def run(self) -> None:
        """Follow the cell until cancelled."""
        while True:
            try:
                async with self._dial() as client:
                    await self._keep_up(client)
            except* PcmrsError as errors:
                self.trouble = "; ".join(error.text for error in errors.exceptions if isinstance(error, PcmrsError))
            self.client = self.health = None
            self.version += 1
            await self._clock.sleep(RECONNECT_PERIOD)

    def page_opened(self, page: str) -> None:
        """Follow everything that a page shows from now on; `page` is its identity."""
        self._pages.add(page)
        self._opened.set()

    def page_closed(self, page: str) -> None:
        """Follow states and events only, and renew no lease, if this was the last open page."""
        self._pages.discard(page)
        if not self._pages:
            self._opened.clear()
            self._renewed.set()  # ends `_gather`

    async def hold(self, operation: str) -> None:
        """Send ``acquire`` or ``take_over`` for the lease, and renew it while a page is open; or send ``release``.

        Raises:
            CommandRefusedError: The request was not accepted.
            UnknownOutcomeError: The daemon is silent or gone.
        """
        if self.client is None:
            raise UnknownOutcomeError(self.trouble)
        await self.client.lease(operation)
        self._holds = operation != "release"

    async def _keep_up(self, client: Client) -> None:
        self.setup = await client.setup()
        async with asyncio.TaskGroup() as group:
            self.client, self.trouble = client, ""
            group.create_task(self._show(client))
            group.create_task(self._renew(client))
            async with aclosing(client.watch()) as events:
                group.create_task(self._check_daemon(client))
                async for event in events:
                    self._take(event)

    async def _check_daemon(self, client: Client) -> None:
        """Check regularly that the daemon answers.

        Raises:
            UnknownOutcomeError: It has not answered twice.
        """
        silent = False
        while True:
            try:
                self.health = await client.health()
                silent = False
            except UnknownOutcomeError:
                if silent:  # once may be a busy machine
                    raise
                self.health, silent = None, True
            await self._clock.sleep(CHECK_PERIOD)

    async def _renew(self, client: Client) -> None:
        while True:
            await self._clock.sleep(RENEW_PERIOD)
            holder = None if self.snapshot is None or self.snapshot.lease is None else self.snapshot.lease.holder
            if self._pages and self._holds and holder == client.user:
                with suppress(
                    CommandRefusedError, UnknownOutcomeError
                ):  # the next renewal may be in time; if not, the page shows it
                    await client.lease("renew")

    async def _show(self, client: Client) -> None:
        """Follow the streams, the gathered data and the journal while a page is open: nobody else looks at them."""
        while True:
            await self._opened.wait()
            self.epochs.clear()  # the valid ones are sent again
            async with AsyncExitStack() as stack:
                for end in (
                    client.listen("state/joints", JointState, self._take_joints),
                    client.listen("state/pose/*", BodyPose, self._take_pose),
                    client.listen("state/epoch", Epoch, self._take_epoch),
                ):
                    stack.push_async_callback(end)
                await self._gather(client)

    async def _gather(self, client: Client) -> None:
        """Request the gathered data and the journal whenever the state has changed, until the last page is closed."""
        may_read = self.setup is not None and self.setup.role in JOURNAL_READERS
        while self._pages:
            self._renewed.clear()
            self.data = await client.gathered()
            if may_read:
                await self.history.follow(client)
            self.version += 1
            await self._renewed.wait()

    def _take(self, event: Event) -> None:
        if isinstance(event, Snapshot):
            self.snapshot = event
        else:
            self.events.append((self._clock.wall(), event))
        self._renewed.set()
        self.version += 1

    def _take_joints(self, joints: JointState) -> None:
        self.joints = joints
        self.received["joints"] = self.now

    def _take_epoch(self, epoch: Epoch) -> None:
        self.epochs.append(epoch)
        self.version += 1

    def _take_pose(self, pose: BodyPose) -> None:
        self.poses[pose.body] = pose
        self.received[pose.body] = self.now
