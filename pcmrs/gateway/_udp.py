"""A UDP link: one command per datagram."""

from __future__ import annotations

import asyncio
from typing import Any, cast

from pcmrs.gateway._arrival import ReceiveWatch
from pcmrs.gateway.intake import Intake
from pcmrs.gateway.peer_session import ReplyChannel
from pcmrs.gateway.settings import LinkConfig
from pcmrs.hosts import is_loopback

UNKNOWN_PEER = ("unknown", 0)


class UdpLink(asyncio.DatagramProtocol):
    """Receives the commands of one link; acknowledges to the link's reply port at the sender's host.

    Args:
        name: Name of the link.
        config: Its ports.
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
