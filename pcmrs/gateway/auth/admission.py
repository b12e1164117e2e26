"""Admission of signed commands: none begins before the disk has its counter, except Stop."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from contextlib import suppress

from pcmrs.background import BackgroundTasks
from pcmrs.clock import Clock
from pcmrs.errors import RefusalError
from pcmrs.gateway.auth.counters import CounterWriter
from pcmrs.gateway.auth.peers import SignedPeer, authenticate
from pcmrs.gateway.peer_session import MAX_WAITING, QUEUE_FULL
from pcmrs.gateway.signing import Signed

KEPT_WITHIN = 1.0
"""Limit of a command's wait for the disk, s; then it is refused, and never begins late."""
NOT_KEPT = "counter_not_kept"

Enter = Callable[[RefusalError | None], None]
"""Begins a command, or rejects it with the error given."""


class Admission:
    """Gate that admits signed commands, those of one peer in the order of their arrival.

    Args:
        peers: The configured peers by name.
        keeper: Writes their counters.
        clock: The machine's clock.
        tasks: Owner of the tasks that wait.
    """

    def __init__(
        self, peers: Mapping[str, SignedPeer], keeper: CounterWriter, clock: Clock, tasks: BackgroundTasks
    ) -> None:
        self._peers = peers
        self._keeper = keeper
        self._clock = clock
        self._tasks = tasks
        self._stops = 0

    def identify(self, signed: Signed) -> SignedPeer:
        """Return the peer that a datagram is from; raise `RefusalError` if it is not authentic."""
        return authenticate(self._peers, signed)

    def enter_at_once(self, peer: SignedPeer, enter: Enter, refusal: RefusalError | None = None) -> None:
        """Admit Stop, or reject a command; neither waits for the disk, which gets the counter all the same.

        Args:
            peer: The sender.
            enter: Begins or rejects the command.
            refusal: Why the command is rejected; None for Stop.
        """
        self._keeper.note(peer.name, peer.newest)
        enter(refusal)

    def enter_when_kept(self, peer: SignedPeer, enter: Enter) -> None:
        """Admit a command once its counter is stored; reject it if that fails, or if Stop comes before.

        Args:
            peer: The sender.
            enter: Begins or rejects the command.
        """
        if peer.waiting >= MAX_WAITING:
            text = f"{peer.waiting} commands of {peer.name!r} wait for the disk, the limit is {MAX_WAITING}; send less."
            self.enter_at_once(peer, enter, RefusalError(QUEUE_FULL, text))
            return
        stops = self._stops
        stored = self._keeper.keep(peer.name, peer.newest)

        def decide(_: asyncio.Future[None]) -> None:
            peer.waiting -= 1
            if not stored.cancelled():  # it is cancelled when the gateway closes
                enter(self._objection(stored.exception(), stops))

        peer.waiting += 1
        stored.add_done_callback(decide)
        self._tasks.spawn(self._give_up(stored))

    def halt(self) -> None:
        """Reject all commands that wait now, because of Stop."""
        self._stops += 1

    def _objection(self, error: BaseException | None, stops: int) -> RefusalError | None:
        if error is not None:
            text = f"Its counter cannot be stored, so it could be replayed: {error}. Check the disk, then resend it."
            return RefusalError(NOT_KEPT, text)
        if stops != self._stops:
            return RefusalError("stopped", "Stop came before it had begun.")
        return None

    async def _give_up(self, stored: asyncio.Future[None]) -> None:
        with suppress(TimeoutError):
            async with self._clock.timeout(KEPT_WITHIN):
                await asyncio.wait([stored])
        if not stored.done():
            stored.set_exception(TimeoutError(f"the disk has not answered within {KEPT_WITHIN:g} s"))
