"""What the cell tells, kept for all open pages: one client of the bus, dialled again when the daemon is gone."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager, AsyncExitStack, aclosing, suppress

from pcmrs.client import Client, Event
from pcmrs.clock import SystemClock
from pcmrs.console.cell_view_model import CellViewModel
from pcmrs.console.history import HISTORIANS, History
from pcmrs.errors import CommandRefusedError, PcmrsError, UnknownOutcomeError
from pcmrs.messages import BodyPose, Epoch, JointState, Snapshot
from pcmrs.messages.setup import Setup

DIALLED_AGAIN = 1.0
"""Between two tries to reach the daemon, s."""
LOOKED_AFTER = 2.0
"""So often it is asked whether it is still there, s."""
RENEWED = 1.0
"""Between two renewals of the lease, s."""
Dial = Callable[[], AbstractAsyncContextManager[Client]]


class Feed(CellViewModel):
    """The newest of everything, as it comes.

    Args:
        dial: Reaches the daemon.

    Attributes:
        client: None while the daemon is not there.
        trouble: Why not.
        setup: Of the cell, from the last time it was reached.
        history: The journal, as far as it was read.
    """

    def __init__(self, dial: Dial) -> None:
        super().__init__()
        self._dial = dial
        self._clock = SystemClock()
        self._renewed = asyncio.Event()
        self._holds = False
        self.client: Client | None = None
        self.trouble = "The daemon has not been reached yet."
        self.setup: Setup | None = None
        self.history = History()

    @property
    def now(self) -> float:
        return self._clock.monotonic()

    async def run(self) -> None:
        """Keep up with the cell until it is cancelled."""
        while True:
            try:
                async with self._dial() as client:
                    await self._keep_up(client)
            except* PcmrsError as errors:
                self.trouble = "; ".join(error.text for error in errors.exceptions if isinstance(error, PcmrsError))
            self.client = self.health = None
            self.version += 1
            await self._clock.sleep(DIALLED_AGAIN)

    async def hold(self, operation: str) -> None:
        """Ask for the lease, ``acquire`` or ``take_over``, and renews it from then on; or ``release``.

        Raises:
            CommandRefusedError: It was not accepted.
            UnknownOutcomeError: The daemon is silent or gone.
        """
        if self.client is None:
            raise UnknownOutcomeError(self.trouble)
        await self.client.lease(operation)
        self._holds = operation != "release"

    async def _keep_up(self, client: Client) -> None:
        self.setup = await client.setup()
        self.epochs.clear()  # those that count are told again
        async with AsyncExitStack() as stack, asyncio.TaskGroup() as group:
            for end in (
                client.listen("state/joints", JointState, self._take_joints),
                client.listen("state/pose/*", BodyPose, self._take_pose),
                client.listen("state/epoch", Epoch, self._take_epoch),
            ):
                stack.push_async_callback(end)
            self.client, self.trouble = client, ""
            group.create_task(self._gather(client))
            group.create_task(self._renew(client))
            async with aclosing(client.watch()) as events:
                group.create_task(self._look_after(client))
                async for event in events:
                    self._take(event)

    async def _look_after(self, client: Client) -> None:
        """Raise `UnknownOutcomeError` when the daemon has fallen silent twice."""
        silent = False
        while True:
            try:
                self.health = await client.health()
                silent = False
            except UnknownOutcomeError:
                if silent:
                    raise
                self.health, silent = None, True
            await self._clock.sleep(LOOKED_AFTER)

    async def _renew(self, client: Client) -> None:
        while True:
            await self._clock.sleep(RENEWED)
            holder = None if self.snapshot is None or self.snapshot.lease is None else self.snapshot.lease.holder
            if self._holds and holder == client.user:
                with suppress(CommandRefusedError, UnknownOutcomeError):  # it may be in time yet, or the page shows it
                    await client.lease("renew")

    async def _gather(self, client: Client) -> None:
        """Ask for what was gathered, and for what was journalled, whenever the state has changed."""
        may_read = self.setup is not None and self.setup.role in HISTORIANS
        while True:
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
        self.heard["joints"] = self.now

    def _take_epoch(self, epoch: Epoch) -> None:
        self.epochs.append(epoch)
        self.version += 1

    def _take_pose(self, pose: BodyPose) -> None:
        self.poses[pose.body] = pose
        self.heard[pose.body] = self.now
