"""The gateway as a whole: opens all links on one intake, and closes them. The links over UDP are here, too."""

from __future__ import annotations

import asyncio
import errno
import os
import socket
from collections.abc import AsyncIterator, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast
from uuid import uuid4

import structlog

from pcmrs.background import BackgroundTasks, logged_as
from pcmrs.clock import Clock
from pcmrs.errors import ConfigurationError
from pcmrs.gateway._adapter import Core
from pcmrs.gateway._arrival import ReceiveWatch
from pcmrs.gateway.auth.admission import NOT_KEPT, Admission
from pcmrs.gateway.auth.counters import CounterFile, CounterWriter, check_room
from pcmrs.gateway.auth.peers import SignedPeer
from pcmrs.gateway.handlers import Services
from pcmrs.gateway.intake import Counters, Intake
from pcmrs.gateway.peer_session import ReplyChannel
from pcmrs.gateway.periodic_timer import kernel_beats
from pcmrs.gateway.pose_files import PoseFileWriter
from pcmrs.gateway.rejection_log import RejectionLog
from pcmrs.gateway.settings import UNIX_NS, GatewayConfig, LinkConfig, PeerConfig
from pcmrs.gateway.streams import Markers, Send, Streams
from pcmrs.gateway.tcp import LINK, TcpLink
from pcmrs.hosts import is_loopback
from pcmrs.messages import DeviceEvent

FINISH_WITHIN = 1.0
"""Limit for running commands to end and be answered when the gateway closes, s."""
COUNTERS = "peers.counters"
"""File of the newest counters of signed peers."""
RESET = "counters_reset"
TASK_FAILED = "gateway_task_failed"
"""Log event of a task of the gateway that has failed."""
RECORDS = "records"
"""Folder of what clients save."""
UNKNOWN_PEER = ("unknown", 0)
"""Sender of a datagram if the socket reports an error instead."""

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class Gateway:
    """The open gateway.

    Attributes:
        addresses: Host and port of every listening link, by name (``tcp`` is the TCP link).
        counters: Numbers of datagrams and refusals.
    """

    addresses: dict[str, tuple[str, int]]
    counters: Counters


@asynccontextmanager
async def open_gateway(core: Core, config: GatewayConfig, clock: Clock, folder: Path) -> AsyncIterator[Gateway]:
    """Serve all links until the context ends.

    Args:
        core: The daemon.
        config: The links.
        clock: The machine's clock, not a faster simulated one: clients wait in real time.
        folder: Folder of the cell, for the counters of signed peers; saved placements and pose logs go into `RECORDS`.

    Raises:
        ConfigurationError: A port cannot be bound, or a peer's key, the counters or the folder of the lab's files
            cannot be used.
    """
    lab_folder = _make_lab_folder(config.lab_files)
    async with AsyncExitStack() as stack:
        tasks, jobs, files = (BackgroundTasks(logged_as(TASK_FAILED)) for _ in range(3))
        stack.push_async_callback(tasks.close)
        stack.push_async_callback(jobs.close)
        stack.push_async_callback(files.close)
        streams = Streams(core, kernel_beats, config, await _open_sender(stack), tasks)
        pose_files = PoseFileWriter(core, clock, folder / RECORDS, tasks)
        refusals = RejectionLog(core, clock, tasks)
        admission = None
        if config.peers:
            admission = _open_admission(stack, core, config, clock, folder / COUNTERS, refusals, tasks)
        services = Services(uuid4().hex, core, clock, streams, pose_files, refusals, config.surgeon)
        intake = Intake(services, jobs, config.unsigned_peers, admission)
        core.add_listener(intake)
        watch = ReceiveWatch(clock, tasks)
        watch.start()
        if lab_folder is not None:
            from pcmrs.gateway._lab_files import LabFileWriter  # loads the formats of files, which few cells need

            lab_files = LabFileWriter(core, clock, lab_folder, files, refusals)
            core.add_listener(lab_files)
            lab_files.start()
            # It is left when the commands have ended, so that what they have changed is written.
            stack.push_async_callback(files.finish, clock, FINISH_WITHIN)
        if config.markers.enabled:
            core.add_listener(Markers(config.markers.stream, core.snapshot()))
        addresses = {
            name: await _open_udp(stack, UdpLink(name, link, intake, watch), link.host or config.host, link)
            for name, link in config.links().items()
            if link.port is not None
        }
        if config.tcp_port is not None:
            tcp = TcpLink(intake, tasks, clock, watch)
            addresses[LINK] = await _open_tcp(stack, tcp, config.tcp_host or config.host, config.tcp_port)
        if config.openigtlink.enabled:
            addresses["openigtlink"] = await _open_openigtlink(stack, core, config, clock, intake, tasks, jobs)
        # It is left first, while the sockets are open: clients learn the outcome of commands that the daemon has ended.
        stack.push_async_callback(jobs.finish, clock, FINISH_WITHIN)
        yield Gateway(addresses, intake.counters)


def _make_lab_folder(name: str) -> Path | None:
    """Make the folder of the lab's files; None if there is none. Raises `ConfigurationError`."""
    if not name:
        return None
    folder = Path(name).expanduser()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except OSError as error:
        text = f"gateway.lab_files: {folder} cannot be used ({error.strerror}): give a folder that can be written."
        raise ConfigurationError(text, folder=str(folder)) from None
    return folder


