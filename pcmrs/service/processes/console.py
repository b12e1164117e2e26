"""Page of the cell: the daemon holds its address, and a child process on this machine serves it."""

from __future__ import annotations

import asyncio
import secrets
import socket
from importlib.util import find_spec

from pcmrs.console.settings import HOST, TOKEN, UPLOADS
from pcmrs.files import SECRET, write_durably
from pcmrs.processes.starting import Process, ProcessStarter
from pcmrs.service.processes.child import open_child
from pcmrs.settings import Settings


def is_served(settings: Settings) -> bool:
    """Return whether the daemon serves the page: it is enabled, and its packages are installed."""
    return settings.console.enabled and find_spec("nicegui") is not None


class ConsoleListener:
    """Token and port of the page. The process that serves it is started by the first connection.

    So the address works as soon as it is printed, although the web server takes seconds to start: the kernel keeps
    the connection until then. A page costs no process until it is opened. A process that ends by itself is restarted at
    once, and if an earlier one has left uploaded files of patients, the first one starts at once: it removes them.

    Args:
        start: Starts the process.
        settings: Settings of the daemon.
    """

    def __init__(self, start: ProcessStarter, settings: Settings) -> None:
        self._start, self._settings = start, settings
        self._listening: socket.socket | None = None
        self._failure = OSError("The console does not listen.")
        self._started = False

    @property
    def address(self) -> str:
        """Address of the page, without its token; empty if none is served."""
        return "" if self._listening is None else f"http://{HOST}:{self._settings.console.port}"

    def open(self) -> None:
        """Listen, with the token in the cell's folder, which is created if there is none.

        If this fails, the cell works without the page, and `begin` says why.
        """
        token = self._settings.cell.path() / TOKEN
        try:
            if not token.exists():
                write_durably(token, secrets.token_urlsafe(24).encode(), mode=SECRET)
            self._listening = socket.create_server((HOST, self._settings.console.port))
        except OSError as error:
            self._failure = error

    def close(self) -> None:
        """Stop listening; connections that are not accepted yet end."""
        if self._listening is not None:
            self._listening.close()
            self._listening = None

    async def begin(self) -> Process:
        """Start the process that answers connections; the first time, wait for one.

        Raises:
            OSError: The token cannot be written, the port is taken, or the process cannot be started.
        """
        if self._listening is None:
            raise self._failure
        if not self._started and not self._left_files():
            await _connection(self._listening)
        self._started = True
        number = self._listening.fileno()
        words = ("console", "--lifeline", "--listening", str(number))
        discarded = asyncio.subprocess.DEVNULL
        return await open_child(self._start, *words, settings=self._settings, stdout=discarded, passed=number)

    def _left_files(self) -> bool:
        return any(path.is_file() for path in (self._settings.cell.path() / UPLOADS).rglob("*"))


async def _connection(listening: socket.socket) -> None:
    """Wait until a client has connected; the connection is not accepted."""
    loop, connected = asyncio.get_running_loop(), asyncio.Event()
    loop.add_reader(listening, connected.set)
    try:
        await connected.wait()
    finally:
        loop.remove_reader(listening)
