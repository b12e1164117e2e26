"""OpenIGTLink link: a server for Slicer, or a client of Slicer's server; all connections are served alike."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from contextlib import suppress

import structlog

from pcmrs.background import BackgroundTasks
from pcmrs.clock import Clock
from pcmrs.devices.plus.frames import MessageReader
from pcmrs.dispatcher import DispatcherListener
from pcmrs.errors import PayloadError
from pcmrs.gateway._adapter import Core
from pcmrs.gateway.intake import ConnectionLimit, Intake, peer_of, source_of
from pcmrs.gateway.openigtlink._peer import KINDS, Peer
from pcmrs.gateway.openigtlink._streams import Broadcaster
from pcmrs.gateway.openigtlink.plans import PlanOutcome, PlanSubmitter
from pcmrs.gateway.periodic_timer import PeriodicTask, kernel_beats
from pcmrs.gateway.settings import GatewayConfig
from pcmrs.hosts import is_loopback

LINK = "openigtlink"
MOST = 8
"""Limit of clients."""
MOST_OF_A_HOST = 4
"""Limit of clients from one address."""
CONNECT_WITHIN = 3.0
RETRY_AFTER = 1.0
SEND_BUFFER = 1 << 16
"""Bytes that the kernel holds for a peer that does not read: a few seconds of poses, not minutes."""

log = structlog.get_logger(__name__)


class OpenIgtLink(DispatcherListener):
    """Server of its peers until its tasks are closed.

    Args:
        core: The daemon.
        config: Configuration of the gateway; its table ``openigtlink`` and the trusted hosts are read.
        clock: The machine's clock.
        intake: Counts and logs refusals, and has the plan lock of each host.
        tasks: Owner of the connections' tasks.
        jobs: Owner of the commands' tasks.
    """

    def __init__(
        self,
        core: Core,
        config: GatewayConfig,
        clock: Clock,
        intake: Intake,
        tasks: BackgroundTasks,
        jobs: BackgroundTasks,
    ) -> None:
        self._core = core
        self._gateway = config
        self._config = config.openigtlink
        self._clock = clock
        self._intake = intake
        self._tasks = tasks
        self._jobs = jobs
        self._peers: dict[tuple[str, int], Peer] = {}
        self._limit = ConnectionLimit(LINK, intake, MOST, MOST_OF_A_HOST)
        self._server: asyncio.Server | None = None
        self._exposed = False
        self._feed = Broadcaster(core, clock, together=self._config.poses == "TDATA")
        self._ticks = PeriodicTask(kernel_beats, self._config.rate_hz, self._tick, tasks)
        core.add_listener(self)

    @property
    def dropped(self) -> int:
        """Number of messages to connected peers that newer ones have replaced."""
        return sum(peer.outbox.dropped for peer in self._peers.values())

    async def open(self) -> tuple[str, int]:
        """Start to serve or to connect; return the address of the server, ours or Slicer's.

        Raises:
            OSError: The port cannot be bound.
        """
        config = self._config
        if config.role == "client":
            self._tasks.spawn(self._keep_connected())
            return config.host, config.port
        self._server = await asyncio.start_server(self._accept, config.listen or self._gateway.host, config.port)
        host, port = self._server.sockets[0].getsockname()[:2]
        self._exposed = not is_loopback(host)
        return host, port

    def close(self) -> None:
        """Stop accepting connections."""
        if self._server is not None:
            self._server.close()

    def _tick(self) -> None:
        self._feed.send(self._peers.values())

    def on_stop(self) -> None:
        """Halt the pending commands of all peers."""
        for peer in self._peers.values():
            peer.halt()

    def _accept(self, stream: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        address = self._limit.take(writer)
        if address is not None:
            self._tasks.spawn(self._serve_accepted(stream, writer, address))

    async def _serve_accepted(
        self, stream: asyncio.StreamReader, writer: asyncio.StreamWriter, address: tuple[str, int]
    ) -> None:
        try:
            await self._serve(stream, writer, address)
        finally:
            self._limit.free(address)

    async def _keep_connected(self) -> None:
        """Connect to Slicer's server, and reconnect; its absence is logged once."""
        server, absent = f"{self._config.host}:{self._config.port}", False
        while True:
            try:
                async with self._clock.timeout(CONNECT_WITHIN):
                    stream, writer = await asyncio.open_connection(self._config.host, self._config.port)
            except (OSError, TimeoutError) as error:
                if not absent:
                    log.warning("openigtlink_absent", server=server, reason=str(error) or "no answer")
                absent = True
            else:
                absent = False
                address = peer_of(writer)
                if address is None:
                    writer.transport.abort()
                else:
                    await self._serve(stream, writer, address)
            await self._clock.sleep(RETRY_AFTER)

    async def _serve(
        self, stream: asyncio.StreamReader, writer: asyncio.StreamWriter, address: tuple[str, int]
    ) -> None:
        """Serve one connection until either side ends it.

        A peer that sends nothing stays, since it may only look. One that reads nothing is disconnected by `_send`.
        """
        writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        peer = self._peers[address] = self._new_peer(address)
        log.info("openigtlink_peer", peer=f"{address[0]}:{address[1]}")
        self._ticks.start()
        sending = self._tasks.spawn(self._send(peer, writer))
        try:
            await self._receive(peer, stream, address)
        finally:
            del self._peers[address]
            if not self._peers:
                self._ticks.stop()
            sending.cancel()
            writer.close()

    def _new_peer(self, address: tuple[str, int]) -> Peer:
        host = address[0]
        lock, source = self._intake.lock(host), source_of(LINK, address)

        def planner(answer: Callable[[PlanOutcome], None]) -> PlanSubmitter:
            return PlanSubmitter(source, self._core, lock, self._jobs, answer, self._intake.refusals)

        trusted = not self._exposed and host in self._gateway.unsigned_peers
        return Peer(self._config, planner, self._clock.wall, trusted=trusted)

    async def _receive(self, peer: Peer, stream: asyncio.StreamReader, address: tuple[str, int]) -> None:
        reader = MessageReader(stream, KINDS)
        with suppress(asyncio.IncompleteReadError, OSError):
            while True:
                await self._receive_one(peer, reader, address)

    async def _receive_one(self, peer: Peer, reader: MessageReader, address: tuple[str, int]) -> None:
        try:
            message = await reader.read()
            if message is not None:
                peer.receive(message)
        except PayloadError as error:
            self._intake.refuse(LINK, address, error)
        except ConnectionAbortedError as error:
            self._intake.refuse(LINK, address, error)
            raise
        finally:
            self._intake.counters.received += 1

    async def _send(self, peer: Peer, writer: asyncio.StreamWriter) -> None:
        """Send to a peer. One that reads nothing is disconnected, which ends the reception from it, too."""
        try:
            await peer.outbox.send(writer, self._clock)
        except TimeoutError:
            log.warning("openigtlink_stalled", dropped=peer.outbox.dropped)
            writer.transport.abort()
        except OSError:
            writer.close()
