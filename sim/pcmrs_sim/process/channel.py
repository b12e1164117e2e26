"""One end of the link between a node and its simulated world: messages that go out and come in without waiting."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable

from pcmrs.devices.framing import MessageSplitter

CHUNK = 1 << 16
BACKLOG = 1 << 18
"""Bytes that wait for a peer that does not read; beyond that, what is out of date when it comes is dropped."""


class Channel:
    """A socket in the running event loop.

    Args:
        link: Connected; closed with this channel.
        take: Called with every message that arrives, without its length.
        ended: Called once, when the other end has closed the link or ended.

    Attributes:
        dropped: Messages that a peer was too slow for.
    """

    def __init__(self, link: socket.socket, take: Callable[[bytes], None], ended: Callable[[], None]) -> None:
        link.setblocking(False)
        self.dropped = 0
        self._link, self._take, self._ended = link, take, ended
        self._cutter = MessageSplitter()
        self._waiting = bytearray()
        self._open = True
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(link, self.receive)

    def send(self, packed: bytes, *, dated: bool = False) -> None:
        """Sends a message at once, or as soon as the other end reads; never waits.

        Args:
            packed: The message.
            dated: It says nothing any more when it comes late, and is dropped rather than kept.
        """
        if not self._open or (dated and len(self._waiting) > BACKLOG):
            self.dropped += 1
            return
        self._waiting += packed
        if len(self._waiting) == len(packed):
            self._flush()

    def receive(self) -> None:
        """Takes everything that has arrived, and waits for nothing."""
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
            for body in self._cutter.feed(data):
                self._take(body)
            if len(data) < CHUNK:
                return

    def close(self) -> None:
        """Closes the link; what still waits to be sent is lost."""
        if self._open:
            self._open = False
            self._loop.remove_reader(self._link)
            self._loop.remove_writer(self._link)
            self._link.close()

    def _flush(self) -> None:
        try:
            sent = self._link.send(self._waiting)
        except BlockingIOError:
            sent = 0
        except OSError:
            return  # the end of the link is read, too
        del self._waiting[:sent]
        if self._waiting:
            self._loop.add_writer(self._link, self._flush)
        else:
            self._loop.remove_writer(self._link)