def _open_admission(
    stack: AsyncExitStack,
    core: Core,
    config: GatewayConfig,
    clock: Clock,
    path: Path,
    refusals: RejectionLog,
    tasks: BackgroundTasks,
) -> Admission:
    file = CounterFile(path)
    stack.callback(file.close)
    check_room(file.kept, config.peers, path)
    if file.made:
        _report_reset(core, config.peers, path)
    peers = {name: SignedPeer(name, peer, file.kept.get(name, 0), clock) for name, peer in config.peers.items()}
    keeper = CounterWriter(file, lambda error: refusals.add("gateway", NOT_KEPT, f"{path} cannot be written: {error}."))
    stack.push_async_callback(keeper.close)
    return Admission(peers, keeper, clock, tasks)


def _report_reset(core: Core, peers: Mapping[str, PeerConfig], path: Path) -> None:
    """Warn that in a new folder every counter begins at 0, so that recorded commands could be sent again."""
    growing = ", ".join(sorted(name for name, peer in peers.items() if peer.counter != UNIX_NS))
    text = f"{path} is new: counters of signed peers begin at 0. If this cell had another folder, copy it from there."
    if growing:
        text += f" Otherwise commands that were sent before could be accepted again from: {growing}."
    _log.warning(RESET, text=text, peers=sorted(peers))
    core.report(DeviceEvent(device="gateway", code=RESET, text=text, fields={"peers": sorted(peers)}))


async def _open_sender(stack: AsyncExitStack) -> Send:
    """Open a separate socket for streams, so that a mixed reality host need not be reachable from loopback."""
    transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
        asyncio.DatagramProtocol, family=socket.AF_INET
    )
    stack.callback(transport.close)
    return lambda text, host, port: transport.sendto(text.encode("ascii"), (host, port))


async def _open_udp(stack: AsyncExitStack, link: UdpLink, host: str, config: LinkConfig) -> tuple[str, int]:
    try:
        await asyncio.get_running_loop().create_datagram_endpoint(lambda: link, local_addr=(host, config.port or 0))
    except OSError as error:
        raise _unbound("UDP", host, config.port or 0, error) from None
    stack.callback(link.close)
    return link.address


async def _open_tcp(stack: AsyncExitStack, link: TcpLink, host: str, port: int) -> tuple[str, int]:
    try:
        address = await link.listen(host, port)
    except OSError as error:
        raise _unbound("TCP", host, port, error) from None
    stack.callback(link.close)
    return address


async def _open_openigtlink(
    stack: AsyncExitStack,
    core: Core,
    config: GatewayConfig,
    clock: Clock,
    intake: Intake,
    tasks: BackgroundTasks,
    jobs: BackgroundTasks,
) -> tuple[str, int]:
    try:
        from pcmrs.gateway.openigtlink.link import OpenIgtLink
    except ModuleNotFoundError as error:
        text = f"gateway.openigtlink needs {error.name}, which is not installed; install the extra: pcmrs[hardware]."
        raise ConfigurationError(text, module=error.name) from None
    link = OpenIgtLink(core, config, clock, intake, tasks, jobs)
    try:
        address = await link.open()
    except OSError as error:
        host = config.openigtlink.listen or config.host
        raise _unbound("OpenIGTLink", host, config.openigtlink.port, error) from None
    stack.callback(link.close)
    return address


def _unbound(kind: str, host: str, port: int, error: OSError) -> ConfigurationError:
    return ConfigurationError(
        f"{kind} port {port} of {host} cannot be bound ({error.strerror or error}); "
        "another daemon may be running, or configure another port.",
        host=host,
        port=port,
    )


class UdpLink(asyncio.DatagramProtocol):
    """Receiver of the commands of one link, which acknowledges to the link's reply port at the sender's host.

    Args:
        name: Name of the link.
        config: Its address and ports.
        intake: Intake of the commands.
        watch: Knows when datagrams have arrived.
    """

    def __init__(self, name: str, config: LinkConfig, intake: Intake, watch: ReceiveWatch) -> None:
        self._name = name
        self._config = config
        self._intake = intake
        self._watch = watch
        self._queue = watch.new_queue()
        self._transport: asyncio.DatagramTransport
        self._exposed = True

    @property
    def address(self) -> tuple[str, int]:
        """Host and port that the link is bound to."""
        host, port = self._transport.get_extra_info("sockname")[:2]
        return host, port

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Store the transport, once the socket is bound."""
        self._transport = cast(asyncio.DatagramTransport, transport)
        self._exposed = not is_loopback(self.address[0])
        self._watch.add_stamped(self._queue, transport.get_extra_info("socket").fileno())

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        """Take a datagram.

        Args:
            data: The datagram.
            addr: Host and port of the sender.
        """
        arrived = self._watch.arrival(self._queue)
        host, port = addr[:2]
        reply_port = self._config.reply_port
        answer = ReplyChannel(
            verdict=lambda text: self._send(text, addr),
            acknowledge=None if reply_port is None else lambda text: self._send(text, (host, reply_port, *addr[2:])),
        )
        self._intake.receive(self._name, (host, port), self._exposed, data, answer, arrived)

    def error_received(self, exc: Exception) -> None:
        """Ignore that a client's port is closed."""
        self._intake.refuse(self._name, UNKNOWN_PEER, exc)

    def close(self) -> None:
        """Close the socket."""
        self._watch.remove(self._queue)
        self._transport.close()

    def _send(self, text: str, addr: tuple[Any, ...]) -> None:
        if not self._transport.is_closing():
            self._transport.sendto(text.encode("ascii"), addr)
