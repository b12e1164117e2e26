"""The other end of sd_notify(3), for a daemon that is started as a service manager starts it."""

from __future__ import annotations

import socket
import uuid

PATIENCE = 60.0
"""s."""


class ServiceManager:
    """Hears what a process says of itself; its socket is abstract, for the path of a test's folder may be too long.

    Attributes:
        address: For NOTIFY_SOCKET.
    """

    def __init__(self) -> None:
        self.address = f"@pcmrs-{uuid.uuid4().hex}"
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(f"\0{self.address[1:]}")

    def close(self) -> None:
        self._socket.close()

    def next(self) -> dict[str, str]:
        """The next message, waited for."""
        self._socket.settimeout(PATIENCE)
        return _read(self._socket.recv(65536))

    def until(self, name: str, start: str = "") -> list[dict[str, str]]:
        """All messages up to the first one that gives `name` a value with this start."""
        heard = [self.next()]
        while not heard[-1].get(name, "").startswith(start) or name not in heard[-1]:
            heard.append(self.next())
        return heard

    def waiting(self) -> list[dict[str, str]]:
        """What has come already."""
        self._socket.setblocking(False)
        heard = []
        while True:
            try:
                heard.append(_read(self._socket.recv(65536)))
            except BlockingIOError:
                return heard


def _read(message: bytes) -> dict[str, str]:
    return dict(line.split("=", 1) for line in message.decode().split("\n"))
