"""One end of the link between a node and its simulated world. Neither sending nor receiving waits."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable

from pcmrs.devices.framing import MessageSplitter

CHUNK = 1 << 16
"""Longest read, bytes."""
BACKLOG = 1 << 18
"""Backlog of unsent data, bytes, above which messages that may be dropped are dropped: the peer does not read."""


class Channel:
    """A socket in the running event loop.

    Args:
        link: Connected socket; closed with this channel.
        take: Called with each message that arrives, without its length.
        ended: Called once, when the other end has closed the link or its process has ended.

    Attributes:
        dropped: Number of messages that were dropped because the peer was too slow, or the channel closed.
    """

    def __init__(self, link: socket.socket, take: Callable[[bytes], None], ended: Callable[[], None]) -> None:
        link.setblocking(False)
        self.dropped = 0
        self._link, self._take, self._ended = link, take, ended
        self._splitter = MessageSplitter()
        self._unsent = bytearray()
        self._open = True
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(link, self.receive)

    def send(self, packed: bytes, *, droppable: bool = False) -> None:
        """Send a message at once, or as soon as the other end reads; never wait.

        Args:
            packed: The message with its length.
            droppable: Drop the message if the peer is too slow: it is useless when it is late.
        """
        if not self._open or (droppable and len(self._unsent) > BACKLOG):
            self.dropped += 1
            return
        self._unsent += packed
        if len(self._unsent) == len(packed):
            self._flush()

    def receive(self) -> None:
        """Take all messages that have arrived, without waiting."""
        while self._open:
            try:
                data = self._link.recv(CHUNK)
            except BlockingIOError:
                return
            except OSError:
                data = b""
            if not data:
                self.close()
                self._ended()
                return
            for body in self._splitter.feed(data):
                self._take(body)
            if len(data) < CHUNK:
                return

    def close(self) -> None:
        """Close the link. Unsent messages are lost."""
        if self._open:
            self._open = False
            self._loop.remove_reader(self._link)
            self._loop.remove_writer(self._link)
            self._link.close()

    def _flush(self) -> None:
        try:
            sent = self._link.send(self._unsent)
        except BlockingIOError:
            sent = 0
        except OSError:
            return  # `receive` detects the end of the link, too
        del self._unsent[:sent]
        if self._unsent:
            self._loop.add_writer(self._link, self._flush)
        else:
            self._loop.remove_writer(self._link)
